//! A scene as a tree of entities.

use crate::{
    Error, Result,
    draw::colour_of,
    edit::EditList,
    exchange::rrd::{Archetype, Class, Entity, Rrd, write_rrd},
    export::{
        ExportParams,
        contents::{Contents, counted},
        depth, photos,
    },
    photos::{Photo, unreadable},
    scene::{Cloud, FrameRecord, Hasher, Role, Scene, Stage},
};
use image::ImageFormat;
use std::{
    collections::BTreeMap,
    fs,
    io::Cursor,
    path::{self, Path},
};

/// Writes an entity for each instance, called by its name, and one for each photo's camera, with the photo
/// and the depth below it. All is below `scene`, which turns it upright.
pub(in crate::export) fn write(
    scene: &Scene,
    path: &Path,
    params: &ExportParams,
) -> Result<String> {
    let contents = Contents::load(scene, &params.only)?;
    let clouds = contents.by_instance();
    let to_floor = scene.manifest().floor_to_world.inverse();
    let classes = classes(&contents, &clouds)?;
    let counts = [
        (contents.cloud.len(), "point"),
        (clouds.keys().filter(|&&id| id != 0).count(), "instance"),
        (scene.records(Role::Input).len(), "camera"),
    ];
    let mut entities = vec![
        entity(&[], vec![Archetype::ZUp]),
        entity(
            &["scene"],
            vec![
                Archetype::Transform(to_floor),
                Archetype::Classes(classes.clone()),
            ],
        ),
    ];
    entities.extend(instances(&classes, clouds));
    for record in scene.records(Role::Input) {
        entities.extend(camera(record, !params.no_photos)?);
    }
    if params.depth {
        for frame in depth::cleaned(scene)? {
            let lens = Archetype::Pinhole(frame.camera.intrinsics);
            let at = ["scene", "cameras", &frame.photo.name, "depth"];
            entities.push(entity(&at, vec![lens, Archetype::Depth(frame.depth)]));
        }
    }
    let folder = path::absolute(scene.folder()).map_err(Error::io("find", scene.folder()))?;
    let name = folder.file_name().unwrap_or_default();
    let rrd = Rrd {
        id: recording_id(scene, params)?,
        name: name.to_string_lossy().into_owned(),
        entities,
    };
    write_rrd(path, &rrd)?;
    Ok(counts.map(|(count, what)| counted(count, what)).join(", "))
}

fn entity(path: &[&str], contents: Vec<Archetype>) -> Entity {
    Entity {
        path: path.iter().map(|&part| part.to_owned()).collect(),
        contents,
    }
}

/// The instances that there are, under labels of their own: what is called as another has its id behind it.
fn classes(contents: &Contents, clouds: &BTreeMap<u32, Cloud>) -> Result<Vec<Class>> {
    let is_double = |name: &str| {
        let same = clouds.keys().filter(|&&id| contents.name(id) == name);
        same.count() > 1
    };
    let class = |&number: &u32| {
        let Ok(id) = u16::try_from(number) else {
            return Err(Error::request(
                format!(
                    "there is an instance {number}, and Rerun has numbers up to {}",
                    u16::MAX
                ),
                "write another format, or others only (--only)",
            ));
        };
        let name = contents.name(number);
        Ok(Class {
            id,
            label: match is_double(name) {
                true => format!("{name} ({id})"),
                false => name.to_owned(),
            },
            colour: match id {
                0 => [128; 3],
                _ => colour_of(number),
            },
        })
    };
    clouds.keys().map(class).collect()
}

fn instances(classes: &[Class], clouds: BTreeMap<u32, Cloud>) -> impl Iterator<Item = Entity> {
    classes.iter().zip(clouds).map(|(class, (_, cloud))| {
        let points = Archetype::Points {
            positions: cloud.positions,
            colours: cloud.colours,
            radii: cloud.radii,
            class: class.id,
        };
        entity(&["scene", "instances", &class.label], vec![points])
    })
}

/// A camera, and its photo as it was photographed. Lens and picture are an entity of their own: a depth map
/// beside it has another lens.
fn camera(record: &FrameRecord, with_photo: bool) -> Result<[Entity; 2]> {
    let (name, camera) = (&record.photo.name, photos::camera(record));
    let mut photo = vec![Archetype::Pinhole(camera.intrinsics)];
    if with_photo {
        photos::check(record)?;
        photo.push(picture(&record.photo)?);
    }
    let pose = vec![Archetype::Transform(camera.cam_to_world)];
    Ok([
        entity(&["scene", "cameras", name], pose),
        entity(&["scene", "cameras", name, "photo"], photo),
    ])
}

/// A photo as Rerun can show it: the file itself, if that is JPEG or PNG the right way up, else a PNG.
fn picture(photo: &Photo) -> Result<Archetype> {
    let file = fs::read(&photo.path).map_err(Error::io("read", &photo.path))?;
    let media_type = match image::guess_format(&file) {
        Ok(format @ (ImageFormat::Jpeg | ImageFormat::Png)) if photo.is_stored_upright()? => {
            format.to_mime_type()
        }
        _ => {
            let mut png = Cursor::new(Vec::new());
            let written = photo.load()?.write_to(&mut png, ImageFormat::Png);
            written.map_err(|error| unreadable(&photo.path, error))?;
            return Ok(Archetype::Picture {
                file: png.into_inner(),
                media_type: ImageFormat::Png.to_mime_type(),
            });
        }
    };
    Ok(Archetype::Picture { file, media_type })
}

/// An id that changes with whatever the recording shows.
fn recording_id(scene: &Scene, params: &ExportParams) -> Result<String> {
    let mut hasher = Hasher::new();
    hasher.text(env!("CARGO_PKG_VERSION"));
    for (stage, record) in &scene.manifest().stages {
        hasher.text(&format!("{stage:?}")).text(&record.output);
    }
    if scene.manifest().stages.contains_key(&Stage::Unify) {
        let edits = EditList::load(scene)?;
        hasher.text(&serde_json::json!(edits.edits()).to_string());
    }
    hasher.text(&format!("{params:?}"));
    Ok(hasher.finish())
}

#[cfg(test)]
mod tests;
