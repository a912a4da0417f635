//! Hyper-parameters.

use std::collections::BTreeMap;

use candle_core::{Error, Result, bail};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::plan::Plan;

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

    /// The configuration that `file`, an upstream `config.json`, gives a network that has tensors of these
    /// names and `shapes`, among others: what the file lacks, shapes tell.
    ///
    /// # Errors
    ///
    /// If the file lacks both `num_heads` and `num_head_channels`, which no shape tells, or holds
    /// something that cannot be; or shapes are asked and do not tell.
    pub fn from_file(
        file: &Map<String, Value>,
        shapes: &BTreeMap<String, Vec<usize>>,
    ) -> Result<Self> {
        let number = |key: &str| file.get(key).and_then(Value::as_i64).unwrap_or(unset());
        let (heads, head_channels) = (number("num_heads"), number("num_head_channels"));
        if heads == unset() && head_channels == unset() {
            bail!(
                "the configuration says neither num_head_channels nor num_heads, and no tensor's shape \
                 tells how wide attention heads are"
            );
        }
        let whole = serde_json::from_value::<Self>(Value::Object(file.clone()));
        // The constructor's own default of `channel_mult` is no released network's.
        if let Ok(config) = whole
            && file.contains_key("channel_mult")
        {
            config.validate()?;
            return Ok(config);
        }
        let wrong = |e: serde_json::Error| Error::Msg(format!("the configuration: {e}"));
        let told = Self {
            num_heads: heads,
            num_head_channels: head_channels,
            ..Self::told_by(shapes)?
        };
        let Value::Object(mut all) = serde_json::to_value(told).map_err(wrong)? else {
            bail!("a configuration is no table");
        };
        let given = file.iter().filter(|(_, value)| !value.is_null());
        all.extend(given.map(|(key, value)| (key.clone(), value.clone())));
        let config: Self = serde_json::from_value(Value::Object(all)).map_err(wrong)?;
        config.validate()?;
        Ok(config)
    }

    /// What the names and shapes of a network's tensors tell of its configuration: all but the width of
    /// attention heads, for which the released networks' is taken.
    ///
    /// # Errors
    ///
    /// If a tensor that says a size is missing, or its shape cannot be.
    pub fn from_shapes(shapes: &BTreeMap<String, Vec<usize>>) -> Result<Self> {
        let config = Self::told_by(shapes)?;
        config.validate()?;
        Ok(config)
    }

    /// The same, of which nothing is checked: the width of heads may be another.
    fn told_by(shapes: &BTreeMap<String, Vec<usize>>) -> Result<Self> {
        let size = |name: &str, axis: usize| match shapes.get(name) {
            None => bail!("the tensor {name} is missing"),
            Some(shape) => (shape.get(axis).copied().filter(|&size| size > 0))
                .ok_or_else(|| Error::Msg(format!("the tensor {name} has shape {shape:?}"))),
        };
        let first = "input_blocks.0.0.weight";
        let model_channels = size(first, 0)?;
        let (mut widths, mut repeats) = (vec![model_channels], vec![0]);
        let mut attention = Vec::new();
        for i in 1.. {
            let name = |rest: &str| format!("input_blocks.{i}.{rest}");
            let level = widths.len() - 1;
            if shapes.contains_key(&name("0.op.weight")) {
                widths.push(widths[level]);
                repeats.push(0);
            } else if shapes.contains_key(&name("0.in_layers.2.weight")) {
                let width = size(&name("0.in_layers.2.weight"), 0)?;
                if repeats[level] > 0 && width != widths[level] {
                    bail!(
                        "the blocks of a level have {} and {width} channels",
                        widths[level]
                    );
                }
                widths[level] = width;
                repeats[level] += 1;
                if shapes.contains_key(&name("1.norm.weight")) && !attention.contains(&(1 << level))
                {
                    attention.insert(0, 1 << level);
                }
            } else {
                break;
            }
        }
        if let Some(width) = (widths.iter()).find(|width| !width.is_multiple_of(model_channels)) {
            bail!(
                "a level's {width} channels are no multiple of {model_channels}, those of {first}"
            );
        }
        let image_prompts = (shapes.keys()).any(|name| name.starts_with("image_embed."));
        let camera = "camera_embed.0.weight";
        let has_camera = shapes.contains_key(camera);
        Ok(Self {
            in_channels: size(first, 1)?,
            model_channels,
            out_channels: size("out.2.weight", 0)?,
            num_res_blocks: match repeats.iter().all(|&number| number == repeats[0]) {
                true => Repeats::Same(repeats[0]),
                false => Repeats::Each(repeats),
            },
            attention_resolutions: attention,
            channel_mult: widths.iter().map(|width| width / model_channels).collect(),
            context_dim: size("middle_block.1.transformer_blocks.0.attn2.to_k.weight", 1)?,
            camera_dim: has_camera.then(|| size(camera, 1)).transpose()?,
            ip_dim: usize::from(image_prompts),
            ..Self::released()
        })
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

    /// Refuses what no network can be built of, and variants that See3D does not use.
    ///
    /// # Errors
    ///
    /// With the key and what is wrong with it.
    pub fn validate(&self) -> Result<()> {
        const WIDEST: usize = 1 << 14;
        const LEVELS: usize = 8;
        if !(1..=LEVELS).contains(&self.levels()) {
            bail!(
                "channel_mult must have from 1 to {LEVELS} levels, got {}",
                self.levels()
            );
        }
        if let Repeats::Each(numbers) = &self.num_res_blocks
            && numbers.len() != self.levels()
        {
            bail!(
                "num_res_blocks {numbers:?} and channel_mult {:?} differ in length",
                self.channel_mult
            );
        }
        let sizes = [
            ("in_channels", self.in_channels),
            ("model_channels", self.model_channels),
            ("out_channels", self.out_channels),
            ("context_dim", self.context_dim),
        ];
        let levels = (0..self.levels()).flat_map(|level| {
            let multiple = self.channel_mult[level];
            let width = self.model_channels.saturating_mul(multiple);
            let repeats = self.num_res_blocks.of(level).saturating_mul(1 << 8);
            [
                ("channel_mult", multiple),
                ("model_channels * channel_mult", width),
                ("256 * num_res_blocks", repeats),
            ]
        });
        for (name, size) in sizes.into_iter().chain(levels) {
            if !(1..=WIDEST).contains(&size) {
                bail!("{name} must be from 1 to {WIDEST}, got {size}");
            }
        }
        if !self.model_channels.is_multiple_of(Self::NORM_GROUPS) {
            bail!(
                "model_channels = {} is no multiple of the norms' 32 groups",
                self.model_channels
            );
        }
        if self.channel_mult[0] != 1 {
            bail!(
                "channel_mult must begin with 1, got {:?}: the last convolution takes model_channels",
                self.channel_mult
            );
        }
        self.validate_variant()?;
        self.validate_heads()
    }

    fn validate_variant(&self) -> Result<()> {
        if self.ip_dim > 0 {
            bail!(
                "ip_dim = {}: a network with image prompts takes inputs that See3D's pipeline never \
                 gives; only ip_dim = 0 is supported",
                self.ip_dim
            );
        }
        for (key, wanted, is_so) in [
            ("transformer_depth", "1", self.transformer_depth == 1),
            ("use_scale_shift_norm", "false", !self.use_scale_shift_norm),
            ("resblock_updown", "false", !self.resblock_updown),
            ("num_classes", "null", self.num_classes.is_none()),
            ("n_embed", "null", self.n_embed.is_none()),
            ("conv_resample", "true", self.conv_resample),
            ("dims", "2", self.dims == 2),
        ] {
            if !is_so {
                bail!("{key} must be {wanted}: See3D has no other networks");
            }
        }
        Ok(())
    }

    fn validate_heads(&self) -> Result<()> {
        let width = usize::try_from(self.num_head_channels).ok();
        for channels in Plan::of(self).transformer_channels() {
            let heads = self.heads(channels);
            let shared = heads > 0 && channels.is_multiple_of(heads);
            if !shared || width.is_some_and(|width| width != channels / heads) {
                bail!(
                    "a transformer's {channels} channels cannot be shared among heads as num_head_channels \
                     = {} and num_heads = {} say",
                    self.num_head_channels,
                    self.num_heads
                );
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
