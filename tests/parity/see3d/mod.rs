//! See3D: its networks and what is around them.

mod clip;
mod pipeline;
mod schedule;
mod unet;
mod vae;

use crate::Runner;
use anyhow::Result;
use candle_core::Tensor;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "AutoencoderKL" => vae::network,
        "BasicTransformerBlock3D" => unet::transformer_block,
        "CLIPTextModel" => clip::text,
        "CLIPTokenizer" => clip::tokenizer,
        "CLIPVisionModelWithProjection" => clip::vision,
        "Downsample+Upsample" => unet::resample,
        "FeedForward" => unet::feed_forward,
        "MVDreamPipeline" => pipeline::whole,
        "MultiViewUNetModel" => unet::network,
        "ResBlock" => unet::residual_block,
        "SpatialTransformer3D" => unet::spatial_transformer,
        "clip_preprocess" => pipeline::clip_preprocessing,
        "ddim_alphas" => schedule::alphas,
        "ddim_step" => schedule::step,
        "ddim_timesteps" => schedule::timesteps,
        "ddim_trajectory" => schedule::trajectory,
        "frame_grouping" => pipeline::grouping,
        "guidance" => schedule::guidance,
        "pil2tensor" => pipeline::preprocessing,
        "pil_resize" => pipeline::resize,
        "timestep_embedding" => unet::timesteps,
        "warp_mix" => schedule::warp_mix,
        _ => return None,
    })
}

/// Recorded maps (batch, channels, height, width) with channels last.
pub(crate) fn channels_last(x: &Tensor) -> Result<Tensor> {
    Ok(x.permute((0, 2, 3, 1))?.contiguous()?)
}

/// Maps (batch, height, width, channels) as they are recorded.
pub(crate) fn channels_first(x: &Tensor) -> Result<Tensor> {
    Ok(x.permute((0, 3, 1, 2))?.contiguous()?)
}
