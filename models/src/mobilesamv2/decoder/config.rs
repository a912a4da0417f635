//! Hyper-parameters.

use std::collections::BTreeMap;

use candle_core::{Result, bail};
use serde::{Deserialize, Serialize};

/// The hyper-parameters of the decoder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Config {
    /// How boxes become tokens.
    pub prompt_encoder: PromptEncoderConfig,
    /// How tokens and an image become masks.
    pub mask_decoder: MaskDecoderConfig,
}

/// Hyper-parameters of the prompt encoder, under the original's names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PromptEncoderConfig {
    /// Channels of a token.
    pub embed_dim: usize,
    /// Height and width of the image's embedding.
    pub image_embedding_size: [usize; 2],
    /// Height and width of the padded image, in pixels: the frame of boxes.
    pub input_image_size: [usize; 2],
}

/// Hyper-parameters of the mask decoder and the transformer in it, under the original's names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MaskDecoderConfig {
    /// Channels of tokens and of the image's embedding.
    pub transformer_dim: usize,
    /// Layers of the transformer.
    pub depth: usize,
    /// Attention heads.
    pub num_heads: usize,
    /// Hidden channels of the transformer's MLPs.
    pub mlp_dim: usize,
    /// By how much fewer channels there are inside of attention between tokens and image.
    #[serde(default = "released_downsampling")]
    pub attention_downsample_rate: usize,
    /// Masks beside the first one.
    pub num_multimask_outputs: usize,
    /// Layers of the MLP that predicts qualities.
    pub iou_head_depth: usize,
    /// Hidden channels of that MLP.
    pub iou_head_hidden_dim: usize,
}

fn released_downsampling() -> usize {
    2
}

impl Config {
    /// The released decoder.
    pub fn released() -> Self {
        Self {
            prompt_encoder: PromptEncoderConfig {
                embed_dim: 256,
                image_embedding_size: [64, 64],
                input_image_size: [1024, 1024],
            },
            mask_decoder: MaskDecoderConfig {
                transformer_dim: 256,
                depth: 2,
                num_heads: 8,
                mlp_dim: 2048,
                attention_downsample_rate: released_downsampling(),
                num_multimask_outputs: 3,
                iou_head_depth: 3,
                iou_head_hidden_dim: 256,
            },
        }
    }

    /// The configuration of weights with these names and shapes; names without influence are ignored.
    ///
    /// Shapes tell neither the number of heads nor the size of the image, which are taken to be the
    /// released ones.
    ///
    /// # Errors
    ///
    /// If a tensor that tells a size is missing or has another number of dimensions.
    pub fn from_shapes(shapes: &BTreeMap<String, Vec<usize>>) -> Result<Self> {
        let size = |name: &str, dimension: usize| match shapes.get(name) {
            Some(shape) if shape.len() == 2 => Ok(shape[dimension]),
            Some(shape) => bail!("the tensor {name} has shape {shape:?}, two sizes are wanted"),
            None => bail!("the tensor {name} is missing"),
        };
        let count = |before: &str, after: &str| {
            let is_there = |i: &usize| shapes.contains_key(&format!("{before}.{i}.{after}"));
            (0..).take_while(is_there).count()
        };
        let layers = "mask_decoder.transformer.layers";
        let channels = size("mask_decoder.iou_token.weight", 1)?;
        let inner = size(
            &format!("{layers}.0.cross_attn_token_to_image.q_proj.weight"),
            0,
        )?;
        let iou_head = "mask_decoder.iou_prediction_head.layers";
        let masks = size("mask_decoder.mask_tokens.weight", 0)?;
        let released = Self::released();
        Ok(Self {
            prompt_encoder: PromptEncoderConfig {
                embed_dim: size("prompt_encoder.no_mask_embed.weight", 1)?,
                ..released.prompt_encoder
            },
            mask_decoder: MaskDecoderConfig {
                transformer_dim: channels,
                depth: count(layers, "norm1.weight"),
                mlp_dim: size(&format!("{layers}.0.mlp.lin1.weight"), 0)?,
                attention_downsample_rate: channels / inner.max(1),
                num_multimask_outputs: masks.saturating_sub(1),
                iou_head_depth: count(iou_head, "weight"),
                iou_head_hidden_dim: size(&format!("{iou_head}.0.weight"), 0)?,
                ..released.mask_decoder
            },
        })
    }

    /// Whether the sizes fit each other.
    ///
    /// # Errors
    ///
    /// If a size is 0 or absurdly large, or does not divide what it has to.
    pub(super) fn validate(&self) -> Result<()> {
        self.prompt_encoder.validate()?;
        self.mask_decoder.validate()?;
        let (prompts, tokens) = (
            self.prompt_encoder.embed_dim,
            self.mask_decoder.transformer_dim,
        );
        if prompts != tokens {
            bail!("embed_dim = {prompts} and transformer_dim = {tokens} must be the same");
        }
        Ok(())
    }
}

impl PromptEncoderConfig {
    /// As [`Config::validate`].
    pub(super) fn validate(&self) -> Result<()> {
        let [[height, width], [rows, columns]] = [self.image_embedding_size, self.input_image_size];
        check_sizes(&[
            ("embed_dim", self.embed_dim),
            ("image_embedding_size[0]", height),
            ("image_embedding_size[1]", width),
            ("input_image_size[0]", rows),
            ("input_image_size[1]", columns),
        ])?;
        check_multiple("embed_dim", self.embed_dim, 2, "sines and cosines")
    }
}

impl MaskDecoderConfig {
    /// As [`Config::validate`].
    pub(super) fn validate(&self) -> Result<()> {
        let (channels, rate) = (self.transformer_dim, self.attention_downsample_rate);
        check_sizes(&[
            ("transformer_dim", channels),
            ("depth", self.depth),
            ("num_heads", self.num_heads),
            ("mlp_dim", self.mlp_dim),
            ("attention_downsample_rate", rate),
            ("num_multimask_outputs", self.num_multimask_outputs),
            ("iou_head_depth", self.iou_head_depth),
            ("iou_head_hidden_dim", self.iou_head_hidden_dim),
        ])?;
        check_multiple("transformer_dim", channels, 8, "for enlarging the image")?;
        let reason = "attention_downsample_rate * num_heads";
        check_multiple("transformer_dim", channels, rate * self.num_heads, reason)
    }

    /// Channels inside of attention between tokens and image.
    pub(super) fn inner_dim(&self) -> usize {
        self.transformer_dim / self.attention_downsample_rate
    }

    /// Masks that the decoder has tokens for.
    pub(super) fn masks(&self) -> usize {
        self.num_multimask_outputs + 1
    }

    /// Tokens of a box: one for the qualities, one for each mask, one for each of two corners.
    pub(super) fn tokens(&self) -> usize {
        self.masks() + 3
    }
}

fn check_sizes(sizes: &[(&str, usize)]) -> Result<()> {
    const LARGEST: usize = 1 << 16;
    for &(name, size) in sizes {
        if !(1..=LARGEST).contains(&size) {
            bail!("{name} must be from 1 to {LARGEST}, got {size}");
        }
    }
    Ok(())
}

fn check_multiple(name: &str, size: usize, divisor: usize, reason: &str) -> Result<()> {
    if !size.is_multiple_of(divisor) {
        bail!("{name} = {size} must be a multiple of {divisor} ({reason})");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::Decoder;
    use super::*;

    #[test]
    fn a_configuration_is_found_again_in_its_shapes() {
        let released = Config::released();
        let mut small = released.clone();
        small.prompt_encoder.embed_dim = 72;
        small.mask_decoder = MaskDecoderConfig {
            transformer_dim: 72,
            depth: 3,
            num_heads: 8,
            mlp_dim: 20,
            attention_downsample_rate: 3,
            num_multimask_outputs: 1,
            iou_head_depth: 4,
            iou_head_hidden_dim: 12,
        };
        for config in [released, small] {
            let mut shapes = Decoder::tensors(&config).unwrap();
            shapes.insert("mask_decoder.other".to_owned(), vec![3]);
            assert_eq!(Config::from_shapes(&shapes).unwrap(), config);
            shapes.remove("mask_decoder.mask_tokens.weight");
            let message = Config::from_shapes(&shapes).unwrap_err().to_string();
            assert!(message.contains("mask_tokens"), "{message}");
        }
    }

    #[test]
    fn sizes_that_fit_nothing_are_refused() {
        type Change = fn(&mut Config);
        let changes: [(Change, &str); 6] = [
            (|c| c.prompt_encoder.embed_dim = 255, "embed_dim"),
            (|c| c.prompt_encoder.embed_dim = 128, "transformer_dim"),
            (|c| c.prompt_encoder.input_image_size[1] = 0, "input_image"),
            (|c| c.mask_decoder.num_heads = 3, "num_heads"),
            (|c| c.mask_decoder.depth = 0, "depth"),
            (|c| c.mask_decoder.mlp_dim = 1 << 40, "mlp_dim"),
        ];
        Config::released().validate().unwrap();
        for (change, name) in changes {
            let mut config = Config::released();
            change(&mut config);
            let message = Decoder::tensors(&config).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }
}
