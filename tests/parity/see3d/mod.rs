//! See3D: its networks and what is around them.

mod clip;
mod vae;

use crate::Runner;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "AutoencoderKL" => vae::network,
        "CLIPTextModel" => clip::text,
        "CLIPTokenizer" => clip::tokenizer,
        "CLIPVisionModelWithProjection" => clip::vision,
        _ => return None,
    })
}
