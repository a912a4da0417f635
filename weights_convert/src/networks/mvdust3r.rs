//! Checkpoints of MV-DUSt3R, of MV-DUSt3R+ and of the DUSt3R from which both were trained.
//!
//! Nearly everything about the configuration is in the shapes of the tensors. What is not, the
//! numbers of attention heads and the output's bounds, is in the call that made the network, which
//! training scripts save along.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value, json};
use tid3r_models::mvdust3r::{Config, MvDust3r};

use super::plan::{Hints, Plan, differences, unfit};
use super::{Network, Source, constructor};
use crate::{Checkpoint, Error, Result};

pub(super) const MV_DUST3R: Network = Network {
    name: "mvdust3r",
    title: "MV-DUSt3R",
    source: Source::HuggingFace("Zhenggang/MV-DUSt3R"),
    files: &["checkpoints/MVD.pth"],
    folder: None,
    beside: None,
    purpose: "reconstruction from photos",
    upstream: "https://github.com/facebookresearch/mvdust3r",
    licence: "CC BY-NC 4.0, non-commercial use only",
    parameters: 547_989_522,
    released: || super::Config::MvDust3r(Config::mv_dust3r()),
    tiny: || tiny(&Config::mv_dust3r()),
    adjustments: &[],
};

/// Stage 1 was trained on 8 views; stage 2 is stage 1 finetuned on 4 to 12.
pub(super) const MV_DUST3R_PLUS: Network = Network {
    name: "mvdust3r-plus",
    title: "MV-DUSt3R+",
    files: &["checkpoints/MVDp_s2.pth", "checkpoints/MVDp_s1.pth"],
    parameters: 661_429_266,
    released: || super::Config::MvDust3r(Config::mv_dust3r_plus()),
    tiny: || tiny(&Config::mv_dust3r_plus()),
    ..MV_DUST3R
};

/// Channels of an attention head in every published network of this family.
const HEAD_CHANNELS: usize = 64;
/// More blocks than this are a mistake in a configuration file, and would be listed one by one.
const DEEPEST: usize = 1 << 10;
/// Reference views of MV-DUSt3R+ in its demo; checkpoints do not say it.
const REFERENCES: usize = 4;

/// Widths and depths with which the network runs in a moment.
fn tiny(released: &Config) -> super::Config {
    super::Config::MvDust3r(Config {
        enc_embed_dim: 32,
        enc_depth: 2,
        enc_num_heads: 2,
        dec_embed_dim: 32,
        dec_depth: 2,
        dec_num_heads: 2,
        skip_dim: 8,
        gs_mlp_dim: 16,
        ..released.clone()
    })
}

/// Whether the tensors of a checkpoint have the names of this family.
pub(super) fn recognise(checkpoint: &Checkpoint) -> bool {
    let shapes = checkpoint.shapes();
    [
        "patch_embed.proj.weight",
        "enc_blocks.0.norm1.weight",
        "decoder_embed.weight",
    ]
    .iter()
    .all(|name| shapes.contains_key(name))
}

/// Whether a tensor is in checkpoints without having an effect.
fn is_idle(name: &str) -> bool {
    name == "mask_token" || name.ends_with(".num_batches_tracked")
}

/// Finds out the configuration and where each tensor comes from.
pub(super) fn plan(checkpoint: &Checkpoint, hints: Hints<'_>) -> Result<Plan> {
    let mut found = checkpoint.shapes();
    found.retain(|name, _| !is_idle(name));
    let mut notes = Vec::new();

    // Of an encoder-decoder that is not trained for several views, both decoders are the same.
    let second = |name: &str| Some(format!("dec_blocks2.{}", name.strip_prefix("dec_blocks.")?));
    let copied: BTreeMap<String, &str> =
        if found.keys().any(|name| name.starts_with("dec_blocks2.")) {
            BTreeMap::new()
        } else {
            found
                .keys()
                .filter_map(|name| Some((second(name)?, *name)))
                .collect()
        };
    if !copied.is_empty() {
        notes.push("it has one decoder: dec_blocks2 is a copy of dec_blocks".to_owned());
    }
    let mut complete = found.clone();
    complete.extend(copied.iter().map(|(name, of)| (name.as_str(), found[of])));

    let config = match hints.config {
        Some(super::Config::MvDust3r(config)) => config.clone(),
        _ => configuration(checkpoint, &found, hints, &mut notes)?,
    };
    let network = super::Config::MvDust3r(config.clone()).network();
    let refuse = |problem: &str| unfit(checkpoint.path(), network, problem);
    let wanted = tensors(&config).map_err(|problem| refuse(&problem))?;
    let problems = differences(&wanted, &complete);
    if !problems.is_empty() {
        return Err(refuse(&problems.join("; ")));
    }
    for (absent, what) in [
        (!config.gs, "it has no Gaussian heads"),
        (
            !config.pts_head_config.skip,
            "its points heads have no skip branch",
        ),
    ] {
        if absent {
            notes.push(format!(
                "{what}: a DUSt3R that was not trained as {}",
                network.title
            ));
        }
    }
    let source = |name: &str| copied.get(name).copied().unwrap_or(name).to_owned();
    let tensors = wanted.into_iter().map(|(name, shape)| {
        let source = source(&name);
        (name, (shape, source))
    });
    Ok(Plan {
        tensors: tensors.collect(),
        config: super::Config::MvDust3r(config),
        notes,
    })
}

/// The configuration, from shapes and from the call that made the network.
fn configuration(
    checkpoint: &Checkpoint,
    shapes: &BTreeMap<&str, &[usize]>,
    hints: Hints<'_>,
    notes: &mut Vec<String>,
) -> Result<Config> {
    let path = checkpoint.path();
    let refuse = |problem: String| unfit(path, &MV_DUST3R, &problem);
    let from_shapes = sizes(shapes).map_err(refuse)?;
    let called = match checkpoint.constructor() {
        None => Map::new(),
        Some(text) => constructor::arguments(text).map_err(|problem| {
            Error::file(
                path,
                format!(
                    "the call that made its network (`args.model`) cannot be understood: {problem}"
                ),
                "save its state dict alone: torch.save(checkpoint[\"model\"], NEW) in Python",
            )
        })?,
    };
    for (name, wanted) in [("head_type", "linear"), ("output_mode", "pts3d")] {
        match called.get(name) {
            Some(other) if other != wanted => {
                return Err(refuse(format!(
                    "{name} is {other}, where only \"{wanted}\" is known"
                )));
            }
            _ => {}
        }
    }
    for (name, size) in &from_shapes {
        if let Some(said) = called
            .get(name)
            .filter(|said| said.is_number() && *said != size)
        {
            return Err(refuse(format!(
                "{name} is {size} by its tensors and {said} by its call"
            )));
        }
    }
    let mut fields = from_shapes;
    for name in [
        "pos_embed",
        "depth_mode",
        "conf_mode",
        "enc_num_heads",
        "dec_num_heads",
    ] {
        if let Some(value) = called.get(name) {
            fields.insert(name.to_owned(), value.clone());
        }
    }
    if let Some((encoder, decoder)) = hints.heads {
        fields.insert("enc_num_heads".to_owned(), encoder.into());
        fields.insert("dec_num_heads".to_owned(), decoder.into());
    }
    for (heads, channels) in [
        ("enc_num_heads", "enc_embed_dim"),
        ("dec_num_heads", "dec_embed_dim"),
    ] {
        if fields.contains_key(heads) {
            continue;
        }
        let channels = fields[channels].as_u64().unwrap_or(0) as usize;
        if !channels.is_multiple_of(HEAD_CHANNELS) {
            return Err(Error::file(
                path,
                format!("it does not say its number of attention heads ({heads})"),
                "give them: --heads ENCODER,DECODER",
            ));
        }
        notes.push(format!(
            "{heads} is not in the file: {HEAD_CHANNELS} channels a head are assumed"
        ));
        fields.insert(heads.to_owned(), (channels / HEAD_CHANNELS).into());
    }
    let released = serde_json::to_value(Config::mv_dust3r()).map_err(|e| refuse(e.to_string()))?;
    if let Value::Object(released) = released {
        for (name, value) in released {
            fields.entry(name).or_insert(value);
        }
    }
    serde_json::from_value(Value::Object(fields)).map_err(|e| refuse(e.to_string()))
}

/// The fields of the configuration that shapes tell, under their names there.
fn sizes(shapes: &BTreeMap<&str, &[usize]>) -> Result<Map<String, Value>, String> {
    let shape = |name: &str, dimensions: usize| match shapes.get(name) {
        Some(shape) if shape.len() == dimensions && !shape.contains(&0) => Ok(*shape),
        Some(shape) => Err(format!("`{name}` has shape {shape:?}")),
        None => Err(format!("`{name}` is missing")),
    };
    let patches = shape("patch_embed.proj.weight", 4)?;
    let decoder = shape("decoder_embed.weight", 2)?[0];
    let encoder = patches[0];
    let hidden = shape("enc_blocks.0.mlp.fc1.weight", 2)?[0];
    if !hidden.is_multiple_of(encoder) {
        return Err(format!(
            "its MLP has {hidden} channels, no multiple of {encoder}"
        ));
    }
    let has = |prefix: &str| shapes.keys().any(|name| name.starts_with(prefix));
    let (skip, gaussians) = (
        has("downstream_head1.skip_proj."),
        has("downstream_GS_head."),
    );
    let references = has("dec_same_view_blocks.0.");
    let mut fields = Map::new();
    let mut set = |name: &str, value: Value| fields.insert(name.to_owned(), value);
    set("patch_size", patches[3].into());
    set("enc_embed_dim", encoder.into());
    set("enc_depth", blocks(shapes, "enc_blocks.").into());
    set("dec_embed_dim", decoder.into());
    set("dec_depth", blocks(shapes, "dec_blocks.").into());
    set("mlp_ratio", (hidden / encoder).into());
    set("GS", gaussians.into());
    set("pts_head_config", json!({ "skip": skip }));
    set("m_ref_flag", references.into());
    set("n_ref", references.then_some(REFERENCES).into());
    if skip {
        set(
            "skip_dim",
            shape("downstream_head1.skip_proj.0.conv.weight", 4)?[0].into(),
        );
    }
    if gaussians {
        set(
            "gs_mlp_dim",
            shape("downstream_GS_head.0.mlp_rgb.0.weight", 2)?[0].into(),
        );
        let colours = shape("downstream_GS_head.0.mlp_rgb.2.weight", 2)?[0];
        set("sh_degree", harmonics(colours, patches[3])?.into());
    }
    Ok(fields)
}

/// How many different numbers follow `prefix`.
fn blocks(shapes: &BTreeMap<&str, &[usize]>, prefix: &str) -> usize {
    let rests = shapes.keys().filter_map(|name| name.strip_prefix(prefix));
    let numbers = rests.filter_map(|rest| rest.split('.').next());
    numbers.collect::<BTreeSet<_>>().len()
}

/// The degree of spherical harmonics: each pixel of a patch has 3 (degree + 1)^2 channels.
fn harmonics(channels: usize, patch: usize) -> Result<usize, String> {
    let pixels = patch.saturating_mul(patch);
    (0..=4_usize)
        .find(|degree| pixels.checked_mul(3 * (degree + 1).pow(2)) == Some(channels))
        .ok_or_else(|| format!("its Gaussian heads make {channels} channels of colour"))
}

/// Names and shapes of the tensors that the network uses.
pub(super) fn tensors(config: &Config) -> Result<BTreeMap<String, Vec<usize>>, String> {
    let depth = config.enc_depth.max(config.dec_depth);
    if depth > DEEPEST {
        return Err(format!("{depth} blocks are more than any network has"));
    }
    MvDust3r::tensors(config).map_err(|e| e.to_string())
}
