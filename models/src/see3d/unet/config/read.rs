//! Hyper-parameters from a file, and from the shapes of tensors.

use std::collections::BTreeMap;

use candle_core::{Error, Result, bail};
use serde_json::{Map, Value};

use super::{Config, Repeats, unset};

impl Config {
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
}
