//! Hyper-parameters.

mod read;
#[cfg(test)]
mod tests;
mod validate;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The hyper-parameters of the network, under the names that `config.json` gives them; other keys of the
/// file change nothing in the network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// Channels of the input: latents, condition latents, mask.
    pub in_channels: usize,
    /// Channels of the finest level.
    pub model_channels: usize,
    /// Channels of the result.
    pub out_channels: usize,
    /// Residual blocks of a level on the way down; on the way up there is one more.
    pub num_res_blocks: Repeats,
    /// Where there is attention, as factors by which the map is smaller than the input.
    pub attention_resolutions: Vec<usize>,
    /// Channels of each level, the finest first, as multiples of `model_channels`.
    #[serde(default = "constructors_channel_mult")]
    pub channel_mult: Vec<usize>,
    /// Attention heads, the same everywhere; -1 if `num_head_channels` says how many.
    #[serde(default = "unset")]
    pub num_heads: i64,
    /// Channels of an attention head; -1 if `num_heads` says how many. No tensor's shape tells it.
    #[serde(default = "unset")]
    pub num_head_channels: i64,
    /// Blocks of a transformer; 1.
    #[serde(default = "one")]
    pub transformer_depth: usize,
    /// Channels of the context that frames attend to.
    pub context_dim: usize,
    /// Numbers of a camera, if there is an embedding for them. The pipeline gives none.
    #[serde(default)]
    pub camera_dim: Option<usize>,
    /// Tokens of an image prompt (ImageDream's variant); 0.
    #[serde(default)]
    pub ip_dim: usize,
    /// Whether timesteps scale as well as shift; no.
    #[serde(default)]
    pub use_scale_shift_norm: bool,
    /// Whether residual blocks change the resolution; no.
    #[serde(default)]
    pub resblock_updown: bool,
    /// Classes to condition on; none.
    #[serde(default)]
    pub num_classes: Option<Value>,
    /// Entries of a codebook to predict; none.
    #[serde(default)]
    pub n_embed: Option<Value>,
    /// Blocks of each level that have attention; unset, all.
    #[serde(default)]
    pub num_attention_blocks: Option<Vec<usize>>,
    /// Whether resolutions change by convolutions; yes.
    #[serde(default = "yes")]
    pub conv_resample: bool,
    /// Dimensions of a map; 2.
    #[serde(default = "two")]
    pub dims: usize,
}

/// A number for each level.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Repeats {
    /// The same for all.
    Same(usize),
    /// One each, the finest level first.
    Each(Vec<usize>),
}

impl Repeats {
    /// The number of a level.
    pub fn of(&self, level: usize) -> usize {
        match self {
            Self::Same(number) => *number,
            Self::Each(numbers) => numbers.get(level).copied().unwrap_or(0),
        }
    }
}

fn constructors_channel_mult() -> Vec<usize> {
    vec![1, 2, 4, 8]
}

fn unset() -> i64 {
    -1
}

fn one() -> usize {
    1
}

fn two() -> usize {
    2
}

fn yes() -> bool {
    true
}

impl Config {
    /// Groups of every group norm.
    pub(super) const NORM_GROUPS: usize = 32;

    /// The three released networks, as far as is known; they differ in their weights.
    pub fn released() -> Self {
        Self {
            in_channels: 9,
            model_channels: 320,
            out_channels: 4,
            num_res_blocks: Repeats::Same(2),
            attention_resolutions: vec![4, 2, 1],
            channel_mult: vec![1, 2, 4, 4],
            num_heads: unset(),
            num_head_channels: 64,
            transformer_depth: 1,
            context_dim: 1024,
            camera_dim: None,
            ip_dim: 0,
            use_scale_shift_norm: false,
            resblock_updown: false,
            num_classes: None,
            n_embed: None,
            num_attention_blocks: None,
            conv_resample: true,
            dims: 2,
        }
    }

    /// Number of levels; a map is halved between each and the next.
    pub fn levels(&self) -> usize {
        self.channel_mult.len()
    }

    /// What height and width of the latents must be multiples of.
    pub fn granularity(&self) -> usize {
        1 << (self.levels() - 1)
    }

    /// Channels of the time embedding.
    pub fn embedding_channels(&self) -> usize {
        4 * self.model_channels
    }

    /// Attention heads of a transformer of so many channels.
    pub(super) fn heads(&self, channels: usize) -> usize {
        let number = |number: i64| usize::try_from(number).unwrap_or(0);
        match self.num_head_channels == unset() {
            true => number(self.num_heads),
            false => channels
                .checked_div(number(self.num_head_channels))
                .unwrap_or(0),
        }
    }

    /// Channels of a level.
    pub(super) fn width(&self, level: usize) -> usize {
        self.model_channels * self.channel_mult[level]
    }

    /// Whether residual block `block` of `level` is followed by a transformer.
    pub(super) fn attends(&self, level: usize, block: usize) -> bool {
        let limit = self
            .num_attention_blocks
            .as_ref()
            .map(|blocks| blocks.get(level));
        let within = limit.is_none_or(|limit| limit.is_some_and(|&limit| block < limit));
        within && self.attention_resolutions.contains(&(1 << level))
    }
}
