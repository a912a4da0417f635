//! MobileSAMv2: its networks and what is around them.

mod picture;
mod tiny_vit;
mod vit;

use crate::Runner;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "tiny_vit_blocks" => tiny_vit::blocks,
        "tiny_vit" => tiny_vit::network,
        "sam_vit" | "sam_vit_h" => vit::network,
        _ => return None,
    })
}
