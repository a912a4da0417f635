//! The networks, as they are listed.

use tid3r_models::see3d::{
    clip::{TextConfig, VisionConfig},
    schedule, unet, vae,
};

use super::config::{ImageEncoderConfig, Preprocessor, TextEncoderConfig, UnetConfig, Variant};
use crate::networks::{Config, Network, Source};

/// The folder of the repository in which all networks are.
pub(super) const FOLDER: &str = "checkpoint/MVD_weights";

const UPSTREAM: &str = "https://github.com/baaivision/See3D";

pub(in crate::networks) const SPARSE: Network = Network {
    name: "see3d-sparse",
    title: "See3D's multi-view UNet for several photos",
    source: Source::HuggingFace("bruiiii/See3D"),
    files: &[
        "checkpoint/MVD_weights/unet/sparse/ema-checkpoint/diffusion_pytorch_model.safetensors",
        "checkpoint/MVD_weights/unet/sparse/ema-checkpoint/diffusion_pytorch_model.bin",
    ],
    folder: Some(FOLDER),
    beside: None,
    purpose: "renders guided by several photos",
    upstream: UPSTREAM,
    licence: "none stated by the authors; trained from Stable Diffusion 2.1, which is CreativeML Open \
              RAIL++-M",
    parameters: 865_925_124,
    released: || unet(Variant::Sparse, unet::Config::released()),
    tiny: || unet(Variant::Sparse, tiny_unet()),
    adjustments: &[],
};

pub(in crate::networks) const SINGLE: Network = Network {
    name: "see3d-single",
    title: "See3D's multi-view UNet for one photo",
    files: &[
        "checkpoint/MVD_weights/unet/single/ema-checkpoint/diffusion_pytorch_model.safetensors",
        "checkpoint/MVD_weights/unet/single/ema-checkpoint/diffusion_pytorch_model.bin",
    ],
    purpose: "renders guided by one photo",
    released: || unet(Variant::Single, unet::Config::released()),
    tiny: || unet(Variant::Single, tiny_unet()),
    ..SPARSE
};

pub(in crate::networks) const SUPER_RESOLUTION: Network = Network {
    name: "see3d-super-resolution",
    title: "See3D's multi-view UNet from 512 pixels to 1024",
    files: &[
        "checkpoint/MVD_weights/unet/SR/ema-checkpoint/diffusion_pytorch_model.safetensors",
        "checkpoint/MVD_weights/unet/SR/ema-checkpoint/diffusion_pytorch_model.bin",
    ],
    purpose: "super-resolution",
    released: || unet(Variant::SuperResolution, unet::Config::released()),
    tiny: || unet(Variant::SuperResolution, tiny_unet()),
    ..SPARSE
};

pub(in crate::networks) const VAE: Network = Network {
    name: "see3d-vae",
    title: "See3D's VAE (Stable Diffusion's)",
    files: &[
        "checkpoint/MVD_weights/vae/diffusion_pytorch_model.safetensors",
        "checkpoint/MVD_weights/vae/diffusion_pytorch_model.bin",
    ],
    purpose: "every render with See3D",
    licence: "CreativeML Open RAIL++-M (Stable Diffusion 2.1)",
    parameters: 83_653_863,
    released: || Config::Vae(vae::Config::released()),
    // Widths that differ, so that all kinds of residual blocks are in it.
    tiny: || {
        Config::Vae(vae::Config {
            block_out_channels: vec![32, 64, 64, 64],
            layers_per_block: 1,
            ..vae::Config::released()
        })
    },
    ..SPARSE
};

pub(in crate::networks) const IMAGE_ENCODER: Network = Network {
    name: "see3d-image-encoder",
    title: "See3D's image encoder (CLIP ViT-H/14)",
    files: &[
        "checkpoint/MVD_weights/CLIP-ViT-H-14-laion2B-s32B-b79K/model.safetensors",
        "checkpoint/MVD_weights/CLIP-ViT-H-14-laion2B-s32B-b79K/pytorch_model.bin",
    ],
    purpose: "every render with See3D",
    licence: "MIT (laion/CLIP-ViT-H-14-laion2B-s32B-b79K)",
    parameters: 632_076_800,
    released: || image_encoder(VisionConfig::released()),
    tiny: || {
        image_encoder(VisionConfig {
            hidden_size: 64,
            intermediate_size: 256,
            projection_dim: TINY_WIDTH,
            num_hidden_layers: 2,
            num_attention_heads: 4,
            image_size: 56,
            ..VisionConfig::released()
        })
    },
    ..SPARSE
};

pub(in crate::networks) const TEXT_ENCODER: Network = Network {
    name: "see3d-text-encoder",
    title: "See3D's text encoder (Stable Diffusion 2.1's)",
    files: &[
        "checkpoint/MVD_weights/text_encoder/model.safetensors",
        "checkpoint/MVD_weights/text_encoder/pytorch_model.bin",
    ],
    purpose: "every render with See3D",
    licence: "CreativeML Open RAIL++-M (Stable Diffusion 2.1)",
    parameters: 340_387_840,
    released: || text_encoder(TextConfig::released()),
    tiny: || {
        text_encoder(TextConfig {
            vocab_size: 64,
            hidden_size: TINY_WIDTH,
            intermediate_size: 256,
            num_hidden_layers: 2,
            num_attention_heads: 4,
            ..TextConfig::released()
        })
    },
    ..SPARSE
};

/// Channels of what the tiny encoders say: they must be those that the tiny UNets listen to.
const TINY_WIDTH: usize = 64;

fn unet(variant: Variant, unet: unet::Config) -> Config {
    Config::Unet(UnetConfig {
        variant,
        unet,
        scheduler: schedule::Config::released(),
    })
}

/// The narrowest UNet that has blocks of every kind: with and without attention, with and without
/// another width.
fn tiny_unet() -> unet::Config {
    unet::Config {
        model_channels: 32,
        channel_mult: vec![1, 1, 2, 2],
        num_res_blocks: unet::Repeats::Same(1),
        num_head_channels: 16,
        context_dim: TINY_WIDTH,
        ..unet::Config::released()
    }
}

fn image_encoder(vision: VisionConfig) -> Config {
    Config::ImageEncoder(ImageEncoderConfig {
        preprocessor: Preprocessor::of_side(vision.image_size),
        vision,
    })
}

fn text_encoder(text: TextConfig) -> Config {
    Config::TextEncoder(TextEncoderConfig {
        empty_prompt: TextEncoderConfig::usual_empty_prompt(&text),
        text,
    })
}
