//! The object-aware detector.

use tid3r_models::mobilesamv2::detector::Config;

use super::{Found, Network, Part, README, UPSTREAM, as_it_is, is_counter};
use crate::networks::Hints;
use crate::synth::Adjustment;

pub(in crate::networks) const DETECTOR: Network = Network {
    name: "mobilesamv2-detector",
    title: "MobileSAMv2's object-aware detector (YOLOv8)",
    source: README,
    files: &["ObjectAwareModel.pt"],
    folder: None,
    beside: None,
    purpose: "segmentation: boxes around whatever is a thing",
    upstream: UPSTREAM,
    licence: "Apache-2.0 by the repository that publishes it; \
              it was trained with Ultralytics YOLOv8, which is AGPL-3.0",
    parameters: 68_635_909,
    released: || super::Config::Detector(Config::released()),
    // The narrowest that has all parts: one bottleneck where there are several.
    tiny: || super::Config::Detector(Config::scaled((0.33, 0.125, 1024), 1, 26, 32)),
    // SiLU lets less and less through from layer to layer, but much more would make numbers explode.
    // The biases are such that the tiny network of the default seed finds some 60 boxes in a photo at
    // confidence 0.4, all on its finest level; larger networks find as many as are kept.
    adjustments: &[
        Adjustment::Times(".bn.weight", 1.5),
        Adjustment::Times("cv2.0.2.weight", 32.0),
        Adjustment::Times("cv2.1.2.weight", 32.0),
        Adjustment::Times("cv2.2.2.weight", 32.0),
        Adjustment::Times("cv3.0.2.weight", 32.0),
        Adjustment::Times("cv3.1.2.weight", 32.0),
        Adjustment::Times("cv3.2.2.weight", 32.0),
        Adjustment::Constant("cv3.0.2.bias", 0.15),
        Adjustment::Constant("cv3.1.2.bias", -9.0),
        Adjustment::Constant("cv3.2.2.bias", -12.0),
        // Not learned: the distances that the bins stand for.
        Adjustment::Counting("dfl.conv.weight"),
    ],
};

pub(super) const PART: Part = Part {
    network: DETECTOR,
    marks: &["model.0.conv.weight", "model.22.dfl.conv.weight"],
    layouts: &[as_it_is],
    is_idle,
    configure,
};

/// Mask coefficients and their prototypes are never used: SAM's decoder makes the masks.
fn is_idle(name: &str) -> bool {
    is_counter(name)
        || ["model.22.cv4.", "model.22.proto."]
            .iter()
            .any(|part| name.starts_with(part))
}

/// The shapes tell everything, but the original takes only as many of the head's classes for classes
/// as the network names.
fn configure(found: &mut Found<'_>, _: &Hints<'_>) -> Result<super::Config, String> {
    let mut config = Config::from_shapes(&found.shapes()).map_err(|e| e.to_string())?;
    if let Some(named) = found
        .checkpoint
        .classes()
        .filter(|&named| named != config.nc)
    {
        let head = config.nc;
        if named == 0 || named > head {
            found.notes.push(format!(
                "it names {named} classes where its head has {head}: the head's are taken"
            ));
        } else {
            found.notes.push(format!(
                "it names {named} classes where its head has {head}: the first {named} are taken"
            ));
            config.nc = named;
            for (name, (shape, _)) in &mut found.tensors {
                let is_last = name.starts_with("model.22.cv3.")
                    && [".2.weight", ".2.bias"]
                        .iter()
                        .any(|end| name.ends_with(end));
                if let Some(classes) = shape.first_mut().filter(|n| is_last && **n == head) {
                    *classes = named;
                }
            }
        }
    }
    Ok(super::Config::Detector(config))
}
