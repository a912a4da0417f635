//! How much memory a run takes.

use std::collections::BTreeMap;

use candle_core::Result;

use super::{Config, Decoder, Encoder, Tiling};
use crate::Footprint;

/// Estimated peak of memory of one half on any number of pictures, in bytes, without what the program
/// itself needs and without the pictures and latents of others than the one at hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights, and those of a few convolutions once more, as they are laid out.
    pub weights: usize,
    /// Everything else: the maps that are alive at once in the largest tile's largest block.
    pub working: usize,
}

impl Memory {
    /// The memory to encode pictures of `height` x `width` pixels, with weights of this footprint.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or tiles cannot be of the size that the tiling
    /// says.
    pub fn of_encoding(
        config: &Config,
        (height, width): (usize, usize),
        tiling: Tiling,
        footprint: Footprint,
    ) -> Result<Self> {
        let weights = weights(&Encoder::tensors(config)?, footprint);
        let widths = &config.block_out_channels;
        let (rows, columns) = largest(&tiling.of_encoding(config)?.sizes((height, width)));
        let pixels = |level: usize| (rows >> level) * (columns >> level);
        let level = |i: usize| {
            let (inputs, outputs) = (widths[i.saturating_sub(1)], widths[i]);
            pixels(i) * residual_block(inputs, outputs)
        };
        let levels = (0..widths.len()).map(level).max().unwrap_or(0);
        let last = widths.len() - 1;
        let maps = levels.max(pixels(last) * attention(widths[last]));
        let maps = maps + freed(widths[0]) * pixels(0) + config.in_channels * height * width;
        Ok(Self {
            weights,
            working: maps * size_of::<f32>(),
        })
    }

    /// The memory to decode pictures of `height` x `width` pixels, with weights of this footprint.
    ///
    /// # Errors
    ///
    /// As [`Self::of_encoding`].
    pub fn of_decoding(
        config: &Config,
        (height, width): (usize, usize),
        tiling: Tiling,
        footprint: Footprint,
    ) -> Result<Self> {
        let weights = weights(&Decoder::tensors(config)?, footprint);
        let widths: Vec<usize> = config.block_out_channels.iter().rev().copied().collect();
        let latents = (height / config.scale(), width / config.scale());
        let (rows, columns) = largest(&tiling.of_decoding(config)?.sizes(latents));
        let pixels = |level: usize| (rows << level) * (columns << level);
        let level = |i: usize| {
            let (inputs, outputs) = (widths[i.saturating_sub(1)], widths[i]);
            let up = match i + 1 == widths.len() {
                true => 0,
                false => 5 * outputs,
            };
            pixels(i) * residual_block(inputs, outputs).max(up)
        };
        let levels = (0..widths.len()).map(level).max().unwrap_or(0);
        let maps = levels.max(pixels(0) * attention(widths[0]));
        // What the widest convolutions hold while they run, by measurement. When pictures are encoded, these are
        // where maps are small.
        const SCRATCH: usize = 88 << 20;
        let last = widths.len() - 1;
        let maps = maps + freed(widths[last]) * pixels(last) + config.out_channels * height * width;
        Ok(Self {
            weights,
            working: maps * size_of::<f32>() + SCRATCH,
        })
    }

    /// All of it.
    pub fn total(&self) -> usize {
        self.weights + self.working
    }
}

/// Bytes that stay while a network of these tensors is in memory.
fn weights(tensors: &BTreeMap<String, Vec<usize>>, footprint: Footprint) -> usize {
    let (mut weights, mut laid_out) = (0, 0);
    for (name, shape) in tensors {
        let count: usize = shape.iter().product();
        weights += count;
        laid_out += match shape[..] {
            // Transformed on the way, part by part.
            [outputs, inputs, 3, 3]
                if outputs.min(inputs) >= 32 && !name.contains("downsamplers") =>
            {
                0
            }
            [_, _, _, _] => count,
            _ => 0,
        };
    }
    footprint.bytes(weights) + laid_out * size_of::<f32>()
}

fn largest(tiles: &[(usize, usize)]) -> (usize, usize) {
    let pixels = |tile: &(usize, usize)| tile.0 * tile.1;
    tiles.iter().copied().max_by_key(pixels).unwrap_or((0, 0))
}

/// Numbers for a pixel: the input, normed, and what becomes of it; or with the shortcut; or of the
/// second half.
fn residual_block(inputs: usize, outputs: usize) -> usize {
    let shortcut = match inputs == outputs {
        true => 0,
        false => inputs + 2 * outputs,
    };
    (2 * inputs + outputs).max(shortcut).max(3 * outputs)
}

/// Numbers for a pixel in freed memory that is too small a piece for others, by measurement, where the finest level has
/// so many channels.
fn freed(channels: usize) -> usize {
    channels * 9 / 8
}

/// Numbers for a place: its input, queries, keys, values, what they come to, and the result.
fn attention(channels: usize) -> usize {
    7 * channels
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_network() {
        let config = Config::released();
        let footprint = Footprint::default();
        let decoding =
            |side, tiling| Memory::of_decoding(&config, (side, side), tiling, footprint).unwrap();
        // Of 49 490 199 numbers, the first and the last convolution and those of single pixels are laid out.
        let half = decoding(512, Tiling::Released);
        let laid_out = 512 * 256 + 256 * 128 + 4 * 4 + 9 * (4 * 512 + 128 * 3);
        assert_eq!(half.weights, 4 * (49_490_199 + laid_out));
        // 256 channels, normed, and 128 of them made.
        let maps = |side: usize, channels: usize| 4 * side * side * channels;
        assert_eq!(half.working, maps(512, 640 + 3 + 144) + (88 << 20));
        // Tiles of 512 take as much for larger pictures, but for the picture.
        let tiled = decoding(1024, Tiling::Tiles(512));
        assert_eq!(tiled.working - half.working, maps(1024, 3) - maps(512, 3));
        assert_eq!(half.total(), half.weights + half.working);
        let encoding = Memory::of_encoding(&config, (512, 512), Tiling::Whole, footprint).unwrap();
        assert_eq!(encoding.working, maps(512, 384 + 3 + 144));
    }
}
