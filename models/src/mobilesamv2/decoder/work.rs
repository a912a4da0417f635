//! How much there is to compute.

use super::Config;

/// Multiply-adds of the decoder, with one mask for each box. The original takes twice as many, since it
/// projects every place of the image for every box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// For each image, whatever the number of boxes.
    pub image: f64,
    /// For each box, what its tokens take.
    pub tokens: f64,
    /// For each box, what attention between tokens and image takes.
    pub attention: f64,
    /// For each box, enlarging the image.
    pub upscaling: f64,
}

impl Work {
    /// The work of a decoder of this configuration.
    pub fn new(config: &Config) -> Self {
        let [height, width] = config.prompt_encoder.image_embedding_size;
        let config = &config.mask_decoder;
        let (n, channels) = ((height * width) as f64, config.transformer_dim as f64);
        let (tokens, depth) = (config.tokens() as f64, config.depth as f64);
        let inner = config.inner_dim() as f64;
        let (rows, hidden) = (tokens * config.num_heads as f64, config.mlp_dim as f64);
        // Of a token: self-attention, the MLP, and four projections in either attention to the other
        // side, of which keys and values are not needed in the first layer.
        let own = channels * (4.0 * channels + 2.0 * tokens + 2.0 * hidden);
        let projections = channels * inner * (8.0 * depth + 2.0);
        let iou_hidden = config.iou_head_hidden_dim as f64;
        let between = config.iou_head_depth.saturating_sub(2) as f64;
        let heads = channels * channels * 2.125
            + iou_hidden * (channels + between * iou_hidden + config.masks() as f64);
        Self {
            image: 2.0 * n * channels * inner,
            tokens: tokens * (depth * own + projections) + heads,
            attention: n * (depth * 4.0 * rows * channels + 2.0 * tokens * inner),
            upscaling: n * channels * (1.5 * channels + 2.0),
        }
    }

    /// For each box.
    pub fn of_box(&self) -> f64 {
        self.tokens + self.attention + self.upscaling
    }

    /// For an image with so many boxes.
    pub fn total(&self, boxes: usize) -> f64 {
        self.image + boxes as f64 * self.of_box()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_decoder() {
        // In 10^6, counted by hand. 4096 places of 256 channels: 2 projections to 128; in two layers four
        // products with 56 vectors, and 14 with 128 channels; 256, 128 and 2 products in enlarging.
        let work = Work::new(&Config::released());
        let mega = |work: f64| (work / 1e5).round() / 10.0;
        assert_eq!(mega(work.image), 268.4);
        assert_eq!(mega(work.attention), 477.1);
        assert_eq!(mega(work.upscaling), 404.8);
        // 7 tokens: 1.314 in each layer and 0.590 of projections; 0.139 + 0.132 for mask and quality.
        assert_eq!(mega(work.tokens), 22.8);
        assert_eq!(work.total(100), work.image + 100.0 * work.of_box());
    }
}
