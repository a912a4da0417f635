use super::contents::{Contents, counted};
use crate::{
    Result,
    exchange::{
        glb::{self, Glb, GlbCloud},
        ply,
    },
    geometry::Pose,
    scene::{Role, Scene, Stage},
};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde_json::json;
use std::path::Path;

pub(super) fn write_ply(scene: &Scene, contents: &Contents, path: &Path) -> Result<String> {
    ply::write_cloud(path, &contents.cloud, scene.manifest().scale)?;
    Ok(counted(contents.cloud.len(), "point"))
}

/// A file for each instance, called by its id and its name.
pub(super) fn write_instances(scene: &Scene, contents: &Contents, folder: &Path) -> Result<String> {
    scene.require(Stage::Unify)?;
    let clouds = contents.by_instance();
    for (&id, cloud) in &clouds {
        let name = file_name(contents.name(id));
        let path = folder.join(format!("{id}-{name}.ply"));
        ply::write_cloud(&path, cloud, scene.manifest().scale)?;
    }
    let instances = clouds.keys().filter(|&&id| id != 0).count();
    let points = counted(contents.cloud.len(), "point");
    Ok(format!("{points} of {}", counted(instances, "instance")))
}

/// A name without what file systems and shells have plans for.
fn file_name(name: &str) -> String {
    let plain = |c: char| {
        if c.is_alphanumeric() || "-_.".contains(c) {
            c
        } else {
            '_'
        }
    };
    name.chars().map(plain).take(60).collect()
}

pub(super) fn write_glb(scene: &Scene, contents: &Contents, path: &Path) -> Result<String> {
    let manifest = scene.manifest();
    let clouds = contents
        .by_instance()
        .into_iter()
        .map(|(id, cloud)| GlbCloud {
            name: contents.name(id).to_string(),
            extras: json!({ "id": id, "points": cloud.len() }),
            positions: cloud.positions,
            colours: cloud.colours,
        });
    let cameras = scene.records(Role::Input).iter().map(|record| {
        let photo = super::photos::camera(record);
        (record.photo.name.clone(), photo)
    });
    let glb = Glb {
        name: "scene".into(),
        extras: json!({ "scale": manifest.scale, "generator": manifest.generator }),
        to_gltf: y_up() * manifest.floor_to_world.inverse(),
        clouds: clouds.collect(),
        cameras: cameras.collect(),
    };
    glb::write_glb(path, &glb)?;
    let instances = glb.clouds.iter().filter(|cloud| cloud.extras["id"] != 0);
    let (points, instances) = (contents.cloud.len(), instances.count());
    let cameras = glb.cameras.len();
    let counts = [
        (points, "point"),
        (instances, "instance"),
        (cameras, "camera"),
    ];
    Ok(counts.map(|(count, what)| counted(count, what)).join(", "))
}

/// From the floor's frame, with z up, to one with y up: a quarter turn about x.
fn y_up() -> Pose {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let turn = UnitQuaternion::new_normalize(Quaternion::new(half, -half, 0.0, 0.0));
    Pose::from_parts(Translation3::identity(), turn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector;
    use approx::assert_relative_eq;

    #[test]
    fn up_is_y_and_ahead_is_away_from_the_viewer() {
        assert_relative_eq!(y_up() * Vector::z(), Vector::y(), epsilon = 1e-12);
        assert_relative_eq!(y_up() * Vector::y(), -Vector::z(), epsilon = 1e-12);
    }

    #[test]
    fn names_become_file_names() {
        assert_eq!(file_name("grüner Sessel / 2"), "grüner_Sessel___2");
        assert_eq!(file_name(&"x".repeat(500)).len(), 60);
    }
}
