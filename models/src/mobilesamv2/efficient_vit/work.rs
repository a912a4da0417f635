//! How much there is to compute.

use super::attention::EfficientVitBlock;
use super::backbone::{EXPAND, HALVING_EXPAND};
use super::blocks::Sizes;
use super::neck::{self, Neck};
use super::{Config, EfficientVit, LiteMla};

/// Multiply-adds for one image. Convolutions count as sums over their kernels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// Each stage of the backbone.
    pub stages: [f64; 5],
    /// The neck's convolutions before and after its blocks.
    pub neck_ends: f64,
    /// Each block of the neck.
    pub neck_block: f64,
    /// The neck's blocks.
    pub neck_blocks: usize,
}

impl Work {
    /// The work of a network of this configuration.
    pub fn new(config: &Config) -> Self {
        let widths = config.width_list;
        let stage = |i: usize| {
            let pixels = pixels(i) as f64;
            let blocks = config.depth_list[i] as f64;
            let (width, same) = (widths[i], Sizes::same(widths[i], EXPAND));
            let halving = |of: fn(Sizes, f64) -> f64| {
                of(
                    Sizes::halving(widths[i - 1], width, HALVING_EXPAND[i]),
                    pixels,
                )
            };
            match i {
                0 => {
                    let width = width as f64;
                    pixels * 9.0 * (3.0 * width + blocks * 2.0 * width * width)
                }
                1 | 2 => halving(fused) + blocks * fused(same, pixels),
                3 => halving(inverted) + blocks * inverted(same, pixels),
                _ => halving(inverted) + blocks * attention(config, pixels),
            }
        };
        let grid = (Neck::SIDE * Neck::SIDE) as f64;
        let channels = config.head_width as f64;
        let inputs = neck::STAGES.map(|i| (pixels(i) * widths[i]) as f64 * channels);
        Self {
            stages: [0, 1, 2, 3, 4].map(stage),
            neck_ends: inputs.iter().sum::<f64>() + grid * channels * config.out_dim as f64,
            neck_block: fused(Sizes::same(config.head_width, config.expand_ratio), grid),
            neck_blocks: config.head_depth,
        }
    }

    /// All of the neck.
    pub fn neck(&self) -> f64 {
        self.neck_ends + self.neck_blocks as f64 * self.neck_block
    }

    /// All of it.
    pub fn total(&self) -> f64 {
        self.stages.iter().sum::<f64>() + self.neck()
    }
}

/// Pixels of what stage `i` makes.
pub(super) fn pixels(stage: usize) -> usize {
    (EfficientVit::SIDE >> (stage + 1)).pow(2)
}

/// A fused block that makes so many pixels.
fn fused(sizes: Sizes, pixels: f64) -> f64 {
    pixels * sizes.hidden as f64 * (9 * sizes.inputs + sizes.outputs) as f64
}

/// A block with a depthwise convolution that makes so many pixels.
fn inverted(sizes: Sizes, pixels: f64) -> f64 {
    let before = (sizes.stride * sizes.stride * sizes.inputs) as f64;
    pixels * sizes.hidden as f64 * (before + 9.0 + sizes.outputs as f64)
}

/// A block of the last stage.
fn attention(config: &Config, pixels: f64) -> f64 {
    let (width, dim) = (config.width_list[4], config.qkv_dim);
    let inner = config.heads() * dim;
    let projections = 3 * inner * width + 2 * inner * width;
    let second_scale = 3 * inner * (LiteMla::SCALE * LiteMla::SCALE + dim);
    let heads = 2 * config.heads() * 2 * dim * (dim + 1);
    let local = Sizes::same(width, EfficientVitBlock::EXPAND_RATIO);
    pixels * (projections + second_scale + heads) as f64 + inverted(local, pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_network() {
        // In 10^9, counted by hand from the layers' sizes; 68.6 were measured in the original.
        let work = Work::new(&Config::released());
        let giga = |work: f64| (work / 1e7).round() / 100.0;
        assert_eq!(work.stages.map(giga), [1.26, 8.32, 8.32, 6.0, 11.93]);
        assert_eq!(giga(work.neck()), 32.72);
        assert_eq!(giga(work.total()), 68.55);
    }
}
