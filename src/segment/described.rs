use super::{
    GraphParams, GraphSegmenter, Segmenter,
    mobilesamv2::{MobileSam, MobileSamParams, MobileSamWeights},
};
use crate::{
    Result,
    scene::{Role, Scene},
};
use serde_json::{Value, json};

/// A segmenter with what masks that it makes are taken for the same by.
pub struct DescribedSegmenter {
    /// Cuts frames into masks.
    pub segmenter: Box<dyn Segmenter>,
    /// See [`Segmentation::description`](super::Segmentation::description).
    pub description: Value,
}

impl DescribedSegmenter {
    /// The graph-based segmentation, which needs no network.
    pub fn graph(params: GraphParams) -> Self {
        Self {
            description: json!({ "graph": params }),
            segmenter: Box::new(GraphSegmenter(params)),
        }
    }

    /// MobileSAMv2, which looks at the original photos of a scene.
    ///
    /// # Errors
    /// When weights are damaged.
    pub fn mobilesamv2(
        weights: &MobileSamWeights,
        params: MobileSamParams,
        scene: &Scene,
    ) -> Result<Self> {
        let sam = MobileSam::new(weights, params)?;
        let photos = scene.records(Role::Input).iter();
        let photos = photos.map(|record| &record.photo);
        Ok(Self {
            description: json!({
                "mobilesamv2": sam.description(),
                "photos": MobileSam::content_hash(photos),
            }),
            segmenter: Box::new(sam),
        })
    }
}
