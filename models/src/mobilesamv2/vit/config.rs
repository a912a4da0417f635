//! Hyper-parameters.

use std::collections::BTreeMap;

use candle_core::{Error, Result, bail};
use serde::{Deserialize, Serialize};

/// The hyper-parameters of SAM's image encoder, under the names that the original code gives them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// Rows and columns of the image, in pixels; a multiple of `patch_size`.
    #[serde(default = "released_img_size")]
    pub img_size: usize,
    /// Side of a square patch, in pixels.
    #[serde(default = "released_patch_size")]
    pub patch_size: usize,
    /// Channels of the tokens.
    pub embed_dim: usize,
    /// Number of blocks.
    pub depth: usize,
    /// Attention heads of each block.
    pub num_heads: usize,
    /// Hidden channels of an MLP, as a multiple of the tokens' channels.
    #[serde(default = "released_mlp_ratio")]
    pub mlp_ratio: f64,
    /// Channels of the result.
    #[serde(default = "released_out_chans")]
    pub out_chans: usize,
    /// Whether the layers that make queries, keys and values have a bias.
    #[serde(default = "yes")]
    pub qkv_bias: bool,
    /// Whether blocks know relative positions.
    #[serde(default = "yes")]
    pub use_rel_pos: bool,
    /// Rows and columns of the windows, in tokens; 0 if all blocks attend to the whole image.
    #[serde(default = "released_window_size")]
    pub window_size: usize,
    /// Blocks that attend to the whole image, whatever `window_size`.
    pub global_attn_indexes: Vec<usize>,
    /// Epsilon of the blocks' norms; a constant of the original's `norm_layer`.
    #[serde(default = "released_eps")]
    pub layer_norm_eps: f64,
}

fn released_img_size() -> usize {
    1024
}

fn released_patch_size() -> usize {
    16
}

fn released_mlp_ratio() -> f64 {
    4.0
}

fn released_out_chans() -> usize {
    256
}

fn released_window_size() -> usize {
    14
}

fn released_eps() -> f64 {
    1e-6
}

fn yes() -> bool {
    true
}

impl Config {
    /// SAM's ViT-H.
    pub fn released() -> Self {
        Self {
            img_size: released_img_size(),
            patch_size: released_patch_size(),
            embed_dim: 1280,
            depth: 32,
            num_heads: 16,
            mlp_ratio: released_mlp_ratio(),
            out_chans: released_out_chans(),
            qkv_bias: true,
            use_rel_pos: true,
            window_size: released_window_size(),
            global_attn_indexes: vec![7, 15, 23, 31],
            layer_norm_eps: released_eps(),
        }
    }

    /// The configuration of a network that has tensors of these names and shapes, among others.
    ///
    /// Heads and windows are told by the tables of relative positions, so that a network without them is
    /// refused. What no shape tells, `layer_norm_eps`, is the released network's.
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
        let depth = (0..)
            .take_while(|i| shapes.contains_key(&format!("blocks.{i}.norm1.weight")))
            .count();
        let embed_dim = size("patch_embed.proj.weight", 0)?;
        let patch_size = size("patch_embed.proj.weight", 3)?;
        let side = size("pos_embed", 1)?;
        // Tokens in a row of what each block attends to; the table has twice as many lines, less one.
        let spans = (0..depth)
            .map(|i| Ok(size(&format!("blocks.{i}.attn.rel_pos_h"), 0)?.div_ceil(2)))
            .collect::<Result<Vec<_>>>()?;
        let windows: Vec<usize> = spans.iter().copied().filter(|&span| span != side).collect();
        let window_size = windows.first().copied().unwrap_or(0);
        if windows.iter().any(|&span| span != window_size) {
            bail!("the blocks attend within windows of different sizes, {spans:?}");
        }
        let config = Self {
            img_size: side.saturating_mul(patch_size),
            patch_size,
            embed_dim,
            depth,
            num_heads: embed_dim / size("blocks.0.attn.rel_pos_h", 1)?,
            mlp_ratio: size("blocks.0.mlp.lin1.weight", 0)? as f64 / embed_dim as f64,
            out_chans: size("neck.0.weight", 0)?,
            qkv_bias: shapes.contains_key("blocks.0.attn.qkv.bias"),
            use_rel_pos: true,
            window_size,
            global_attn_indexes: (0..depth).filter(|&i| spans[i] == side).collect(),
            layer_norm_eps: released_eps(),
        };
        config.validate()?;
        Ok(config)
    }

    /// Rows and columns of tokens.
    pub fn grid(&self) -> usize {
        self.img_size / self.patch_size
    }

    /// Hidden channels of an MLP.
    pub fn hidden(&self) -> usize {
        (self.embed_dim as f64 * self.mlp_ratio) as usize
    }

    /// Rows and columns of tokens that block `i` attends to.
    pub fn span(&self, i: usize) -> usize {
        match self.window_size == 0 || self.global_attn_indexes.contains(&i) {
            true => self.grid(),
            false => self.window_size,
        }
    }

    /// Refuses sizes with which no network can be built.
    ///
    /// # Errors
    ///
    /// If a size is 0 or absurdly large, or sizes do not divide each other.
    pub(super) fn validate(&self) -> Result<()> {
        const LARGEST: usize = 1 << 16;
        for (name, size) in [
            ("img_size", self.img_size),
            ("patch_size", self.patch_size),
            ("embed_dim", self.embed_dim),
            ("depth", self.depth),
            ("num_heads", self.num_heads),
            ("embed_dim * mlp_ratio", self.hidden()),
            ("out_chans", self.out_chans),
            ("window_size + 1", self.window_size.saturating_add(1)),
        ] {
            if !(1..=LARGEST).contains(&size) {
                bail!("{name} must be from 1 to {LARGEST}, got {size}");
            }
        }
        for (name, part, whole_name, whole) in [
            ("num_heads", self.num_heads, "embed_dim", self.embed_dim),
            ("patch_size", self.patch_size, "img_size", self.img_size),
        ] {
            if !whole.is_multiple_of(part) {
                bail!("{name} = {part} does not divide {whole_name} = {whole}");
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mobilesamv2::vit::Vit;

    fn small() -> Config {
        Config {
            img_size: 48,
            patch_size: 4,
            embed_dim: 24,
            depth: 3,
            num_heads: 2,
            mlp_ratio: 1.5,
            out_chans: 10,
            qkv_bias: false,
            window_size: 5,
            global_attn_indexes: vec![1],
            ..Config::released()
        }
    }

    #[test]
    fn shapes_tell_the_configuration() {
        let without_windows = Config {
            window_size: 0,
            global_attn_indexes: vec![0, 1, 2],
            ..small()
        };
        let windows_only = Config {
            global_attn_indexes: Vec::new(),
            ..small()
        };
        for config in [Config::released(), small(), without_windows, windows_only] {
            let shapes = Vit::tensors(&config).unwrap();
            assert_eq!(Config::from_shapes(&shapes).unwrap(), config);
        }
    }

    #[test]
    fn the_released_network_is_the_default() {
        let text = r#"{"embed_dim": 1280, "depth": 32, "num_heads": 16, "global_attn_indexes": [7, 15, 23, 31]}"#;
        let read: Config = serde_json::from_str(text).unwrap();
        assert_eq!(read, Config::released());
    }

    #[test]
    fn shapes_of_something_else_are_refused_by_name() {
        let refused =
            |shapes: &BTreeMap<_, _>| Config::from_shapes(shapes).unwrap_err().to_string();
        assert!(refused(&BTreeMap::new()).contains("patch_embed.proj.weight"));
        let mut shapes = Vit::tensors(&small()).unwrap();
        shapes.insert("blocks.2.attn.rel_pos_h".to_owned(), vec![5, 12]);
        assert!(refused(&shapes).contains("different sizes"));
        shapes.remove("blocks.2.attn.rel_pos_h");
        assert!(refused(&shapes).contains("blocks.2.attn.rel_pos_h"));
    }

    #[test]
    fn sizes_that_fit_nothing_are_refused() {
        for (config, name) in [
            (
                Config {
                    num_heads: 5,
                    ..small()
                },
                "num_heads",
            ),
            (
                Config {
                    patch_size: 5,
                    ..small()
                },
                "patch_size",
            ),
            (
                Config {
                    depth: 1 << 20,
                    ..small()
                },
                "depth",
            ),
            (
                Config {
                    mlp_ratio: f64::NAN,
                    ..small()
                },
                "mlp_ratio",
            ),
        ] {
            let message = Vit::tensors(&config).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }
}
