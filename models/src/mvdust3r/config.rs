//! Hyper-parameters.

use candle_core::bail;
use serde::{Deserialize, Serialize};

/// The hyper-parameters of MV-DUSt3R and MV-DUSt3R+, under the names that the original code gives
/// them.
///
/// Fields of the original's configuration that are not here are ignored when one is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// How positions enter the network.
    pub pos_embed: PositionEncoding,
    /// Side of a square patch, in pixels.
    pub patch_size: usize,
    /// Channels of the encoder's tokens.
    pub enc_embed_dim: usize,
    /// Number of encoder blocks.
    pub enc_depth: usize,
    /// Attention heads of each encoder block.
    pub enc_num_heads: usize,
    /// Channels of the decoder's tokens.
    pub dec_embed_dim: usize,
    /// Number of decoder layers.
    pub dec_depth: usize,
    /// Attention heads of each decoder block.
    pub dec_num_heads: usize,
    /// Hidden channels of an MLP, as a multiple of the tokens' channels.
    pub mlp_ratio: usize,
    /// How raw points become points.
    pub depth_mode: ExpMode,
    /// How raw confidences become confidences.
    pub conf_mode: ExpMode,
    /// Whether there are Gaussian heads.
    #[serde(rename = "GS", default)]
    pub gs: bool,
    /// Degree of the spherical harmonics of the Gaussians' colours.
    #[serde(default)]
    pub sh_degree: usize,
    /// The points heads.
    #[serde(default)]
    pub pts_head_config: PointsHeadConfig,
    /// Whether paths with other reference views exchange what they know: MV-DUSt3R+.
    #[serde(default)]
    pub m_ref_flag: bool,
    /// Reference views, and paths, of MV-DUSt3R+; 1 if not given. It is no property of the weights.
    #[serde(default)]
    pub n_ref: Option<usize>,
    /// Channels inside the skip branch of the points heads; a constant of the original.
    #[serde(default = "released_skip_dim")]
    pub skip_dim: usize,
    /// Hidden channels of the Gaussian heads; a constant of the original.
    #[serde(default = "released_gs_mlp_dim")]
    pub gs_mlp_dim: usize,
}

fn released_skip_dim() -> usize {
    256
}

fn released_gs_mlp_dim() -> usize {
    768
}

/// The points heads' configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointsHeadConfig {
    /// Whether the image enters the head through a convolutional branch.
    #[serde(default)]
    pub skip: bool,
}

impl Config {
    /// The released MV-DUSt3R.
    pub fn mv_dust3r() -> Self {
        Self {
            pos_embed: PositionEncoding { base: 100.0 },
            patch_size: 16,
            enc_embed_dim: 1024,
            enc_depth: 24,
            enc_num_heads: 16,
            dec_embed_dim: 768,
            dec_depth: 12,
            dec_num_heads: 12,
            mlp_ratio: 4,
            depth_mode: ExpMode {
                low: f64::NEG_INFINITY,
                high: f64::INFINITY,
            },
            conf_mode: ExpMode {
                low: 1.0,
                high: 1e9,
            },
            gs: true,
            sh_degree: 0,
            pts_head_config: PointsHeadConfig { skip: true },
            m_ref_flag: false,
            n_ref: None,
            skip_dim: released_skip_dim(),
            gs_mlp_dim: released_gs_mlp_dim(),
        }
    }

    /// The released MV-DUSt3R+, with the four reference views of its demo.
    pub fn mv_dust3r_plus() -> Self {
        Self {
            m_ref_flag: true,
            n_ref: Some(4),
            ..Self::mv_dust3r()
        }
    }

    /// The number of reference views, which is the number of paths.
    pub fn references(&self) -> usize {
        self.n_ref.unwrap_or(1)
    }

    /// Refuses sizes with which no network can be built.
    ///
    /// # Errors
    ///
    /// If a size is 0 or absurdly large, the heads do not divide the channels, or reference views
    /// do not fit `m_ref_flag`.
    pub(super) fn validate(&self) -> candle_core::Result<()> {
        const LARGEST: usize = 1 << 16;
        for (name, size) in [
            ("patch_size", self.patch_size),
            ("enc_embed_dim", self.enc_embed_dim),
            ("enc_depth", self.enc_depth),
            ("enc_num_heads", self.enc_num_heads),
            ("dec_embed_dim", self.dec_embed_dim),
            ("dec_depth", self.dec_depth),
            ("dec_num_heads", self.dec_num_heads),
            ("mlp_ratio", self.mlp_ratio),
            ("n_ref", self.references()),
            ("skip_dim", self.skip_dim),
            ("gs_mlp_dim", self.gs_mlp_dim),
            ("sh_degree + 1", self.sh_degree.saturating_add(1)),
        ] {
            if !(1..=LARGEST).contains(&size) {
                bail!("{name} must be from 1 to {LARGEST}, got {size}");
            }
        }
        for (kind, heads, channels) in [
            ("enc", self.enc_num_heads, self.enc_embed_dim),
            ("dec", self.dec_num_heads, self.dec_embed_dim),
        ] {
            if !channels.is_multiple_of(heads) {
                bail!("{kind}_num_heads = {heads} does not divide {kind}_embed_dim = {channels}");
            }
        }
        if self.m_ref_flag && self.references() == 1 {
            bail!("m_ref_flag wants several reference views: n_ref must be 2 or more");
        }
        Ok(())
    }
}

/// Rotary position embedding with a certain base; `RoPE100` in a configuration file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct PositionEncoding {
    /// The base of the geometric series of frequencies.
    pub base: f32,
}

impl TryFrom<String> for PositionEncoding {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        name.strip_prefix("RoPE")
            .and_then(|base| base.parse().ok())
            .filter(|base: &f32| base.is_finite() && *base > 0.0)
            .map(|base| Self { base })
            .ok_or_else(|| format!("pos_embed `{name}` is not supported; expected `RoPE100`"))
    }
}

impl From<PositionEncoding> for String {
    fn from(encoding: PositionEncoding) -> Self {
        format!("RoPE{}", encoding.base)
    }
}

/// An exponential with bounds; `["exp", 1, 1e9]` in a configuration file, where infinite bounds are
/// the strings `"-inf"` and `"inf"`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "(String, Bound, Bound)", into = "(String, Bound, Bound)")]
pub struct ExpMode {
    /// The least value.
    pub low: f64,
    /// The greatest value.
    pub high: f64,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(untagged)]
enum Bound {
    Finite(f64),
    Infinite(String),
}

impl TryFrom<(String, Bound, Bound)> for ExpMode {
    type Error = String;

    fn try_from((kind, low, high): (String, Bound, Bound)) -> Result<Self, String> {
        if kind != "exp" {
            return Err(format!("mode `{kind}` is not supported; expected `exp`"));
        }
        let value = |bound| match bound {
            Bound::Finite(value) => Ok(value),
            Bound::Infinite(text) => match text.as_str() {
                "inf" => Ok(f64::INFINITY),
                "-inf" => Ok(f64::NEG_INFINITY),
                _ => Err(format!("`{text}` is no bound")),
            },
        };
        Ok(Self {
            low: value(low)?,
            high: value(high)?,
        })
    }
}

impl From<ExpMode> for (String, Bound, Bound) {
    fn from(mode: ExpMode) -> Self {
        let bound = |value: f64| {
            if value.is_finite() {
                Bound::Finite(value)
            } else {
                Bound::Infinite(value.to_string())
            }
        };
        ("exp".to_owned(), bound(mode.low), bound(mode.high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_survives_the_way_through_json() {
        for config in [Config::mv_dust3r(), Config::mv_dust3r_plus()] {
            let text = serde_json::to_string(&config).unwrap();
            assert!(text.contains(r#""pos_embed":"RoPE100""#), "{text}");
            assert!(
                text.contains(r#""depth_mode":["exp","-inf","inf"]"#),
                "{text}"
            );
            assert_eq!(serde_json::from_str::<Config>(&text).unwrap(), config);
        }
    }

    #[test]
    fn what_is_not_implemented_is_refused() {
        for name in ["cosine", "RoPE", "RoPE-1", "RoPEinf", "RoPENaN", "RoPE0"] {
            assert!(
                PositionEncoding::try_from(name.to_owned()).is_err(),
                "{name}"
            );
        }
        for mode in [r#"["linear", 0, 1]"#, r#"["exp", "x", 1]"#] {
            assert!(serde_json::from_str::<ExpMode>(mode).is_err(), "{mode}");
        }
    }

    #[test]
    fn sizes_that_fit_nothing_are_refused() {
        Config::mv_dust3r().validate().unwrap();
        Config::mv_dust3r_plus().validate().unwrap();
        for heads in [0, 15, 1 << 20] {
            let config = Config {
                enc_num_heads: heads,
                ..Config::mv_dust3r()
            };
            let message = config.validate().unwrap_err().to_string();
            assert!(message.contains("enc_num_heads"), "{message}");
        }
        let config = Config {
            m_ref_flag: true,
            ..Config::mv_dust3r()
        };
        let message = config.validate().unwrap_err().to_string();
        assert!(message.contains("n_ref"), "{message}");
    }
}
