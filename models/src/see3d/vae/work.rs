//! How much there is to compute.

use candle_core::Result;

use super::{Config, Tiling};

/// Multiply-adds for one picture. Convolutions count as sums over their kernels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// To encode it.
    pub encode: f64,
    /// To decode it.
    pub decode: f64,
}

impl Work {
    /// The work for a picture of `height` x `width` pixels.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or tiles cannot be of the size that the tiling
    /// says.
    pub fn new(config: &Config, size: (usize, usize), tiling: Tiling) -> Result<Self> {
        Self::counted(config, size, tiling, Count::Defined)
    }

    /// What is left of it with Winograd's algorithm, where maps are not tiny: what time goes by.
    ///
    /// # Errors
    ///
    /// As [`Self::new`].
    pub fn computed(config: &Config, size: (usize, usize), tiling: Tiling) -> Result<Self> {
        Self::counted(config, size, tiling, Count::Computed)
    }

    fn counted(
        config: &Config,
        (height, width): (usize, usize),
        tiling: Tiling,
        count: Count,
    ) -> Result<Self> {
        config.validate()?;
        let latents = (height / config.scale(), width / config.scale());
        let encoding = tiling.of_encoding(config)?.sizes((height, width));
        let decoding = tiling.of_decoding(config)?.sizes(latents);
        let total = |stages: fn(&Config, (usize, usize), Count) -> Stages, sizes: Vec<_>| {
            let of_tile = |size| stages(config, size, count).total();
            sizes.into_iter().map(of_tile).sum()
        };
        Ok(Self {
            encode: total(Stages::of_encoding, encoding),
            decode: total(Stages::of_decoding, decoding),
        })
    }
}

/// Which multiply-adds are counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Count {
    /// Those of the sums that define the network.
    Defined,
    /// Those that its fast convolutions take.
    Computed,
}

/// Multiply-adds of one half for one tile.
pub(super) struct Stages {
    /// The first convolutions.
    pub(super) conv_in: f64,
    /// `down_blocks` or `up_blocks`.
    pub(super) levels: Vec<f64>,
    pub(super) mid_block: f64,
    /// The last convolutions.
    pub(super) conv_out: f64,
}

impl Stages {
    /// Encoding a tile of this height and width, in pixels.
    pub(super) fn of_encoding(
        config: &Config,
        (height, width): (usize, usize),
        count: Count,
    ) -> Self {
        let widths = &config.block_out_channels;
        let (first, last) = (widths[0], widths[widths.len() - 1]);
        let pixels = |level: usize| ((height >> level) * (width >> level)) as f64;
        let level = |i: usize| {
            let (inputs, outputs) = (widths[i.saturating_sub(1)], widths[i]);
            let down = match i + 1 == widths.len() {
                true => 0.0,
                false => pixels(i + 1) * conv(3, outputs, outputs),
            };
            pixels(i) * count.residual_blocks(config.layers_per_block, inputs, outputs) + down
        };
        let (coarsest, moments) = (pixels(widths.len() - 1), 2 * config.latent_channels);
        Self {
            conv_in: pixels(0) * conv(3, config.in_channels, first),
            levels: (0..widths.len()).map(level).collect(),
            mid_block: count.mid_block(coarsest, last),
            conv_out: coarsest * (conv(3, last, moments) + conv(1, moments, moments)),
        }
    }

    /// Decoding a tile of this height and width, in latents.
    pub(super) fn of_decoding(
        config: &Config,
        (height, width): (usize, usize),
        count: Count,
    ) -> Self {
        let widths: Vec<usize> = config.block_out_channels.iter().rev().copied().collect();
        let (first, last) = (widths[0], widths[widths.len() - 1]);
        let pixels = |level: usize| ((height << level) * (width << level)) as f64;
        let level = |i: usize| {
            let (inputs, outputs) = (widths[i.saturating_sub(1)], widths[i]);
            let up = match i + 1 == widths.len() {
                true => 0.0,
                false => pixels(i + 1) * count.conv3(outputs, outputs),
            };
            pixels(i) * count.residual_blocks(config.layers_per_block + 1, inputs, outputs) + up
        };
        let latents = config.latent_channels;
        Self {
            conv_in: pixels(0) * (conv(1, latents, latents) + conv(3, latents, first)),
            levels: (0..widths.len()).map(level).collect(),
            mid_block: count.mid_block(pixels(0), first),
            conv_out: pixels(widths.len() - 1) * conv(3, last, config.out_channels),
        }
    }

    fn total(&self) -> f64 {
        self.conv_in + self.levels.iter().sum::<f64>() + self.mid_block + self.conv_out
    }
}

/// For a pixel of the result.
fn conv(kernel: usize, inputs: usize, outputs: usize) -> f64 {
    (kernel * kernel * inputs * outputs) as f64
}

impl Count {
    /// A 3x3 convolution of stride 1, of a doubled map or another, for a pixel.
    fn conv3(self, inputs: usize, outputs: usize) -> f64 {
        let defined = conv(3, inputs, outputs);
        match self {
            Self::Defined => defined,
            // F(4x4, 3x3) multiplies 36 times where the sums do 144 times.
            Self::Computed => defined / 4.0,
        }
    }

    /// For a pixel.
    fn residual_blocks(self, count: usize, inputs: usize, outputs: usize) -> f64 {
        let shortcut = match inputs == outputs {
            true => 0.0,
            false => conv(1, inputs, outputs),
        };
        let others = (2 * count - 1) as f64 * self.conv3(outputs, outputs);
        shortcut + self.conv3(inputs, outputs) + others
    }

    fn mid_block(self, pixels: f64, channels: usize) -> f64 {
        let attention = conv(1, channels, 4 * channels) + 2.0 * pixels * channels as f64;
        pixels * (4.0 * self.conv3(channels, channels) + attention)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_measured_on_the_original() {
        let giga = |side| {
            let work = Work::new(&Config::released(), (side, side), Tiling::Released).unwrap();
            [work.encode, work.decode].map(|work| (work / 1e9).round())
        };
        assert_eq!(giga(512), [558.0, 1257.0]);
        assert_eq!(giga(256)[1], 311.0);
    }

    #[test]
    fn fast_convolutions_compute_less() {
        let config = Config::released();
        let work = |of: fn(&Config, _, _) -> Result<Work>| {
            of(&config, (512, 512), Tiling::Released).unwrap()
        };
        let (defined, computed) = (work(Work::new), work(Work::computed));
        for (defined, computed) in [
            (defined.encode, computed.encode),
            (defined.decode, computed.decode),
        ] {
            // Nearly all of it is such convolutions.
            let share = computed / defined;
            assert!((0.25..0.35).contains(&share), "{share}");
        }
    }

    #[test]
    fn tiles_overlap() {
        // Of 96 pixels, tiles of 64 begin at 0 and 48: 64 + 48 rows and columns.
        let config = Config::released();
        let of = |side, tiling| Work::new(&config, (side, side), tiling).unwrap();
        let tiled = of(96, Tiling::Tiles(64));
        let corner = |height, width| Work::new(&config, (height, width), Tiling::Whole).unwrap();
        let parts = [(64, 64), (64, 48), (48, 64), (48, 48)];
        let sum =
            |of: fn(&Work) -> f64| -> f64 { parts.iter().map(|&(h, w)| of(&corner(h, w))).sum() };
        assert_eq!(tiled.encode, sum(|work| work.encode));
        assert_eq!(tiled.decode, sum(|work| work.decode));
        assert_eq!(of(64, Tiling::Tiles(64)), of(64, Tiling::Whole));
    }
}
