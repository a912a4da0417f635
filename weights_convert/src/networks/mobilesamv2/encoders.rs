//! The image encoders.

use tid3r_models::mobilesamv2::{efficient_vit, tiny_vit, vit};

use super::{Found, Network, Part, README, Source, UPSTREAM, as_it_is, is_counter};
use crate::networks::Config;

pub(in crate::networks) const EFFICIENT_VIT: Network = Network {
    name: "mobilesamv2-efficientvit-l2",
    title: "EfficientViT-SAM L2's image encoder",
    source: README,
    files: &["l2.pt"],
    folder: None,
    beside: None,
    purpose: "segmentation: the default encoder",
    upstream: UPSTREAM,
    licence: "Apache-2.0",
    parameters: 57_264_032,
    released: || Config::EfficientVit(efficient_vit::Config::released()),
    tiny: || {
        Config::EfficientVit(efficient_vit::Config {
            width_list: [8, 16, 32, 32, 64],
            depth_list: [1, 1, 1, 1, 2],
            qkv_dim: 16,
            head_width: 32,
            head_depth: 2,
            ..efficient_vit::Config::released()
        })
    },
    adjustments: &[],
};

pub(in crate::networks) const TINY_VIT: Network = Network {
    name: "mobilesamv2-tiny-vit",
    title: "MobileSAM's image encoder (TinyViT)",
    source: README,
    files: &["mobile_sam.pt"],
    folder: None,
    beside: None,
    purpose: "segmentation: a fast and small encoder",
    upstream: UPSTREAM,
    licence: "Apache-2.0",
    parameters: 5_743_892,
    released: || Config::TinyVit(tiny_vit::Config::released()),
    tiny: || {
        Config::TinyVit(tiny_vit::Config {
            embed_dims: vec![16, 32, 40, 320],
            depths: vec![1, 1, 2, 1],
            num_heads: vec![2, 2, 5, 10],
            window_sizes: vec![7, 7, 14, 7],
            mlp_ratio: 1.0,
            ..tiny_vit::Config::released()
        })
    },
    adjustments: &[],
};

pub(in crate::networks) const VIT: Network = Network {
    name: "mobilesamv2-sam-vit-h",
    title: "SAM's image encoder (ViT-H)",
    source: Source::HuggingFace("facebook/sam-vit-huge"),
    files: &[
        "model.safetensors",
        "model.safetensors.index.json",
        "pytorch_model.bin",
    ],
    folder: None,
    beside: None,
    purpose: "segmentation: a large and slow encoder",
    upstream: "https://github.com/facebookresearch/segment-anything",
    licence: "Apache-2.0",
    parameters: 637_026_048,
    released: || Config::Vit(vit::Config::released()),
    tiny: || {
        Config::Vit(vit::Config {
            embed_dim: 32,
            depth: 2,
            num_heads: 2,
            global_attn_indexes: vec![1],
            ..vit::Config::released()
        })
    },
    adjustments: &[],
};

pub(super) const EFFICIENT_VIT_PART: Part = Part {
    network: EFFICIENT_VIT,
    marks: &[
        "backbone.stages.0.op_list.0.conv.weight",
        "neck.output_ops.0.op_list.0.conv.weight",
    ],
    layouts: &[as_it_is, in_sam],
    is_idle: is_counter,
    configure: |found, _| {
        note_rest(found);
        efficient_vit::Config::from_shapes(&found.shapes())
            .map(Config::EfficientVit)
            .map_err(|e| e.to_string())
    },
};

pub(super) const TINY_VIT_PART: Part = Part {
    network: TINY_VIT,
    marks: &["patch_embed.seq.0.c.weight", "neck.0.weight"],
    layouts: &[as_it_is, in_sam],
    // It was made from a classifier.
    is_idle: |name| {
        is_counter(name)
            || name.ends_with(".attention_bias_idxs")
            || ["norm_head.", "head."]
                .iter()
                .any(|part| name.starts_with(part))
    },
    configure: |found, _| {
        note_rest(found);
        tiny_vit::Config::from_shapes(&found.shapes())
            .map(Config::TinyVit)
            .map_err(|e| e.to_string())
    },
};

pub(super) const VIT_PART: Part = Part {
    network: VIT,
    marks: &["pos_embed", "patch_embed.proj.weight", "neck.0.weight"],
    layouts: &[as_it_is, in_sam, in_transformers],
    is_idle: |_| false,
    configure: |found, _| {
        note_rest(found);
        vit::Config::from_shapes(&found.shapes())
            .map(Config::Vit)
            .map_err(|e| e.to_string())
    },
};

/// The names in a whole SAM; in that of EfficientViT-SAM's training there may be more in front.
fn in_sam(name: &str) -> Option<String> {
    const PART: &str = "image_encoder.";
    let start = name.find(PART)? + PART.len();
    Some(name[start..].to_owned())
}

/// The names in the SAM of the library `transformers`.
fn in_transformers(name: &str) -> Option<String> {
    let name = name.strip_prefix("vision_encoder.")?;
    let renamed = match name.split('.').collect::<Vec<_>>()[..] {
        ["patch_embed", "projection", leaf] => format!("patch_embed.proj.{leaf}"),
        ["neck", layer, leaf] => {
            let index = match layer {
                "conv1" => 0,
                "layer_norm1" => 1,
                "conv2" => 2,
                "layer_norm2" => 3,
                _ => return Some(name.to_owned()),
            };
            format!("neck.{index}.{leaf}")
        }
        ["layers", block, "layer_norm1", leaf] => format!("blocks.{block}.norm1.{leaf}"),
        ["layers", block, "layer_norm2", leaf] => format!("blocks.{block}.norm2.{leaf}"),
        ["layers", block, ref rest @ ..] => format!("blocks.{block}.{}", rest.join(".")),
        _ => name.to_owned(),
    };
    Some(renamed)
}

/// Says what becomes of the rest of a whole SAM.
fn note_rest(found: &mut Found<'_>) {
    let others = found.checkpoint.shapes().len() - found.tensors.len();
    if others > 0 {
        found.notes.push(format!(
            "{others} tensors beside the image encoder are left out: MobileSAMv2 has a decoder of its \
             own, mobilesamv2-decoder"
        ));
    }
}
