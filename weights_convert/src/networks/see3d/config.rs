//! What the networks of See3D are configured with. A pipeline has settings beside its networks: each
//! network's configuration has those that it is of no use without.

use std::fmt;

use serde::{Deserialize, Serialize};
use tid3r_models::see3d::{clip, schedule, unet};

/// Which of the three UNets it is: they are built alike and were trained for different work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// Guided by several photos.
    Sparse,
    /// Guided by one photo.
    Single,
    /// From 512 pixels to 1024.
    SuperResolution,
}

impl Variant {
    /// What the folder is called in which it is published.
    pub(super) fn folder(self) -> &'static str {
        match self {
            Self::Sparse => "sparse",
            Self::Single => "single",
            Self::SuperResolution => "SR",
        }
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Sparse => "sparse",
            Self::Single => "single",
            Self::SuperResolution => "super-resolution",
        })
    }
}

/// A UNet, and the steps in which it was trained to take noise away.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnetConfig {
    /// What it was trained for.
    pub variant: Variant,
    /// The network.
    pub unet: unet::Config,
    /// `scheduler_config.json`.
    pub scheduler: schedule::Config,
}

/// The image encoder, and what a picture must become before it sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageEncoderConfig {
    /// The network.
    pub vision: clip::VisionConfig,
    /// `preprocessor_config.json`.
    pub preprocessor: Preprocessor,
}

/// How a picture becomes what CLIP sees: resized (bicubic), cut to its middle, normalised.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Preprocessor {
    /// What the shorter side is resized to, in pixels.
    pub shortest_edge: usize,
    /// Height and width of the middle that is kept.
    pub crop: [usize; 2],
    /// For red, green and blue from 0 to 1: what is subtracted.
    pub mean: [f32; 3],
    /// What it is divided by then.
    pub std: [f32; 3],
}

impl Preprocessor {
    /// Preprocessing with the colours of CLIP's training, for an encoder of pictures of `side` pixels.
    pub fn of_side(side: usize) -> Self {
        Self {
            shortest_edge: side,
            crop: [side; 2],
            mean: [0.481_454_66, 0.457_827_5, 0.408_210_73],
            std: [0.268_629_54, 0.261_302_6, 0.275_777_1],
        }
    }
}

/// The text encoder, and the only text that it is ever given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextEncoderConfig {
    /// The network.
    pub text: clip::TextConfig,
    /// The empty text as numbers of tokens, made with the tokenizer that is published with the network.
    pub empty_prompt: Vec<u32>,
}

impl TextEncoderConfig {
    /// The empty text of CLIP's tokenizer as Stable Diffusion 2 uses it: the last two tokens are the
    /// beginning and the end of a text, and it is padded with the first.
    pub(super) fn usual_empty_prompt(text: &clip::TextConfig) -> Vec<u32> {
        let last = (text.vocab_size as u32).saturating_sub(1);
        let mut tokens = vec![0; text.max_position_embeddings.max(2)];
        tokens[..2].copy_from_slice(&[last.saturating_sub(1), last]);
        tokens
    }
}
