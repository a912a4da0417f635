use super::BoxSelection;
use crate::parameters;
use serde::{Deserialize, Serialize};
use tid3r_models::ComputeType;

/// How MobileSAMv2 cuts a picture into objects.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
pub struct MobileSamParams {
    /// Objects that the detector is less sure of than this are dropped
    #[arg(long, value_name = "SHARE", default_value_t = 0.4, value_parser = parameters::share)]
    pub confidence: f64,
    /// Of boxes that overlap more than this (intersection over union), only the surest stays
    #[arg(long, value_name = "SHARE", default_value_t = 0.9, value_parser = parameters::share)]
    pub nms_iou: f64,
    /// Long side of the picture that the detector sees, rounded up to a multiple of 32; smaller is
    /// faster and misses small objects
    #[arg(long, value_name = "PX", default_value_t = 1024,
          value_parser = clap::value_parser!(u32).range(64..=4096))]
    pub detector_size: u32,
    /// The surest so many objects of a photo get a mask
    #[arg(long, value_name = "N", default_value_t = 300,
          value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub max_masks: u32,
    /// Masks that the network itself expects to overlap less than this with the true object
    /// (intersection over union) are dropped [default: none]
    #[arg(long, value_name = "SHARE", value_parser = parameters::share)]
    pub min_predicted_iou: Option<f64>,
    /// What the networks compute with.
    #[arg(skip)]
    #[serde(default, skip_serializing_if = "ComputeType::is_default")]
    pub dtype: ComputeType,
}

impl Default for MobileSamParams {
    fn default() -> Self {
        Self {
            confidence: 0.4,
            nms_iou: 0.9,
            detector_size: 1024,
            max_masks: 300,
            min_predicted_iou: None,
            dtype: ComputeType::default(),
        }
    }
}

impl MobileSamParams {
    /// Which boxes are kept.
    pub(super) fn boxes(&self) -> BoxSelection {
        BoxSelection {
            confidence: self.confidence as f32,
            iou: self.nms_iou,
            most: self.max_masks as usize,
        }
    }
}

/// The image encoder that SAM's decoder reads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EncoderChoice {
    /// EfficientViT-SAM L2: the best of the fast ones
    #[default]
    EfficientvitL2,
    /// MobileSAM's TinyViT: the smallest
    TinyVit,
    /// SAM's ViT-H: the best, some 40 times slower than the others
    SamVitH,
}

impl EncoderChoice {
    /// All, in the order in which they are taken if there is a choice.
    pub const ALL: [Self; 3] = [Self::EfficientvitL2, Self::TinyVit, Self::SamVitH];

    /// The name of its network among those whose weights tid3r knows.
    pub fn network(self) -> &'static str {
        match self {
            Self::EfficientvitL2 => "mobilesamv2-efficientvit-l2",
            Self::TinyVit => "mobilesamv2-tiny-vit",
            Self::SamVitH => "mobilesamv2-sam-vit-h",
        }
    }
}
