//! Hyper-parameters.

use std::collections::BTreeMap;

use candle_core::{Error, Result, bail};
use serde::{Deserialize, Serialize};

use super::{PatchMerging, Sizes};

/// The hyper-parameters of TinyViT, under the names that the original code gives them. Lists have an
/// entry for each layer.
///
/// What the original has for training and for its classifier is no field, and ignored when a configuration is
/// read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// Rows and columns of the image, in pixels. No property of the weights.
    #[serde(default = "released_img_size")]
    pub img_size: usize,
    /// Channels of the tokens.
    pub embed_dims: Vec<usize>,
    /// Number of blocks.
    pub depths: Vec<usize>,
    /// Attention heads of each block; without effect in the first layer, which has none.
    pub num_heads: Vec<usize>,
    /// Rows and columns of the windows, in tokens; likewise.
    pub window_sizes: Vec<usize>,
    /// Hidden channels of an MLP, as a multiple of the tokens' channels.
    #[serde(default = "released_ratio")]
    pub mlp_ratio: f64,
    /// Hidden channels of the first layer's blocks, as a multiple of its channels.
    #[serde(default = "released_ratio")]
    pub mbconv_expand_ratio: f64,
    /// Side of the kernel between attention and MLP.
    #[serde(default = "released_local_conv_size")]
    pub local_conv_size: usize,
}

fn released_img_size() -> usize {
    1024
}

fn released_ratio() -> f64 {
    4.0
}

fn released_local_conv_size() -> usize {
    3
}

impl Config {
    /// MobileSAM's encoder, the TinyViT of 5 million parameters.
    pub fn released() -> Self {
        Self {
            img_size: released_img_size(),
            embed_dims: vec![64, 128, 160, 320],
            depths: vec![2, 2, 6, 2],
            num_heads: vec![2, 4, 5, 10],
            window_sizes: vec![7, 7, 14, 7],
            mlp_ratio: released_ratio(),
            mbconv_expand_ratio: released_ratio(),
            local_conv_size: released_local_conv_size(),
        }
    }

    /// The configuration of a network that has tensors of these names and shapes, among others.
    ///
    /// What no shape tells is the released network's: `img_size`, and what is without effect.
    ///
    /// # Errors
    ///
    /// If a tensor that says a size is missing, or its shape cannot be.
    pub fn from_shapes(shapes: &BTreeMap<String, Vec<usize>>) -> Result<Self> {
        let size = |name: &str, axis: usize| match shapes.get(name) {
            None => bail!("the tensor {name} is missing"),
            Some(shape) => (shape.get(axis).copied().filter(|&size| size > 0))
                .ok_or_else(|| Error::Msg(format!("the tensor {name} has shape {shape:?}"))),
        };
        let released = Self::released();
        let mut config = Self {
            embed_dims: vec![size("patch_embed.seq.2.c.weight", 0)?],
            depths: Vec::new(),
            num_heads: vec![released.num_heads[0]],
            window_sizes: vec![released.window_sizes[0]],
            mbconv_expand_ratio: size("layers.0.blocks.0.conv1.c.weight", 0)? as f64
                / size("layers.0.blocks.0.conv1.c.weight", 1)? as f64,
            ..released
        };
        // As many as there are numbers in use, without a gap, from 0 on.
        let count = |list: &str| {
            let is_used = |i: &usize| {
                let prefix = format!("{list}.{i}.");
                let mut names = shapes.range(prefix.clone()..);
                names
                    .next()
                    .is_some_and(|(name, _)| name.starts_with(&prefix))
            };
            (0..).take_while(is_used).count()
        };
        let layers = count("layers");
        for i in 0..layers {
            let layer = format!("layers.{i}");
            config.depths.push(count(&format!("{layer}.blocks")));
            if i > 0 {
                let block = format!("{layer}.blocks.0");
                let biases = format!("{block}.attn.attention_biases");
                let tokens = size(&biases, 1)?;
                if tokens.isqrt().pow(2) != tokens {
                    bail!("the tensor {biases} is not that of a square window, {tokens}");
                }
                config.num_heads.push(size(&biases, 0)?);
                config.window_sizes.push(tokens.isqrt());
                config.local_conv_size = size(&format!("{block}.local_conv.c.weight"), 2)?;
                let hidden = size(&format!("{block}.mlp.fc1.weight"), 0)?;
                config.mlp_ratio = hidden as f64 / config.embed_dims[i] as f64;
            }
            if i + 1 < layers {
                let next = size(&format!("{layer}.downsample.conv3.c.weight"), 0)?;
                config.embed_dims.push(next);
            }
        }
        config.validate()?;
        Ok(config)
    }

    /// The sizes of the blocks of layer `i`, one of those with attention.
    ///
    /// # Panics
    ///
    /// If there is no such layer.
    pub fn sizes(&self, i: usize) -> Sizes {
        let channels = self.embed_dims[i];
        Sizes {
            channels,
            heads: self.num_heads[i],
            window: self.window_sizes[i],
            hidden: scaled(channels, self.mlp_ratio),
            kernel: self.local_conv_size,
        }
    }

    /// Hidden channels of the blocks of the first layer.
    pub(super) fn mbconv_hidden(&self) -> usize {
        scaled(self.embed_dims[0], self.mbconv_expand_ratio)
    }

    /// Rows and columns of the image in each layer.
    pub(super) fn grids(&self) -> Vec<usize> {
        let mut grids = vec![self.img_size.div_ceil(2).div_ceil(2)];
        for &next in &self.embed_dims[1..] {
            let grid = grids[grids.len() - 1];
            grids.push(grid.div_ceil(PatchMerging::stride(next)));
        }
        grids
    }

    /// Refuses sizes with which no network can be built.
    ///
    /// # Errors
    ///
    /// If lists differ in length, a size is 0 or absurdly large, or heads do not divide channels.
    pub(super) fn validate(&self) -> Result<()> {
        const LARGEST: usize = 1 << 16;
        let lists = [
            ("embed_dims", &self.embed_dims),
            ("depths", &self.depths),
            ("num_heads", &self.num_heads),
            ("window_sizes", &self.window_sizes),
        ];
        for (name, list) in lists {
            if list.is_empty() || list.len() != self.embed_dims.len() {
                bail!(
                    "{name} must have an entry for each of the {} layers, got {list:?}",
                    self.embed_dims.len().max(1)
                );
            }
        }
        let entries = lists
            .into_iter()
            .flat_map(|(name, list)| list.iter().map(move |&n| (name, n)));
        let hidden =
            (0..self.embed_dims.len()).map(|i| ("mlp_ratio * embed_dims", self.sizes(i).hidden));
        let others = [
            ("img_size", self.img_size),
            ("mbconv_expand_ratio * embed_dims", self.mbconv_hidden()),
            ("local_conv_size", self.local_conv_size),
        ];
        for (name, size) in entries.chain(hidden).chain(others) {
            if !(1..=LARGEST).contains(&size) {
                bail!("{name} must be from 1 to {LARGEST}, got {size}");
            }
        }
        for (i, (&channels, &heads)) in self
            .embed_dims
            .iter()
            .zip(&self.num_heads)
            .enumerate()
            .skip(1)
        {
            if !channels.is_multiple_of(heads) {
                bail!("num_heads = {heads} does not divide embed_dims = {channels} of layer {i}");
            }
        }
        Ok(())
    }
}

fn scaled(channels: usize, ratio: f64) -> usize {
    (channels as f64 * ratio) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mobilesamv2::tiny_vit::TinyVit;

    fn small() -> Config {
        Config {
            embed_dims: vec![8, 12, 20],
            depths: vec![1, 3, 2],
            num_heads: vec![2, 3, 5],
            window_sizes: vec![7, 4, 9],
            mlp_ratio: 1.25,
            mbconv_expand_ratio: 3.0,
            local_conv_size: 5,
            ..Config::released()
        }
    }

    #[test]
    fn shapes_tell_the_configuration() {
        for config in [Config::released(), small()] {
            let shapes = TinyVit::tensors(&config).unwrap();
            assert_eq!(Config::from_shapes(&shapes).unwrap(), config);
        }
    }

    #[test]
    fn shapes_of_something_else_are_refused_by_name() {
        let refused =
            |shapes: &BTreeMap<_, _>| Config::from_shapes(shapes).unwrap_err().to_string();
        assert!(refused(&BTreeMap::new()).contains("patch_embed.seq.2.c.weight"));
        let biases = "layers.2.blocks.0.attn.attention_biases";
        let mut shapes = TinyVit::tensors(&small()).unwrap();
        for shape in [vec![5, 80], vec![5], vec![0, 81]] {
            shapes.insert(biases.to_owned(), shape);
            assert!(refused(&shapes).contains(biases));
        }
    }

    #[test]
    fn the_originals_own_configuration_is_read() {
        let text = r#"{"embed_dims": [64, 128, 160, 320], "depths": [2, 2, 6, 2], "num_heads": [2, 4, 5, 10],
            "window_sizes": [7, 7, 14, 7], "mlp_ratio": 4, "num_classes": 1000, "drop_path_rate": 0.0}"#;
        assert_eq!(
            serde_json::from_str::<Config>(text).unwrap(),
            Config::released()
        );
    }

    #[test]
    fn sizes_that_fit_nothing_are_refused() {
        for (config, name) in [
            (
                Config {
                    embed_dims: Vec::new(),
                    ..small()
                },
                "embed_dims",
            ),
            (
                Config {
                    depths: vec![1, 1],
                    ..small()
                },
                "depths",
            ),
            (
                Config {
                    num_heads: vec![2, 5, 5],
                    ..small()
                },
                "num_heads",
            ),
            (
                Config {
                    window_sizes: vec![7, 0, 7],
                    ..small()
                },
                "window_sizes",
            ),
            (
                Config {
                    mlp_ratio: -1.0,
                    ..small()
                },
                "mlp_ratio",
            ),
        ] {
            let message = TinyVit::tensors(&config).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }

    #[test]
    fn the_image_is_halved_but_before_the_last_layer() {
        assert_eq!(Config::released().grids(), [256, 128, 64, 64]);
        assert_eq!(small().grids(), [256, 128, 64]);
    }
}
