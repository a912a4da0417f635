use super::contents::counted;
use crate::{
    Error, Map, Result,
    exchange::{
        cameras::CameraView,
        npz::{Header, NpzWriter, Number},
    },
    geometry::matrix4,
    scene::{Frame, Role, Scale, Scene, Stage, files},
};
use serde::Serialize;
use std::{
    io::{self, Cursor},
    path::Path,
};

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
    let size = [lens.height, lens.width].map(|side| side as usize);
    let write = || -> io::Result<Vec<u8>> {
        let mut archive = NpzWriter::new(Cursor::new(Vec::new()));
        for (name, map) in [("depth", &frame.depth), ("confidence", &frame.confidence)] {
            let values = map.values().iter().map(|&value| f64::from(value));
            archive.add(name, &Header::new(&size, Number::F32), values)?;
        }
        let pose = matrix4::rows(&frame.camera.cam_to_world);
        let square = |side| Header::new(&[side, side], Number::F64);
        archive.add("intrinsics", &square(3), matrix.into_iter().flatten())?;
        archive.add("cam_to_world", &square(4), pose.into_iter().flatten())?;
        Ok(archive.finish()?.into_inner())
    };
    let bytes = write().map_err(Error::io("write", path))?;
    files::write_atomically(path, |out| out.write_all(&bytes))
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
