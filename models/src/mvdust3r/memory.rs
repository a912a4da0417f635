//! How much memory a run takes.

use candle_core::Result;

use super::{Config, MvDust3r, Options, Paths};
use crate::Footprint;

/// Estimated peak of memory of one run, in bytes, without what the program itself needs.
///
/// It is the sum of the buffers that are alive at once in each phase: of encoder or decoder, whichever needs more, and of
/// the heads, whose large layers find no place in what those leave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights that the run reads.
    pub weights: usize,
    /// Everything else.
    pub working: usize,
}

impl Memory {
    /// The memory for `views` images of `height` x `width` pixels, with weights of this footprint.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn new(
        config: &Config,
        views: usize,
        (height, width): (usize, usize),
        options: &Options,
        footprint: Footprint,
    ) -> Result<Self> {
        const FLOAT: usize = size_of::<f32>();
        let tensors = MvDust3r::tensors(config)?;
        let read = |name: &str| options.gaussians || !name.starts_with("downstream_GS_head");
        let weights: usize = tensors
            .iter()
            .filter(|(name, _)| read(name))
            .map(|(_, shape)| shape.iter().product::<usize>())
            .sum();

        let pixels = height * width;
        let tokens = pixels / (config.patch_size * config.patch_size);
        let references = config.references();
        let paths = match options.paths {
            Paths::First => 1,
            Paths::All => references,
        };
        // A block holds its input and output, a normed input, and either queries, keys and values
        // (three, and two of them rotated) or the hidden layer.
        let block = |channels: usize| {
            let rows = options.rows.max(tokens).min(views * tokens);
            rows * channels * (3 + config.mlp_ratio.max(5))
        };
        let (enc, dec) = (config.enc_embed_dim, config.dec_embed_dim);
        let all = views * tokens;
        let encoder = 2 * all * enc + block(enc);
        // Tokens before and after, and keys and values: of one path at a time when views look at
        // each other, of all paths when paths do.
        let memories = if config.m_ref_flag { references } else { 1 };
        let decoder = all * enc + all * dec * (2 * references + 2 * memories) + block(dec);
        let skip = if config.pts_head_config.skip {
            // Input and output of the widest layer; kernels of two layers of two heads, with batch norm folded in.
            let kernels = 2 * 2 * 25 * config.skip_dim * config.skip_dim;
            pixels * (2 * config.skip_dim + 10) + kernels
        } else {
            0
        };
        let for_pixel = 4 + match options.gaussians {
            true => 8 + 3 * (config.sh_degree + 1).pow(2),
            false => 0,
        };
        let heads = paths * views * (tokens * dec + pixels * for_pixel) + 8 * pixels + skip;
        let images = 3 * views * pixels;
        Ok(Self {
            weights: footprint.bytes(weights),
            working: (images + encoder.max(decoder) + heads) * FLOAT,
        })
    }

    /// All of it.
    pub fn total(&self) -> usize {
        self.weights + self.working
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn memory(views: usize, rows: usize) -> Memory {
        let options = Options {
            rows,
            ..Options::default()
        };
        let config = Config::mv_dust3r_plus();
        Memory::new(&config, views, (224, 224), &options, Footprint::Owned(4)).unwrap()
    }

    #[test]
    fn the_released_network() {
        // 661.4 million parameters, less the Gaussian heads' 9.05 million, less the unused mask token.
        let weights = memory(8, 4096).weights as f64 / 4e6;
        assert!((weights - (661.43 - 9.05)).abs() < 0.05, "{weights}");
        // The skip branch's two layers of 51 MB, and its kernels, are the most.
        let working = memory(8, 4096).working as f64 / 1e6;
        assert!((200.0..300.0).contains(&working), "{working}");
    }

    #[test]
    fn more_views_need_more_and_smaller_chunks_less() {
        assert!(memory(24, 4096).working > memory(8, 4096).working);
        assert!(memory(24, 512).working < memory(24, 4096).working);
    }
}
