//! Timesteps as the network sees them.

use candle_core::{Device, Result, Tensor, bail};

use super::Config;
use crate::Weights;
use crate::nn::{Activation, Linear};

/// Cosines, then sines, of `timesteps` at `channels / 2` frequencies from 1 down to 1/10000: (timesteps,
/// channels), f32 on the CPU. An odd number of channels ends with a 0.
///
/// Upstream: `timestep_embedding`.
///
/// # Errors
///
/// Those of candle.
pub fn timestep_embedding(timesteps: &[f32], channels: usize) -> Result<Tensor> {
    const SLOWEST: f64 = 10_000.0;
    let half = channels / 2;
    // In f32, as upstream: an argument of some 1000 has an error of 6e-5 that everybody has.
    let step = -(SLOWEST.ln() as f32);
    let frequency = |i: usize| (step * i as f32 / half as f32).exp();
    let mut values = Vec::with_capacity(timesteps.len() * channels);
    for &timestep in timesteps {
        let argument = |i| f64::from(timestep * frequency(i));
        values.extend((0..half).map(|i| argument(i).cos() as f32));
        values.extend((0..half).map(|i| argument(i).sin() as f32));
        values.extend((2 * half..channels).map(|_| 0.0));
    }
    Tensor::from_vec(values, (timesteps.len(), channels), &Device::Cpu)
}

/// The layers that embed timesteps (`time_embed`).
#[derive(Clone, Debug)]
pub(super) struct TimeEmbed {
    first: Linear,
    second: Linear,
    channels: usize,
}

impl TimeEmbed {
    /// Reads `0` and `2`.
    pub(super) fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let (channels, hidden) = (config.model_channels, config.embedding_channels());
        Ok(Self {
            first: Linear::new(channels, hidden, &weights.pp(0))?,
            second: Linear::new(hidden, hidden, &weights.pp(2))?,
            channels,
        })
    }

    /// The embedding of the timestep of each frame, on `device`.
    pub(super) fn forward(&self, timesteps: &[f32], device: &Device) -> Result<Embedding> {
        let mut distinct: Vec<f32> = Vec::new();
        let of_frame = (timesteps.iter())
            .map(|timestep| {
                let known =
                    (distinct.iter()).position(|other| other.to_bits() == timestep.to_bits());
                known.unwrap_or_else(|| {
                    distinct.push(*timestep);
                    distinct.len() - 1
                }) as u32
            })
            .collect();
        let waves = timestep_embedding(&distinct, self.channels)?.to_device(device)?;
        let hidden = self.first.forward(&waves, Activation::Silu)?;
        Embedding::new(
            self.second.forward(&hidden, Activation::Identity)?,
            of_frame,
        )
    }
}

/// The embedded timesteps of frames. What is the same for several frames is computed once.
#[derive(Clone, Debug)]
pub struct Embedding {
    /// (distinct timesteps, channels).
    embedded: Tensor,
    /// SiLU of that.
    active: Tensor,
    /// Which of them each frame has.
    of_frame: Vec<u32>,
}

impl Embedding {
    /// `embedded` is (distinct timesteps, channels); frame `i` has number `of_frame[i]` of them.
    ///
    /// # Errors
    ///
    /// If a frame has none, or `embedded` holds integers.
    pub fn new(embedded: Tensor, of_frame: Vec<u32>) -> Result<Self> {
        let distinct = embedded.dims2()?.0;
        if let Some(other) = of_frame.iter().find(|&&index| index as usize >= distinct) {
            bail!("there are {distinct} embedded timesteps, and none of number {other}");
        }
        let active = Activation::Silu.apply(&embedded)?;
        Ok(Self {
            embedded,
            active,
            of_frame,
        })
    }

    /// The embedding of each frame, (frames, channels).
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn tensor(&self) -> Result<Tensor> {
        self.of_frames(&self.embedded)
    }

    /// What `layer` makes of the embeddings' SiLU, spread over maps (frames, height, width, outputs); a
    /// view of some numbers if all frames have the same timestep.
    pub(super) fn spread(&self, layer: &Linear, (height, width): (usize, usize)) -> Result<Tensor> {
        let shift = layer.forward(&self.active, Activation::Identity)?;
        let outputs = shift.dim(1)?;
        let shift = match shift.dim(0)? {
            1 => shift,
            _ => self.of_frames(&shift)?,
        };
        let shift = shift.reshape(((), 1, 1, outputs))?;
        shift.broadcast_as((self.of_frame.len(), height, width, outputs))
    }

    /// Number of frames.
    pub(super) fn frames(&self) -> usize {
        self.of_frame.len()
    }

    fn of_frames(&self, distinct: &Tensor) -> Result<Tensor> {
        let index = Tensor::new(&self.of_frame[..], distinct.device())?;
        distinct.index_select(&index, 0)
    }
}
