//! MobileSAMv2: its networks and what is around them.

mod picture;
mod pipeline;

use crate::Runner;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "letterbox" => pipeline::letterbox,
        "nms" => pipeline::nms,
        "box_postprocess" => pipeline::box_postprocess,
        "sam_preprocess" => pipeline::sam_preprocess,
        "mask_postprocess" => pipeline::mask_postprocess,
        "pe3r_mask_selection" => pipeline::pe3r_masks,
        _ => return None,
    })
}
