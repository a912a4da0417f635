//! MobileSAMv2: its networks and what is around them.

mod decoder;
mod picture;
mod tiny_vit;
mod vit;

use crate::Runner;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "prompt_encoder" => decoder::prompts,
        "two_way_transformer" => decoder::transformer,
        "mask_decoder" => decoder::masks,
        "prompt_guided_mask_decoder" => decoder::file,
        "tiny_vit_blocks" => tiny_vit::blocks,
        "tiny_vit" => tiny_vit::network,
        "sam_vit" | "sam_vit_h" => vit::network,
        _ => return None,
    })
}
