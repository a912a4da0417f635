//! The prompt encoder and mask decoder.

use tid3r_models::mobilesamv2::decoder::Config;

use super::{Found, Network, Part, Source, UPSTREAM, as_it_is};
use crate::networks::Hints;
use crate::synth::Adjustment;

pub(in crate::networks) const DECODER: Network = Network {
    name: "mobilesamv2-decoder",
    title: "MobileSAMv2's prompt-guided mask decoder",
    source: Source::Page(
        "https://github.com/ChaoningZhang/MobileSAM/tree/master/MobileSAMv2/PromptGuidedDecoder",
    ),
    files: &["Prompt_guided_Mask_Decoder.pt"],
    folder: None,
    beside: None,
    purpose: "segmentation: a mask for each box",
    upstream: UPSTREAM,
    licence: "Apache-2.0",
    parameters: 4_059_364,
    released: || super::Config::Decoder(Config::released()),
    tiny: || {
        // The embeddings of an image have 256 channels, whatever made them.
        let mut config = Config::released();
        config.mask_decoder.mlp_dim = 64;
        super::Config::Decoder(config)
    },
    // Boxes of different places shall look different.
    adjustments: &[Adjustment::Times(
        "positional_encoding_gaussian_matrix",
        8.0,
    )],
};

pub(super) const PART: Part = Part {
    network: DECODER,
    marks: &[
        "prompt_encoder.pe_layer.positional_encoding_gaussian_matrix",
        "mask_decoder.mask_tokens.weight",
    ],
    layouts: &[published, as_it_is],
    is_idle,
    configure,
};

/// The names in the file of MobileSAMv2, which holds a state dict for each of two parts.
fn published(name: &str) -> Option<String> {
    let (part, rest) = name.split_once('.')?;
    match part {
        "PromtEncoder" => Some(format!("prompt_encoder.{rest}")),
        "MaskDecoder" => Some(format!("mask_decoder.{rest}")),
        _ => None,
    }
}

/// Prompts are boxes: never points, nor masks.
fn is_idle(name: &str) -> bool {
    [
        "prompt_encoder.mask_downscaling.",
        "prompt_encoder.not_a_point_embed.",
        "prompt_encoder.point_embeddings.",
    ]
    .iter()
    .any(|part| name.starts_with(part))
}

fn configure(found: &mut Found<'_>, hints: &Hints<'_>) -> Result<super::Config, String> {
    let mut config = Config::from_shapes(&found.shapes()).map_err(|e| e.to_string())?;
    let decoder = &mut config.mask_decoder;
    let released = Config::released().mask_decoder;
    match hints.heads {
        Some((_, heads)) => decoder.num_heads = heads,
        None if decoder.transformer_dim == released.transformer_dim => {}
        None => found.notes.push(format!(
            "num_heads is not in the file: {} are assumed (--heads says others)",
            decoder.num_heads
        )),
    }
    Ok(super::Config::Decoder(config))
}
