//! MobileSAMv2: its networks and what is around them.

mod decoder;
mod picture;

use crate::Runner;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "prompt_encoder" => decoder::prompts,
        "two_way_transformer" => decoder::transformer,
        "mask_decoder" => decoder::masks,
        "prompt_guided_mask_decoder" => decoder::file,
        _ => return None,
    })
}
