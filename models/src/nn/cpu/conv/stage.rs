//! Convolutions one after the other.

use candle_core::{Result, bail};

use super::{Convolution, Epilogue, Images};
use crate::nn::cpu::scratch::Scratch;

/// A convolution and what is done to its outputs.
pub(in crate::nn) struct Stage<'a> {
    pub(in crate::nn) convolution: &'a Convolution,
    pub(in crate::nn) inputs: usize,
    pub(in crate::nn) stride: usize,
    pub(in crate::nn) epilogue: Epilogue<'a>,
}

impl Stage<'_> {
    /// Numbers that come out of `images`.
    fn size(&self, images: Images) -> usize {
        images.strided(self.stride).pixels() * self.epilogue.bias.len()
    }

    /// Of `x`, which has `images.pixels()` times the inputs, into `out`, which has the outputs for each
    /// pixel of the strided images.
    ///
    /// # Errors
    ///
    /// If the sizes do not fit each other.
    pub(in crate::nn) fn run(&self, images: Images, x: &[f32], out: &mut [f32]) -> Result<()> {
        let (from, to) = (images.pixels() * self.inputs, self.size(images));
        let residual = self.epilogue.residual.map_or(to, <[f32]>::len);
        if (x.len(), out.len(), residual) != (from, to, to) {
            bail!(
                "{images:?} of {} channels to {} of stride {} are not {} numbers to {}",
                self.inputs,
                self.epilogue.bias.len(),
                self.stride,
                x.len(),
                out.len()
            );
        }
        self.convolution.run(images, x, self.epilogue, out)
    }
}

/// All `stages`, each on the outputs of the one before; `x` and `out` as for [`Stage::run`] of the
/// first and the last.
///
/// Images are processed one by one, so that what lies between stages, in two buffers that are kept
/// for the next call, does not grow with their number.
///
/// # Errors
///
/// As [`Stage::run`].
pub(in crate::nn) fn in_turn(
    stages: &[Stage<'_>],
    images: Images,
    x: &[f32],
    out: &mut [f32],
) -> Result<()> {
    let [between @ .., last] = stages else {
        bail!("there are no convolutions");
    };
    let one = Images { batch: 1, ..images };
    // Each stage's images, and those that come out at the end.
    let mut sizes = vec![one];
    for stage in stages {
        sizes.push(sizes[sizes.len() - 1].strided(stage.stride));
    }
    let size = |i: usize| stages[i].size(sizes[i]);
    let largest = (0..between.len()).map(size).max().unwrap_or(0);
    let mut buffers = [Scratch::take(largest), Scratch::take(largest)];
    let (from, to) = (one.pixels() * stages[0].inputs, size(between.len()));
    if (x.len(), out.len()) != (images.batch * from, images.batch * to) {
        bail!(
            "{} numbers and {} are not those of {images:?}",
            x.len(),
            out.len()
        );
    }
    for image in 0..images.batch {
        let x = &x[image * from..][..from];
        let out = &mut out[image * to..][..to];
        let [current, next] = &mut buffers;
        let (mut current, mut next) = (current, next);
        let mut filled = None;
        for (i, stage) in between.iter().enumerate() {
            let x = filled.map_or(x, |count| &current[..count]);
            stage.run(sizes[i], x, &mut next[..size(i)])?;
            filled = Some(size(i));
            std::mem::swap(&mut current, &mut next);
        }
        let x = filled.map_or(x, |count| &current[..count]);
        last.run(sizes[between.len()], x, out)?;
    }
    Ok(())
}
