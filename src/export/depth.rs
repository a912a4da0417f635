use super::contents::counted;
use crate::{
    Error, Map, Result,
    exchange::cameras::CameraView,
    geometry::matrix4,
    scene::{Frame, Role, Scale, Scene, Stage, files},
};
use npyz::{WriterBuilder, npz::file_name_from_array_name};
use serde::Serialize;
use std::{
    io::{self, Cursor},
    path::Path,
};
use zip::{ZipWriter, write::SimpleFileOptions};

/// `depth.json`.
#[derive(Serialize)]
struct Description {
    scale: Scale,
    /// Scene units for a step of a depth PNG, 0 being unknown.
    depth_unit: f64,
    /// Confidence for a step of a confidence PNG.
    confidence_unit: f64,
    /// Lens and pose of each photo's maps.
    frames: Vec<CameraView>,
}

/// Steps of a PNG of 16 bits, beside 0.
const STEPS: f64 = 65535.0;

/// Writes the maps of all photos, in the size that they have in the scene. What the cleaning took away is
/// unknown.
pub(super) fn write(scene: &Scene, folder: &Path) -> Result<String> {
    let frames = cleaned(scene)?;
    let scale = scene.manifest().scale;
    let (depth_unit, confidence_unit) = (depth_unit(&frames, scale), confidence_unit(&frames));
    for frame in &frames {
        let at = |ending: &str| folder.join(format!("{}{ending}", frame.photo.name));
        files::write_label_png(&at(".depth.png"), &in_steps(&frame.depth, depth_unit))?;
        let confidence = in_steps(&frame.confidence, confidence_unit);
        files::write_label_png(&at(".confidence.png"), &confidence)?;
        write_npz(&at(".npz"), frame)?;
    }
    let view = |frame: &Frame| CameraView {
        name: Some(frame.photo.name.clone()),
        cam_to_world: frame.camera.cam_to_world,
        intrinsics: Some(frame.camera.intrinsics),
    };
    let description = Description {
        scale,
        depth_unit,
        confidence_unit,
        frames: frames.iter().map(view).collect(),
    };
    files::write_json(&folder.join("depth.json"), &description)?;
    Ok(format!("depth of {}", counted(frames.len(), "photo")))
}

/// The input frames, without the depth that the cleaning took away, if the scene has been cleaned.
pub(super) fn cleaned(scene: &Scene) -> Result<Vec<Frame>> {
    let mut frames = scene.frames(Role::Input)?;
    if scene.manifest().fresh(Stage::Clean).is_some() {
        let validity = scene.maps::<bool>(Stage::Clean)?;
        for (frame, valid) in frames.iter_mut().zip(&validity) {
            for (depth, valid) in frame.depth.values_mut().iter_mut().zip(valid.values()) {
                *depth = if *valid { *depth } else { 0.0 };
            }
        }
    }
    Ok(frames)
}

/// Scene units for a step: millimetres, or so that the farthest depth of all frames fits.
pub(super) fn depth_unit(frames: &[Frame], scale: Scale) -> f64 {
    match scale {
        Scale::Metric => 1e-3,
        Scale::Relative => unit(frames.iter().map(|frame| &frame.depth)),
    }
}

fn confidence_unit(frames: &[Frame]) -> f64 {
    unit(frames.iter().map(|frame| &frame.confidence))
}

fn unit<'a>(maps: impl Iterator<Item = &'a Map<f32>>) -> f64 {
    let highest = maps.flat_map(Map::values).copied().fold(0.0, f32::max);
    match highest > 0.0 && highest.is_finite() {
        true => f64::from(highest) / STEPS,
        false => 1.0,
    }
}

/// Values as steps: at least one for what is above 0. What is beyond the last becomes 0 when it is written.
pub(super) fn in_steps(map: &Map<f32>, unit: f64) -> Map<u32> {
    map.map(|&value| match value > 0.0 {
        true => (f64::from(value) / unit).round().max(1.0) as u32,
        false => 0,
    })
}

/// Writes `depth` and `confidence` (height, width), `intrinsics` (3, 3) and `cam_to_world` (4, 4).
fn write_npz(path: &Path, frame: &Frame) -> Result<()> {
    let lens = &frame.camera.intrinsics;
    let matrix = [
        [lens.fx, 0.0, lens.cx],
        [0.0, lens.fy, lens.cy],
        [0.0, 0.0, 1.0],
    ];
    let size = [lens.height, lens.width].map(u64::from);
    let mut bytes = Cursor::new(Vec::new());
    let mut archive = ZipWriter::new(&mut bytes);
    let mut write = || -> io::Result<()> {
        for (name, map) in [("depth", &frame.depth), ("confidence", &frame.confidence)] {
            add(&mut archive, name, &size, map.values())?;
        }
        let pose = matrix4::rows(&frame.camera.cam_to_world);
        add(&mut archive, "intrinsics", &[3, 3], matrix.as_flattened())?;
        add(&mut archive, "cam_to_world", &[4, 4], pose.as_flattened())
    };
    write().map_err(Error::io("write", path))?;
    let finished = archive.finish().map(drop).map_err(io::Error::from);
    finished.map_err(Error::io("write", path))?;
    files::write_atomically(path, |out| out.write_all(bytes.get_ref()))
}

/// Adds an array to an archive, without a time: the same scene gives the same file.
fn add<T: npyz::AutoSerialize + Copy>(
    archive: &mut ZipWriter<&mut Cursor<Vec<u8>>>,
    name: &str,
    shape: &[u64],
    values: &[T],
) -> io::Result<()> {
    let options = SimpleFileOptions::default().last_modified_time(zip::DateTime::default());
    archive.start_file(file_name_from_array_name(name), options)?;
    let array = npyz::WriteOptions::new().default_dtype().shape(shape);
    let mut array = array.writer(archive).begin_nd()?;
    array.extend(values.iter().copied())?;
    array.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::facing_wall;

    #[test]
    fn the_farthest_fits_and_nothing_known_becomes_unknown() {
        let map = Map::new(4, 1, vec![0.0, 1e-9, 2.0, 5.0]).unwrap();
        let unit = unit([&map].into_iter());
        assert_eq!(in_steps(&map, unit).values(), [0, 1, 26214, 65535]);
        let frames = [facing_wall(0.0, 4.0)];
        assert_eq!(depth_unit(&frames, Scale::Metric), 1e-3);
        assert_eq!(depth_unit(&frames, Scale::Relative), 4.0 / 65535.0);
        assert_eq!(depth_unit(&[], Scale::Relative), 1.0);
    }
}
