//! Hyper-parameters.

use candle_core::bail;
use serde::{Deserialize, Serialize};

/// The hyper-parameters of the encoder, under the names that the original code gives them.
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
    /// Hidden channels of an MLP, as a multiple of the tokens' channels.
    pub mlp_ratio: usize,
}

impl Config {
    /// The released networks, MV-DUSt3R and MV-DUSt3R+ alike.
    pub fn released() -> Self {
        Self {
            pos_embed: PositionEncoding { base: 100.0 },
            patch_size: 16,
            enc_embed_dim: 1024,
            enc_depth: 24,
            enc_num_heads: 16,
            mlp_ratio: 4,
        }
    }

    /// Refuses sizes with which no network can be built.
    ///
    /// # Errors
    ///
    /// If a size is 0 or absurdly large, or the heads do not divide the channels.
    pub(super) fn validate(&self) -> candle_core::Result<()> {
        const LARGEST: usize = 1 << 16;
        for (name, size) in [
            ("patch_size", self.patch_size),
            ("enc_embed_dim", self.enc_embed_dim),
            ("enc_depth", self.enc_depth),
            ("enc_num_heads", self.enc_num_heads),
            ("mlp_ratio", self.mlp_ratio),
        ] {
            if !(1..=LARGEST).contains(&size) {
                bail!("{name} must be from 1 to {LARGEST}, got {size}");
            }
        }
        if !self.enc_embed_dim.is_multiple_of(self.enc_num_heads) {
            bail!(
                "enc_num_heads = {} does not divide enc_embed_dim = {}",
                self.enc_num_heads,
                self.enc_embed_dim
            );
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_survives_the_way_through_json() {
        let text = serde_json::to_string(&Config::released()).unwrap();
        assert!(text.contains(r#""pos_embed":"RoPE100""#), "{text}");
        assert_eq!(
            serde_json::from_str::<Config>(&text).unwrap(),
            Config::released()
        );
    }

    #[test]
    fn other_position_encodings_are_refused() {
        for name in ["cosine", "RoPE", "RoPE-1", "RoPEinf", "RoPENaN", "RoPE0"] {
            assert!(
                PositionEncoding::try_from(name.to_owned()).is_err(),
                "{name}"
            );
        }
    }

    #[test]
    fn sizes_that_fit_nothing_are_refused() {
        Config::released().validate().unwrap();
        for enc_num_heads in [0, 15, 1 << 20] {
            let config = Config {
                enc_num_heads,
                ..Config::released()
            };
            let message = config.validate().unwrap_err().to_string();
            assert!(message.contains("enc_num_heads"), "{message}");
        }
    }
}
