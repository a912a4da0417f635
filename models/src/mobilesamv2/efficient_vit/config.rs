//! Hyper-parameters.

use std::collections::BTreeMap;

use candle_core::{Error, Result, bail};
use serde::{Deserialize, Serialize};

/// The hyper-parameters of an EfficientViT-SAM encoder of the large (`l`) family, under the names
/// that the original code gives them.
///
/// What is the same in all networks of the family (`norm` bn2d, `act_func` gelu, `middle_op` fmbconv,
/// `fid_list` stages 4, 3 and 2) is no field, and ignored when a configuration is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// Channels of each stage.
    pub width_list: [usize; 5],
    /// Blocks of each stage, after the one that halves the image.
    pub depth_list: [usize; 5],
    /// Channels of a head of the linear attention.
    pub qkv_dim: usize,
    /// Channels of the neck.
    pub head_width: usize,
    /// Blocks of the neck.
    pub head_depth: usize,
    /// Hidden channels of the neck's blocks, as a multiple of its channels.
    #[serde(default = "released_expand_ratio")]
    pub expand_ratio: usize,
    /// Channels of the result.
    #[serde(default = "released_out_dim")]
    pub out_dim: usize,
    /// What all norms add to a variance.
    #[serde(default = "released_norm_eps")]
    pub norm_eps: f64,
}

fn released_expand_ratio() -> usize {
    1
}

fn released_out_dim() -> usize {
    256
}

fn released_norm_eps() -> f64 {
    1e-6
}

impl Config {
    /// The released network of MobileSAMv2, `l2`.
    pub fn released() -> Self {
        Self {
            width_list: [32, 64, 128, 256, 512],
            depth_list: [1, 2, 2, 8, 8],
            qkv_dim: 32,
            head_width: 256,
            head_depth: 12,
            expand_ratio: released_expand_ratio(),
            out_dim: released_out_dim(),
            norm_eps: released_norm_eps(),
        }
    }

    /// The configuration of a network that has tensors of these names and shapes, among others.
    ///
    /// Sizes that no shape tells, `norm_eps` and in a network without attention `qkv_dim`, are the
    /// released network's.
    ///
    /// # Errors
    ///
    /// If a tensor that says a size is missing, or has none of the wanted number of dimensions.
    pub fn from_shapes(shapes: &BTreeMap<String, Vec<usize>>) -> Result<Self> {
        let released = Self::released();
        let size = |name: &str, axis: usize| {
            let shape = shapes.get(name);
            shape
                .and_then(|shape| shape.get(axis))
                .copied()
                .ok_or_else(|| {
                    Error::Msg(match shape {
                        None => format!("the tensor {name} is missing"),
                        Some(shape) => format!("the tensor {name} has shape {shape:?}"),
                    })
                })
        };
        // As many as there are numbers in use, without a gap, from 0 on.
        let count = |list: &str| {
            let is_used = |i: &usize| {
                let prefix = format!("{list}.{i}.");
                let mut names = shapes.range(prefix.clone()..).map(|(name, _)| name);
                names.next().is_some_and(|name| name.starts_with(&prefix))
            };
            (0..).take_while(is_used).count()
        };
        let mut width_list = released.width_list;
        let mut depth_list = released.depth_list;
        for (stage, (width, depth)) in width_list.iter_mut().zip(&mut depth_list).enumerate() {
            let list = format!("backbone.stages.{stage}.op_list");
            let last = if stage == 0 {
                "conv.weight"
            } else {
                "main.point_conv.conv.weight"
            };
            *width = size(&format!("{list}.0.{last}"), 0)?;
            *depth = count(&list).saturating_sub(1);
        }
        let head_width = size("neck.input_ops.0.op_list.0.conv.weight", 0)?;
        let middle = "neck.middle.op_list";
        let head_depth = count(middle);
        let config = Self {
            width_list,
            depth_list,
            qkv_dim: match depth_list[4] {
                0 => released.qkv_dim,
                _ => size(
                    "backbone.stages.4.op_list.1.context_module.main.aggreg.0.1.weight",
                    1,
                )?,
            },
            head_width,
            head_depth,
            expand_ratio: match head_depth {
                0 => released.expand_ratio,
                _ => {
                    size(&format!("{middle}.0.main.spatial_conv.conv.weight"), 0)?
                        / head_width.max(1)
                }
            },
            out_dim: size("norm.weight", 0)?,
            norm_eps: released.norm_eps,
        };
        config.validate()?;
        Ok(config)
    }

    /// Heads of the linear attention.
    pub(super) fn heads(&self) -> usize {
        self.width_list[4] / self.qkv_dim
    }

    /// Refuses sizes with which no network can be built.
    ///
    /// # Errors
    ///
    /// If a size is 0 or absurdly large, or a head has more channels than there are.
    pub(super) fn validate(&self) -> Result<()> {
        const LARGEST: usize = 1 << 16;
        let one_each = [
            ("qkv_dim", self.qkv_dim),
            ("head_width", self.head_width),
            ("expand_ratio", self.expand_ratio),
            ("out_dim", self.out_dim),
        ];
        let widths = self.width_list.map(|width| ("width_list", width));
        for (name, size) in one_each.into_iter().chain(widths) {
            if !(1..=LARGEST).contains(&size) {
                bail!("{name} must be from 1 to {LARGEST}, got {size}");
            }
        }
        let depths = self.depth_list.map(|depth| ("depth_list", depth));
        for (name, size) in depths.into_iter().chain([("head_depth", self.head_depth)]) {
            if size > LARGEST {
                bail!("{name} must be at most {LARGEST}, got {size}");
            }
        }
        if self.qkv_dim > self.width_list[4] {
            bail!(
                "qkv_dim = {} leaves no head in {} channels",
                self.qkv_dim,
                self.width_list[4]
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mobilesamv2::efficient_vit::EfficientVit;

    fn small() -> Config {
        Config {
            width_list: [8, 16, 24, 32, 48],
            depth_list: [0, 2, 1, 0, 3],
            qkv_dim: 16,
            head_width: 20,
            head_depth: 11,
            expand_ratio: 3,
            out_dim: 12,
            ..Config::released()
        }
    }

    fn from_its_shapes(config: &Config) -> Result<Config> {
        Config::from_shapes(&EfficientVit::tensors(config)?)
    }

    #[test]
    fn shapes_tell_the_configuration() {
        let without_attention = Config {
            depth_list: [1, 1, 1, 1, 0],
            qkv_dim: 32,
            ..small()
        };
        for config in [Config::released(), small(), without_attention] {
            assert_eq!(from_its_shapes(&config).unwrap(), config);
        }
    }

    #[test]
    fn shapes_of_something_else_are_refused_by_name() {
        let message = Config::from_shapes(&BTreeMap::new())
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("stages.0.op_list.0.conv.weight"),
            "{message}"
        );
        let mut shapes = EfficientVit::tensors(&small()).unwrap();
        shapes.insert("norm.weight".to_owned(), Vec::new());
        let message = Config::from_shapes(&shapes).unwrap_err().to_string();
        assert!(message.contains("norm.weight"), "{message}");
    }

    #[test]
    fn the_originals_own_configuration_is_read() {
        let text = r#"{"width_list": [32, 64, 128, 256, 512], "depth_list": [1, 2, 2, 8, 8], "qkv_dim": 32,
            "head_width": 256, "head_depth": 12, "norm": "bn2d", "middle_op": "fmbconv"}"#;
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
                    width_list: [8, 0, 8, 8, 8],
                    ..small()
                },
                "width_list",
            ),
            (
                Config {
                    depth_list: [1 << 20; 5],
                    ..small()
                },
                "depth_list",
            ),
            (
                Config {
                    qkv_dim: 49,
                    ..small()
                },
                "qkv_dim",
            ),
            (
                Config {
                    out_dim: 0,
                    ..small()
                },
                "out_dim",
            ),
        ] {
            let message = EfficientVit::tensors(&config).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }
}
