//! Hyper-parameters.

use std::collections::BTreeMap;

use candle_core::{Result, bail};
use serde::{Deserialize, Serialize};

/// The hyper-parameters of the autoencoder, under the names and with the defaults that diffusers has for
/// them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Config {
    /// Colours of a picture that is encoded.
    pub in_channels: usize,
    /// Colours of a decoded picture.
    pub out_channels: usize,
    /// What the encoder's levels are.
    pub down_block_types: Vec<DownBlockType>,
    /// What the decoder's levels are.
    pub up_block_types: Vec<UpBlockType>,
    /// Channels of each level, the finest first. Each level is half the size of the one before.
    pub block_out_channels: Vec<usize>,
    /// Residual blocks of a level of the encoder; one of the decoder has one more.
    pub layers_per_block: usize,
    /// The activation function of all blocks.
    pub act_fn: ActivationFunction,
    /// Channels of latents.
    pub latent_channels: usize,
    /// Groups of the group norms.
    pub norm_num_groups: usize,
    /// Rows and columns of a tile, in pixels: see [`Tiling`](super::Tiling).
    pub sample_size: usize,
    /// What latents are multiplied with so that they are of about unit scale.
    pub scaling_factor: f64,
}

/// A level of the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DownBlockType {
    /// Residual blocks, then half the size.
    DownEncoderBlock2D,
}

/// A level of the decoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum UpBlockType {
    /// Residual blocks, then twice the size.
    UpDecoderBlock2D,
}

/// An activation function.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActivationFunction {
    /// `x / (1 + exp(-x))`.
    #[serde(alias = "swish")]
    Silu,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            in_channels: 3,
            out_channels: 3,
            down_block_types: vec![DownBlockType::DownEncoderBlock2D],
            up_block_types: vec![UpBlockType::UpDecoderBlock2D],
            block_out_channels: vec![64],
            layers_per_block: 1,
            act_fn: ActivationFunction::Silu,
            latent_channels: 4,
            norm_num_groups: 32,
            sample_size: 32,
            scaling_factor: 0.18215,
        }
    }
}

impl Config {
    /// Stable Diffusion 2.1's.
    pub fn released() -> Self {
        Self {
            layers_per_block: 2,
            sample_size: 768,
            ..Self::of_levels(vec![128, 256, 512, 512])
        }
    }

    fn of_levels(block_out_channels: Vec<usize>) -> Self {
        let levels = block_out_channels.len();
        Self {
            down_block_types: vec![DownBlockType::DownEncoderBlock2D; levels],
            up_block_types: vec![UpBlockType::UpDecoderBlock2D; levels],
            block_out_channels,
            ..Self::default()
        }
    }

    /// The configuration of a network that has tensors of these names and shapes, among others.
    ///
    /// What no shape tells, `norm_num_groups`, `sample_size` and `scaling_factor`, is the released
    /// network's.
    ///
    /// # Errors
    ///
    /// If a tensor that says a size is missing, or the sizes do not fit each other.
    pub fn from_shapes(shapes: &BTreeMap<String, Vec<usize>>) -> Result<Self> {
        let size = |name: &str, axis: usize| match shapes.get(name) {
            None => bail!("the tensor {name} is missing"),
            Some(shape) => match shape.get(axis) {
                Some(&size) => Ok(size),
                None => bail!("the tensor {name} has shape {shape:?}"),
            },
        };
        let count = |of: &dyn Fn(usize) -> String| {
            let is_there = |i: &usize| shapes.contains_key(&of(*i));
            (0..).take_while(is_there).count()
        };
        let block = |level: usize, i: usize| {
            format!("encoder.down_blocks.{level}.resnets.{i}.conv2.weight")
        };
        let widths = (0..count(&|level| block(level, 0)))
            .map(|level| size(&block(level, 0), 0))
            .collect::<Result<Vec<_>>>()?;
        let config = Self {
            in_channels: size("encoder.conv_in.weight", 1)?,
            out_channels: size("decoder.conv_out.weight", 0)?,
            layers_per_block: count(&|i| block(0, i)),
            latent_channels: size("post_quant_conv.weight", 0)?,
            sample_size: Self::released().sample_size,
            ..Self::of_levels(widths)
        };
        config.validate()?;
        Ok(config)
    }

    /// How many pixels of a picture, along each side, a latent stands for.
    pub fn scale(&self) -> usize {
        1 << self.block_out_channels.len().saturating_sub(1)
    }

    /// Refuses sizes with which no network can be built.
    ///
    /// # Errors
    ///
    /// If a size is 0 or absurdly large, or sizes do not fit each other.
    pub(super) fn validate(&self) -> Result<()> {
        const LARGEST: usize = 1 << 14;
        const LEVELS: usize = 8;
        let levels = self.block_out_channels.len();
        for (name, size, largest) in [
            ("in_channels", self.in_channels, LARGEST),
            ("out_channels", self.out_channels, LARGEST),
            ("latent_channels", self.latent_channels, LARGEST),
            ("layers_per_block", self.layers_per_block, 64),
            ("norm_num_groups", self.norm_num_groups, LARGEST),
            ("sample_size", self.sample_size, 1 << 20),
            ("the number of block_out_channels", levels, LEVELS),
        ] {
            if !(1..=largest).contains(&size) {
                bail!("{name} must be from 1 to {largest}, got {size}");
            }
        }
        let types = (self.down_block_types.len(), self.up_block_types.len());
        if types != (levels, levels) {
            bail!(
                "down_block_types, up_block_types and block_out_channels name {}, {} and {levels} levels",
                types.0,
                types.1
            );
        }
        let groups = self.norm_num_groups;
        for &channels in &self.block_out_channels {
            if !(1..=LARGEST).contains(&channels) || !channels.is_multiple_of(groups) {
                bail!(
                    "block_out_channels must be multiples of norm_num_groups = {groups} up to {LARGEST}, \
                     got {channels}"
                );
            }
        }
        let scale = self.scaling_factor;
        if !(scale.is_finite() && scale > 0.0) {
            bail!("scaling_factor must be above 0, got {scale}");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::Vae;
    use super::*;

    fn small() -> Config {
        Config {
            in_channels: 2,
            out_channels: 5,
            layers_per_block: 3,
            latent_channels: 6,
            sample_size: 768,
            ..Config::of_levels(vec![32, 96, 64])
        }
    }

    #[test]
    fn shapes_tell_the_configuration() {
        for config in [Config::released(), small()] {
            let mut shapes = Vae::tensors(&config).unwrap();
            assert_eq!(Config::from_shapes(&shapes).unwrap(), config);
            shapes.remove("decoder.conv_out.weight");
            let message = Config::from_shapes(&shapes).unwrap_err().to_string();
            assert!(message.contains("decoder.conv_out.weight"), "{message}");
        }
    }

    #[test]
    fn files_are_read_with_the_defaults_of_diffusers() {
        let read = |text: &str| serde_json::from_str::<Config>(text);
        assert_eq!(read("{}").unwrap(), Config::default());
        let text = r#"{"_class_name": "AutoencoderKL", "act_fn": "silu", "layers_per_block": 2,
            "block_out_channels": [128, 256, 512, 512], "latents_mean": null, "sample_size": 768,
            "down_block_types": ["DownEncoderBlock2D", "DownEncoderBlock2D", "DownEncoderBlock2D",
            "DownEncoderBlock2D"], "up_block_types": ["UpDecoderBlock2D", "UpDecoderBlock2D",
            "UpDecoderBlock2D", "UpDecoderBlock2D"]}"#;
        assert_eq!(read(text).unwrap(), Config::released());
        for (text, refused) in [
            (r#"{"act_fn": "mish"}"#, "mish"),
            (
                r#"{"down_block_types": ["AttnDownEncoderBlock2D"]}"#,
                "AttnDownEncoderBlock2D",
            ),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(refused), "{message}");
        }
    }

    #[test]
    fn sizes_that_fit_nothing_are_refused() {
        type Change = fn(&mut Config);
        let changes: [(Change, &str); 8] = [
            (|c| c.in_channels = 0, "in_channels"),
            (|c| c.layers_per_block = usize::MAX, "layers_per_block"),
            (|c| c.norm_num_groups = 33, "norm_num_groups"),
            (|c| c.norm_num_groups = 0, "norm_num_groups"),
            (|c| c.block_out_channels[1] = 1 << 40, "block_out_channels"),
            (
                |c| c.block_out_channels = vec![32; 64],
                "block_out_channels",
            ),
            (|c| c.up_block_types.truncate(1), "up_block_types"),
            (|c| c.scaling_factor = f64::NAN, "scaling_factor"),
        ];
        for (change, name) in changes {
            let mut config = small();
            change(&mut config);
            let message = Vae::tensors(&config).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }
}
