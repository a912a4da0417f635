//! How much there is to compute.

use super::{Config, Paths};

/// Multiply-adds of one run of a network. What is the same for several views or references counts
/// once, as it is computed once here. Convolutions count as sums over their kernels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// Patch embedding and encoder.
    pub encoder: f64,
    /// Decoder.
    pub decoder: f64,
    /// Points heads.
    pub points_heads: f64,
    /// Gaussian heads.
    pub gaussian_heads: f64,
    /// Of the points heads, what fast convolutions save: of the skip branch's 5x5 layers they
    /// compute 100 products for 36 outputs instead of 900.
    pub saved: f64,
}

impl Work {
    /// The work for `views` images of `height` x `width` pixels.
    pub fn new(
        config: &Config,
        views: usize,
        (height, width): (usize, usize),
        paths: Paths,
        gaussians: bool,
    ) -> Self {
        let tokens = (height / config.patch_size) * (width / config.patch_size);
        let decoder: f64 = (0..config.dec_depth)
            .map(|layer| Self::decoder_layer(config, layer, tokens, views, paths))
            .sum();
        let (n, views) = (tokens as f64, views as f64);
        let wanted = match paths {
            Paths::First => 1.0,
            Paths::All => config.references() as f64,
        };
        let (enc, dec) = (config.enc_embed_dim as f64, config.dec_embed_dim as f64);
        let patch = (config.patch_size * config.patch_size) as f64;
        let blocks = config.enc_depth as f64 * Self::encoder_block(config, tokens);
        let (skip, saved) = match config.pts_head_config.skip {
            true => {
                let (pixels, channels) = ((height * width) as f64, config.skip_dim as f64);
                let wide = 2.0 * 25.0 * channels * channels;
                let narrow = 9.0 * (6.0 + 3.0) * channels;
                (
                    pixels * (wide + narrow),
                    pixels * wide * (1.0 - 100.0 / 900.0),
                )
            }
            false => (0.0, 0.0),
        };
        let outputs = 8.0 + 3.0 * ((config.sh_degree + 1) as f64).powi(2);
        let hidden = config.gs_mlp_dim as f64;
        let gaussian = n * hidden * (4.0 * dec + outputs * patch);
        Self {
            encoder: views * (n * 3.0 * patch * enc + blocks),
            decoder: views * n * enc * dec + decoder,
            points_heads: wanted * views * (n * dec * 4.0 * patch + skip),
            saved: wanted * views * saved,
            gaussian_heads: f64::from(u8::from(gaussians)) * wanted * views * gaussian,
        }
    }

    /// All of it.
    pub fn total(&self) -> f64 {
        self.encoder + self.decoder + self.points_heads + self.gaussian_heads
    }

    /// All that is left with fast convolutions: what time goes by.
    pub fn computed(&self) -> f64 {
        self.total() - self.saved
    }

    /// One encoder block on one image of so many tokens.
    pub(super) fn encoder_block(config: &Config, tokens: usize) -> f64 {
        let (n, channels) = (tokens as f64, config.enc_embed_dim as f64);
        let mlp = 2.0 * config.mlp_ratio as f64;
        n * channels * ((4.0 + mlp) * channels + 2.0 * n)
    }

    /// One decoder layer on all views of all paths.
    pub(super) fn decoder_layer(
        config: &Config,
        layer: usize,
        tokens: usize,
        views: usize,
        paths: Paths,
    ) -> f64 {
        let (n, views) = (tokens as f64, views as f64);
        let channels = config.dec_embed_dim as f64;
        let references = config.references() as f64;
        // A block on one group that attends to `k` groups; a memory costs 2 n channels^2.
        let block = |k: f64| {
            let products = 6.0 + 2.0 * config.mlp_ratio as f64;
            n * channels * (products * channels + 2.0 * n * (1.0 + k))
        };
        let memory = 2.0 * n * channels * channels;
        let is_last = layer + 1 == config.dec_depth;
        let wanted = match paths {
            Paths::First if is_last => 1.0,
            _ => references,
        };
        let exchange = if layer == 0 {
            let others = if references > 1.0 { views } else { views - 1.0 };
            (others + references) * block(views - 1.0) + 2.0 * views * memory
        } else {
            let paths = if config.m_ref_flag {
                references
            } else {
                wanted
            };
            paths * (views * block(views - 1.0) + (2.0 * views - 1.0) * memory)
        };
        let compare = if config.m_ref_flag {
            views * (wanted * block(references - 1.0) + references * memory)
        } else {
            0.0
        };
        exchange + compare
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In 10^9, to one place.
    fn giga(work: f64) -> f64 {
        (work / 1e8).round() / 10.0
    }

    #[test]
    fn the_released_networks_on_eight_views() {
        // Counted by hand from the layers' sizes: 1.2 for the patch embedding and 488.6 for the
        // blocks; 1.2 for the decoder's embedding, 44.5 for the reference view, 197.8 for the others,
        // 0.3 for keys and values of the reference view that nobody looks at in the first layer.
        let work = Work::new(&Config::mv_dust3r(), 8, (224, 224), Paths::First, true);
        assert_eq!(giga(work.encoder), 489.9);
        assert_eq!(giga(work.decoder), 243.8);
        assert_eq!(giga(work.points_heads), 1324.9);
        assert_eq!(giga(work.gaussian_heads), 7.1);

        let plus = |paths| Work::new(&Config::mv_dust3r_plus(), 8, (224, 224), paths, false);
        let (first, all) = (plus(Paths::First), plus(Paths::All));
        assert_eq!(first.encoder, all.encoder);
        assert_eq!(all.points_heads, 4.0 * first.points_heads);
        // In the last layer, three paths of eight views need not be compared with others.
        let n = 196.0;
        let block = n * 768.0 * (14.0 * 768.0 + 2.0 * n * 4.0);
        assert!((all.decoder - first.decoder - 24.0 * block).abs() < 1.0);
    }
}
