//! Hyper-parameters.

use candle_core::{Error, Result, bail};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The hyper-parameters of an image encoder, under the names and with the defaults that transformers has
/// for them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct VisionConfig {
    /// Channels of the tokens.
    pub hidden_size: usize,
    /// Hidden channels of an MLP.
    pub intermediate_size: usize,
    /// Channels of the result. Files of whole models often say something else here than the tensor
    /// `visual_projection.weight`, which is right.
    pub projection_dim: usize,
    /// Number of layers.
    pub num_hidden_layers: usize,
    /// Attention heads of each layer.
    pub num_attention_heads: usize,
    /// Colours of a picture.
    pub num_channels: usize,
    /// Rows and columns of a picture, in pixels.
    pub image_size: usize,
    /// Side of a square patch, in pixels.
    pub patch_size: usize,
    /// The activation function of the MLPs.
    pub hidden_act: HiddenAct,
    /// Epsilon of all norms.
    pub layer_norm_eps: f64,
}

/// The hyper-parameters of a text encoder, under the names and with the defaults that transformers has
/// for them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TextConfig {
    /// How many different tokens there are.
    pub vocab_size: usize,
    /// Channels of the tokens.
    pub hidden_size: usize,
    /// Hidden channels of an MLP.
    pub intermediate_size: usize,
    /// Number of layers.
    pub num_hidden_layers: usize,
    /// Attention heads of each layer.
    pub num_attention_heads: usize,
    /// The most tokens of a text.
    pub max_position_embeddings: usize,
    /// The activation function of the MLPs.
    pub hidden_act: HiddenAct,
    /// Epsilon of all norms.
    pub layer_norm_eps: f64,
}

/// The activation function of an MLP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HiddenAct {
    /// GELU, the exact one.
    Gelu,
    /// `x / (1 + exp(-1.702 x))`.
    QuickGelu,
}

impl Default for VisionConfig {
    fn default() -> Self {
        Self {
            hidden_size: 768,
            intermediate_size: 3072,
            projection_dim: 512,
            num_hidden_layers: 12,
            num_attention_heads: 12,
            num_channels: 3,
            image_size: 224,
            patch_size: 32,
            hidden_act: HiddenAct::QuickGelu,
            layer_norm_eps: 1e-5,
        }
    }
}

impl Default for TextConfig {
    fn default() -> Self {
        Self {
            vocab_size: 49408,
            hidden_size: 512,
            intermediate_size: 2048,
            num_hidden_layers: 12,
            num_attention_heads: 8,
            max_position_embeddings: 77,
            hidden_act: HiddenAct::QuickGelu,
            layer_norm_eps: 1e-5,
        }
    }
}

impl VisionConfig {
    /// OpenCLIP's ViT-H/14.
    pub fn released() -> Self {
        Self {
            hidden_size: 1280,
            intermediate_size: 5120,
            projection_dim: 1024,
            num_hidden_layers: 32,
            num_attention_heads: 16,
            patch_size: 14,
            hidden_act: HiddenAct::Gelu,
            ..Self::default()
        }
    }

    /// The configuration in a `config.json`, of an image encoder alone or of a whole CLIP, whose
    /// `vision_config` is taken.
    ///
    /// # Errors
    ///
    /// If a value is of another kind than it should, or an activation function is not known.
    pub fn from_json(file: &Value) -> Result<Self> {
        part(file, "vision_config")
    }

    /// Rows and columns of patches.
    pub fn grid(&self) -> usize {
        self.image_size / self.patch_size.max(1)
    }

    /// Patches, and the class token before them.
    pub fn tokens(&self) -> usize {
        self.grid() * self.grid() + 1
    }

    pub(super) fn stack(&self) -> Stack {
        Stack {
            channels: self.hidden_size,
            hidden: self.intermediate_size,
            layers: self.num_hidden_layers,
            heads: self.num_attention_heads,
            activation: self.hidden_act,
            eps: self.layer_norm_eps,
        }
    }

    /// Refuses sizes with which no network can be built.
    ///
    /// # Errors
    ///
    /// If a size is 0 or absurdly large, or sizes do not divide each other.
    pub(super) fn validate(&self) -> Result<()> {
        check("projection_dim", self.projection_dim, LARGEST)?;
        check("num_channels", self.num_channels, 64)?;
        check("image_size", self.image_size, 1 << 13)?;
        check("patch_size", self.patch_size, self.image_size)?;
        self.stack().validate()
    }
}

impl TextConfig {
    /// Stable Diffusion 2.1's.
    pub fn released() -> Self {
        Self {
            hidden_size: 1024,
            intermediate_size: 4096,
            num_hidden_layers: 23,
            num_attention_heads: 16,
            hidden_act: HiddenAct::Gelu,
            ..Self::default()
        }
    }

    /// The configuration in a `config.json`, of a text encoder alone or of a whole CLIP, whose
    /// `text_config` is taken.
    ///
    /// # Errors
    ///
    /// As [`VisionConfig::from_json`].
    pub fn from_json(file: &Value) -> Result<Self> {
        part(file, "text_config")
    }

    pub(super) fn stack(&self) -> Stack {
        Stack {
            channels: self.hidden_size,
            hidden: self.intermediate_size,
            layers: self.num_hidden_layers,
            heads: self.num_attention_heads,
            activation: self.hidden_act,
            eps: self.layer_norm_eps,
        }
    }

    /// As [`VisionConfig::validate`].
    pub(super) fn validate(&self) -> Result<()> {
        check("vocab_size", self.vocab_size, 1 << 24)?;
        let positions = self.max_position_embeddings;
        check("max_position_embeddings", positions, LARGEST)?;
        self.stack().validate()
    }
}

/// What both encoders' layers are built by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stack {
    pub(super) channels: usize,
    /// Hidden channels of an MLP.
    pub(super) hidden: usize,
    pub(super) layers: usize,
    pub(super) heads: usize,
    pub(super) activation: HiddenAct,
    pub(super) eps: f64,
}

impl Stack {
    fn validate(&self) -> Result<()> {
        let Self {
            channels, heads, ..
        } = *self;
        check("hidden_size", channels, LARGEST)?;
        check("intermediate_size", self.hidden, LARGEST)?;
        check("num_hidden_layers", self.layers, 1 << 10)?;
        check("num_attention_heads", heads, LARGEST)?;
        if !channels.is_multiple_of(heads) {
            bail!("num_attention_heads = {heads} does not divide hidden_size = {channels}");
        }
        if !(self.eps.is_finite() && self.eps > 0.0) {
            bail!("layer_norm_eps must be above 0, got {}", self.eps);
        }
        Ok(())
    }
}

const LARGEST: usize = 1 << 16;

fn check(name: &str, size: usize, largest: usize) -> Result<()> {
    if !(1..=largest).contains(&size) {
        bail!("{name} must be from 1 to {largest}, got {size}");
    }
    Ok(())
}

/// The configuration under `name`, if there is one, or else the whole of `file`.
fn part<C: DeserializeOwned>(file: &Value, name: &str) -> Result<C> {
    let part = file.get(name).unwrap_or(file);
    C::deserialize(part).map_err(|e| Error::Msg(format!("the configuration of CLIP: {e}")))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::{TextEncoder, VisionEncoder};
    use super::*;

    #[test]
    fn configurations_of_a_whole_model_and_of_a_part() {
        let vision = json!({"hidden_size": 1280, "intermediate_size": 5120, "hidden_act": "gelu",
            "num_hidden_layers": 32, "num_attention_heads": 16, "patch_size": 14,
            "projection_dim": 1024, "dropout": 0.0});
        let text = json!({"hidden_size": 1024, "intermediate_size": 4096, "hidden_act": "gelu",
            "num_hidden_layers": 23, "num_attention_heads": 16, "projection_dim": 512});
        let whole = json!({"vision_config": vision, "text_config": text, "projection_dim": 7,
            "hidden_size": 8});
        for file in [&vision, &whole] {
            let read = VisionConfig::from_json(file).unwrap();
            assert_eq!(read, VisionConfig::released());
            assert_eq!(read.tokens(), 257);
        }
        for file in [&text, &whole] {
            assert_eq!(TextConfig::from_json(file).unwrap(), TextConfig::released());
        }
        let nothing = json!({});
        let read = VisionConfig::from_json(&nothing).unwrap();
        assert_eq!(read, VisionConfig::default());
        assert_eq!(read.hidden_act, HiddenAct::QuickGelu);
    }

    #[test]
    fn what_is_not_understood_is_named() {
        for (file, problem) in [
            (
                json!({"vision_config": {"hidden_act": "gelu_new"}}),
                "gelu_new",
            ),
            (json!({"hidden_size": -1}), "-1"),
            (json!("x"), "configuration of CLIP"),
        ] {
            let message = VisionConfig::from_json(&file).unwrap_err().to_string();
            assert!(message.contains(problem), "{message}");
        }
    }

    #[test]
    fn sizes_that_fit_nothing_are_refused() {
        type Change<C> = (fn(&mut C), &'static str);
        let vision: [Change<VisionConfig>; 6] = [
            (|c| c.hidden_size = 0, "hidden_size"),
            (|c| c.num_attention_heads = 7, "num_attention_heads"),
            (|c| c.num_hidden_layers = usize::MAX, "num_hidden_layers"),
            (|c| c.patch_size = 225, "patch_size"),
            (|c| c.image_size = 1 << 40, "image_size"),
            (|c| c.layer_norm_eps = f64::NAN, "layer_norm_eps"),
        ];
        for (change, name) in vision {
            let mut config = VisionConfig::released();
            change(&mut config);
            let message = VisionEncoder::tensors(&config).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
        let text: [Change<TextConfig>; 3] = [
            (|c| c.vocab_size = 0, "vocab_size"),
            (|c| c.max_position_embeddings = 0, "max_position_embeddings"),
            (|c| c.intermediate_size = 1 << 50, "intermediate_size"),
        ];
        for (change, name) in text {
            let mut config = TextConfig::released();
            change(&mut config);
            let message = TextEncoder::tensors(&config).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }
}
