//! Convolutions one after the other.

use candle_core::{Result, bail};

use super::{Convolution, Epilogue, Images, Part, Pixels, Steps};
use crate::nn::cpu::scratch::Scratch;
use crate::nn::cpu::shared::filled;
use crate::nn::profile::Timer;

/// A convolution and what is done to its outputs.
pub(in crate::nn) struct Stage<'a> {
    pub(in crate::nn) convolution: &'a Convolution,
    pub(in crate::nn) inputs: usize,
    pub(in crate::nn) steps: Steps,
    pub(in crate::nn) epilogue: Epilogue<'a>,
}

impl Stage<'_> {
    /// Numbers that come out of `images`.
    fn size(&self, images: Images) -> usize {
        self.steps.over(images).pixels() * self.epilogue.bias.len()
    }

    /// Of images, whose channels are those of `parts` one after the other: the outputs of each pixel of
    /// the strided images.
    ///
    /// # Errors
    ///
    /// If the sizes do not fit each other, or as [`Convolution::run`].
    pub(in crate::nn) fn run(&self, images: Images, parts: &[Part<'_>]) -> Result<Vec<f32>> {
        // SAFETY: that many numbers are written.
        unsafe { filled(self.size(images), |out| self.run_into(images, parts, out)) }
    }

    /// [`Self::run`] into `out`.
    ///
    /// # Safety
    ///
    /// `out` can be written for the outputs of each pixel of the strided images, by nobody else. It is
    /// written unless there is an error.
    unsafe fn run_into(&self, images: Images, parts: &[Part<'_>], out: *mut f32) -> Result<()> {
        let inputs: usize = parts.iter().map(|part| part.pixels.channels()).sum();
        if inputs != self.inputs {
            bail!("{} channels are wanted, got {inputs}", self.inputs);
        }
        parts.iter().try_for_each(|part| part.check(images))?;
        let strided = self.steps.over(images);
        if let Some(residual) = self.epilogue.residual {
            residual.check(strided.pixels(), self.epilogue.bias.len())?;
        }
        if self.size(images) == 0 {
            return Ok(());
        }
        let (operation, work) = self.convolution.work(images, parts);
        let _timer = Timer::start(operation, work);
        // SAFETY: just made sure of, and as the caller promises.
        unsafe { self.convolution.run(images, parts, self.epilogue, out) }
    }
}

/// All `stages`, each on the outputs of the one before; `x` goes into the first.
///
/// Images are processed one by one, so that what lies between stages, in two buffers that are kept
/// for the next call, does not grow with their number.
///
/// # Errors
///
/// As [`Stage::run`].
pub(in crate::nn) fn in_turn(stages: &[Stage<'_>], images: Images, x: &[f32]) -> Result<Vec<f32>> {
    let [between @ .., last] = stages else {
        bail!("there are no convolutions");
    };
    let one = Images { batch: 1, ..images };
    // Each stage's images, and those that come out at the end.
    let mut sizes = vec![one];
    for stage in stages {
        sizes.push(stage.steps.over(sizes[sizes.len() - 1]));
    }
    let size = |i: usize| stages[i].size(sizes[i]);
    let largest = (0..between.len()).map(size).max().unwrap_or(0);
    let mut buffers = [Scratch::take(largest), Scratch::take(largest)];
    let (from, to) = (one.pixels() * stages[0].inputs, size(between.len()));
    if x.len() != images.batch * from {
        bail!("{} numbers are not those of {images:?}", x.len());
    }
    let mut of_image = |x: &[f32], out: *mut f32| -> Result<()> {
        let [current, next] = &mut buffers;
        let (mut current, mut next) = (current, next);
        let mut done = None;
        for (i, stage) in between.iter().enumerate() {
            let x = done.map_or(x, |count| &current[..count]);
            let parts = [Part::new(Pixels::new(x, stage.inputs))];
            // SAFETY: buffers are large enough for all stages.
            unsafe { stage.run_into(sizes[i], &parts, next.as_mut_ptr())? };
            done = Some(size(i));
            std::mem::swap(&mut current, &mut next);
        }
        let x = done.map_or(x, |count| &current[..count]);
        let parts = [Part::new(Pixels::new(x, last.inputs))];
        // SAFETY: the image's part of the array has that size.
        unsafe { last.run_into(sizes[between.len()], &parts, out) }
    };
    let of_images = |out: *mut f32| {
        (0..images.batch).try_for_each(|image| {
            of_image(&x[image * from..][..from], out.wrapping_add(image * to))
        })
    };
    // SAFETY: each image's part is written.
    unsafe { filled(images.batch * to, of_images) }
}
