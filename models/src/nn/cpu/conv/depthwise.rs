//! Convolutions of each channel by itself: nothing to multiply matrices with, but vectors of channels.

use candle_core::{Result, bail};
use rayon::prelude::*;

use super::{Images, Pixels};
use crate::nn::Activation;
use crate::nn::cpu::isa::{Isa, Task};
use crate::nn::cpu::math::activate;
use crate::nn::cpu::shared::{Shared, filled};
use crate::nn::cpu::simd::Simd;
use crate::nn::profile::{Operation, Timer};

/// Channels whose weights lie together: a multiple of all vectors.
const BLOCK: usize = 16;
/// Outputs of a row that are summed together.
const OUTPUTS: usize = 4;
/// The most inputs of a row that these depend on: for a kernel of 5 and stride 2.
const INPUTS: usize = (OUTPUTS - 1) * 2 + 5;

/// A depthwise convolution with its weights laid out.
pub(in crate::nn) struct Depthwise {
    isa: Isa,
    channels: usize,
    kernel: usize,
    stride: usize,
    /// For each [`BLOCK`] of channels, the weights of each place of the window and the bias.
    weights: Vec<f32>,
}

impl Depthwise {
    /// Whether there is a kernel for this.
    pub(in crate::nn) fn fits(kernel: usize, stride: usize) -> bool {
        matches!((kernel, stride), (3 | 5, 1 | 2))
    }

    /// Lays out `weight` (channels, kernel, kernel) and `bias` (channels).
    ///
    /// # Errors
    ///
    /// If these are not as many, or it does not [fit](Self::fits).
    pub(in crate::nn) fn new(
        isa: Isa,
        weight: &[f32],
        bias: &[f32],
        kernel: usize,
        stride: usize,
    ) -> Result<Self> {
        let (channels, places) = (bias.len(), kernel * kernel);
        if !Self::fits(kernel, stride) || weight.len() != channels * places {
            bail!(
                "{} weights for {channels} channels, {kernel} x {kernel}, stride {stride}",
                weight.len()
            );
        }
        let mut weights = vec![0.0; channels.next_multiple_of(BLOCK) * (places + 1)];
        for (channel, window) in weight.chunks_exact(places).enumerate() {
            let block = &mut weights[channel / BLOCK * BLOCK * (places + 1)..];
            for (place, &weight) in window.iter().enumerate() {
                block[place * BLOCK + channel % BLOCK] = weight;
            }
            block[places * BLOCK + channel % BLOCK] = bias[channel];
        }
        Ok(Self {
            isa,
            channels,
            kernel,
            stride,
            weights,
        })
    }

    /// `activation(conv(x) + bias)`: the channels of each pixel of the strided images.
    ///
    /// # Errors
    ///
    /// If `x` has other channels or not `images.pixels()`.
    pub(in crate::nn) fn run(
        &self,
        images: Images,
        x: Pixels<'_>,
        activation: Activation,
    ) -> Result<Vec<f32>> {
        x.check(images.pixels(), self.channels)?;
        let strided = images.strided(self.stride);
        let taps = self.kernel * self.kernel;
        let _timer = Timer::start(
            Operation::Depthwise,
            strided.pixels() * self.channels * taps,
        );
        let zeros = vec![0.0; self.channels];
        let size = strided.width * self.channels;
        let rows = strided.batch * strided.height;
        let of_rows = |out: *mut f32| {
            let out = Shared(out);
            (0..rows)
                .into_par_iter()
                .with_min_len((1 << 13) / size.max(1) + 1)
                .for_each(|i| {
                    let row = Row {
                        layer: self,
                        images,
                        x,
                        zeros: &zeros,
                        image: i / strided.height,
                        y: i % strided.height,
                        width: strided.width,
                        activation,
                        out: out.add(i * size),
                    };
                    match (self.kernel, self.stride) {
                        (3, 1) => self.isa.run(Sized::<3, 1>(row)),
                        (3, 2) => self.isa.run(Sized::<3, 2>(row)),
                        (5, 1) => self.isa.run(Sized::<5, 1>(row)),
                        _ => self.isa.run(Sized::<5, 2>(row)),
                    }
                });
            Ok(())
        };
        // SAFETY: each row is written once, and together they are the whole.
        unsafe { filled(rows * size, of_rows) }
    }
}

/// A row of outputs.
struct Row<'a> {
    layer: &'a Depthwise,
    images: Images,
    x: Pixels<'a>,
    /// A pixel outside of the image.
    zeros: &'a [f32],
    image: usize,
    y: usize,
    /// Pixels of the row.
    width: usize,
    activation: Activation,
    /// Where the row goes.
    out: *mut f32,
}

/// A row for a kernel of `K` and a stride of `T`.
struct Sized<'a, const K: usize, const T: usize>(Row<'a>);

impl<const K: usize, const T: usize> Task for Sized<'_, K, T> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let row = self.0;
        let channels = row.layer.channels;
        let whole = channels - channels % S::LANES;
        for left in (0..row.width).step_by(OUTPUTS) {
            let window = row.window::<K, T>(left);
            let count = OUTPUTS.min(row.width - left);
            for c in (0..whole).step_by(S::LANES) {
                // SAFETY: pixels, and the row's outputs, have these channels.
                unsafe {
                    row.block::<S, K, T, true>(simd, c, S::LANES, left..left + count, &window);
                }
            }
            if whole < channels {
                let rest = channels - whole;
                // SAFETY: as above.
                unsafe {
                    row.block::<S, K, T, false>(simd, whole, rest, left..left + count, &window);
                }
            }
        }
    }
}

impl Row<'_> {
    /// The pixels that the outputs from `left` on depend on.
    #[inline(always)]
    fn window<const K: usize, const T: usize>(&self, left: usize) -> [[*const f32; INPUTS]; K] {
        let Images { height, width, .. } = self.images;
        let mut window = [[self.zeros.as_ptr(); INPUTS]; K];
        for (i, pixels) in window.iter_mut().enumerate() {
            let y = (self.y * T + i).wrapping_sub(K / 2);
            if y >= height {
                continue;
            }
            let start = (self.image * height + y) * width;
            for (j, pixel) in pixels[..(OUTPUTS - 1) * T + K].iter_mut().enumerate() {
                let x = (left * T + j).wrapping_sub(K / 2);
                if x < width {
                    *pixel = self.x.pixel(start + x).as_ptr();
                }
            }
        }
        window
    }

    /// `lanes` channels from `channel` on, a vector if `WHOLE`, of some outputs.
    ///
    /// # Safety
    ///
    /// These channels of the window can be read, and those of the outputs written.
    #[inline(always)]
    unsafe fn block<S: Simd, const K: usize, const T: usize, const WHOLE: bool>(
        &self,
        simd: S,
        channel: usize,
        lanes: usize,
        outputs: std::ops::Range<usize>,
        window: &[[*const f32; INPUTS]; K],
    ) {
        let channels = self.layer.channels;
        let block = channel / BLOCK * BLOCK * (K * K + 1) + channel % BLOCK;
        // There are weights for each place and a bias, and blocks are whole vectors.
        let places = self.layer.weights[block..][..K * K * BLOCK + S::LANES].as_ptr();
        // SAFETY: the bias is the last of these.
        let mut sums = [unsafe { simd.load(places.add(K * K * BLOCK)) }; OUTPUTS];
        for (i, pixels) in window.iter().enumerate() {
            let mut weights = [simd.splat(0.0); K];
            for (j, to) in weights.iter_mut().enumerate() {
                // SAFETY: inside of the block.
                *to = unsafe { simd.load(places.add((i * K + j) * BLOCK)) };
            }
            for (j, pixel) in pixels[..(OUTPUTS - 1) * T + K].iter().enumerate() {
                // SAFETY: as the caller promises.
                let x = unsafe { simd.load_of::<WHOLE>(pixel.add(channel), lanes) };
                for (o, sum) in sums.iter_mut().enumerate() {
                    if j >= o * T && j < o * T + K {
                        *sum = simd.fma(weights[j - o * T], x, *sum);
                    }
                }
            }
        }
        for (output, &sum) in outputs.zip(&sums) {
            let y = activate(simd, self.activation, sum);
            // SAFETY: as the caller promises.
            unsafe {
                let to = self.out.add(output * channels + channel);
                simd.store_of::<WHOLE>(to, lanes, y);
            }
        }
    }
}
