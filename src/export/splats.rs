use super::contents::{Contents, counted};
use crate::{
    Error, Result,
    exchange::ply::{Splat, write_splats},
    scene::{Frame, Gaussians, Scene},
};
use nalgebra::{Quaternion, UnitQuaternion};
use std::path::Path;

/// Extents of MV-DUSt3R's Gaussians were clipped to these shares of the points' mean distance from the
/// first camera when it was trained.
const EXTENTS: [f32; 2] = [1e-4, 4e-3];

/// Writes the Gaussian of each point that is left after edits, moved and recoloured as the point was.
pub(super) fn write(scene: &Scene, contents: &Contents, path: &Path) -> Result<String> {
    let gaussians = scene.gaussians()?;
    let extents = EXTENTS.map(|share| share * mean_distance(&contents.frames) as f32);
    let splats = (0..contents.cloud.len()).map(|index| splat(contents, &gaussians, index, extents));
    let splats: Vec<Splat> = splats.collect();
    if splats.is_empty() {
        let problem = "no point is left to be exported";
        return Err(Error::request(problem, "undo some of the edits"));
    }
    write_splats(path, &splats)?;
    Ok(counted(splats.len(), "splat"))
}

/// The mean distance of all points from the scene's origin, which is the network's first camera.
fn mean_distance(frames: &[Frame]) -> f64 {
    let points = frames
        .iter()
        .flat_map(|frame| (0..frame.depth.len()).filter_map(|index| frame.point(index)));
    let (sum, count) = points.fold((0.0, 0_u32), |(sum, count), point| {
        (sum + point.coords.norm(), count + 1)
    });
    sum / f64::from(count.max(1))
}

/// Colours are the points': the network was trained with those of the photos, and its own mean nothing.
fn splat(
    contents: &Contents,
    gaussians: &[Gaussians],
    index: usize,
    [least, most]: [f32; 2],
) -> Splat {
    let cloud = &contents.cloud;
    let source = cloud.sources[index];
    let gaussian = &gaussians[source.frame as usize];
    let pixel = source.pixel as usize;
    let motion = contents.motions.of(index);
    let [w, x, y, z] = [0, 1, 2, 3].map(|k| f64::from(gaussian.rotation[k].values()[pixel]));
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6);
    let rotation = motion.rotation * rotation.unwrap_or_default();
    let extent = |k: usize| {
        // Not clamp: what is no number becomes the least.
        let extent = gaussian.scale[k].values()[pixel].max(least).min(most);
        extent * motion.scale as f32
    };
    Splat {
        position: cloud.positions[index],
        colour: cloud.colours[index],
        opacity: gaussian.opacity.values()[pixel],
        extent: [0, 1, 2].map(extent),
        rotation: [rotation.w, rotation.i, rotation.j, rotation.k].map(|q| q as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Map,
        edit::Motions,
        geometry::Similarity,
        scene::{Cloud, test_frames::facing_wall},
    };
    use nalgebra::Vector3;
    use std::collections::BTreeMap;

    fn gaussians(opacity: f32, scale: [f32; 3], rotation: [f32; 4]) -> Gaussians {
        let map = |value| Map::filled(32, 24, value);
        Gaussians {
            opacity: map(opacity),
            scale: scale.map(map),
            rotation: rotation.map(map),
            colour: vec![],
        }
    }

    #[test]
    fn splats_go_where_their_points_went() {
        let frames = vec![facing_wall(0.0, 4.0)];
        let validity = [frames[0].depth.map(|_| true)];
        let cloud = Cloud::from_frames(&frames, &validity, None);
        let mut motions = Motions::none(cloud.len());
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        motions.add(
            &[1],
            &Similarity {
                scale: 3.0,
                rotation: turn,
                ..Similarity::identity()
            },
        );
        let contents = Contents {
            frames,
            cloud,
            motions,
            names: BTreeMap::new(),
        };
        let splat =
            |index, gaussians: Gaussians| splat(&contents, &[gaussians], index, [0.01, 0.1]);

        let plain = gaussians(0.5, [0.05, -1.0, 7.0], [0.0, 1.0, 0.0, 0.0]);
        let still = splat(0, plain.clone());
        assert_eq!(still.position, contents.cloud.positions[0]);
        assert_eq!(still.colour, contents.cloud.colours[0]);
        assert_eq!((still.opacity, still.extent), (0.5, [0.05, 0.01, 0.1]));
        assert_eq!(still.rotation, [0.0, 1.0, 0.0, 0.0]);

        let moved = splat(1, plain);
        assert!((moved.extent[0] - 0.15).abs() < 1e-6);
        // Half a turn about x, then a quarter about z.
        let [w, x, y, z] = moved.rotation;
        let half = std::f32::consts::FRAC_1_SQRT_2;
        assert!((x - half).abs() + (y - half).abs() + w.abs() + z.abs() < 1e-6);

        let noise = splat(0, gaussians(0.5, [f32::NAN; 3], [0.0; 4]));
        assert_eq!(
            (noise.extent, noise.rotation),
            ([0.01; 3], [1.0, 0.0, 0.0, 0.0])
        );
    }
}
