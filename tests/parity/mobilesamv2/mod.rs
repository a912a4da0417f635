//! MobileSAMv2: its networks and what is around them.

mod decoder;
mod detector;
mod efficient_vit;
mod picture;
mod pipeline;
mod tiny_vit;
mod vit;

use crate::Runner;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "box_postprocess" => pipeline::box_postprocess,
        "efficientvit_blocks" => efficient_vit::blocks,
        "efficientvit_sam" | "efficientvit_l2" => efficient_vit::network,
        "letterbox" => pipeline::letterbox,
        "mask_decoder" => decoder::masks,
        "mask_postprocess" => pipeline::mask_postprocess,
        "nms" => pipeline::nms,
        "object_aware_model" => pipeline::object_aware_model,
        "object_aware_yolov8" => detector::network,
        "pe3r_mask_selection" => pipeline::pe3r_masks,
        "pe3r_masks_from_image" => pipeline::pe3r_masks_from_image,
        "prompt_encoder" => decoder::prompts,
        "prompt_guided_mask_decoder" => decoder::file,
        "sam_preprocess" => pipeline::sam_preprocess,
        "sam_vit" | "sam_vit_h" => vit::network,
        "segment_everything" => pipeline::segment_everything,
        "tiny_vit" => tiny_vit::network,
        "tiny_vit_blocks" => tiny_vit::blocks,
        "two_way_transformer" => decoder::transformer,
        "yolo_blocks" => detector::blocks,
        _ => return None,
    })
}
