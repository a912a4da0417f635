//! A scene of three photos of 16 x 12 pixels, each with two instances.

use crate::prepared;
use std::path::Path;
use tid3r::{
    Result,
    exchange::recording::{ImportOptions, Recording},
    progress::Silent,
    reconstruct::{self, CleanParams, NewScene},
    scene::{Frame, Scale, WriteLock},
    segment::{Mask, MaskParams, Segmentation, Segmenter, UnifyParams},
};

/// The left and the right half of each photo.
struct Halves;

impl Segmenter for Halves {
    fn segment(&self, frame: &Frame, _: &mut dyn FnMut(f64)) -> Result<Vec<Mask>> {
        let (width, height) = (frame.depth.width(), frame.depth.height());
        let half = |right: bool| {
            let pixels = (0..width * height).filter(move |at| (at % width >= width / 2) == right);
            Mask::from_pixels(pixels, 1.0)
        };
        Ok(vec![half(false), half(true)])
    }
}

/// Makes the scene in a folder.
///
/// # Errors
/// When it cannot be made: then nothing can be tested.
pub fn make_scene(folder: &Path) -> Result<()> {
    let lock = WriteLock::acquire(folder)?;
    let recording = Recording::open(
        &prepared("recordings/seven_scenes"),
        &ImportOptions::default(),
        &folder.join("photos"),
    )?;
    let mut scene = NewScene {
        reconstructor: &recording,
        inputs: &recording.inputs,
        held_out: &[],
        scale: Scale::Metric,
        parameters: serde_json::json!({}),
    }
    .create(folder, false, &lock, &Silent)?;
    reconstruct::clean(&mut scene, &CleanParams::default(), false, &lock, &Silent)?;
    Segmentation {
        segmenter: &Halves,
        description: serde_json::json!("halves"),
        masks: MaskParams::default(),
        unify: Some(UnifyParams::default()),
    }
    .run(&mut scene, false, &lock, &Silent)?;
    Ok(())
}
