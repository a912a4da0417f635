//! LPIPS, whose weights are published in two files: the classifier by torchvision, the heads by `lpips`.

use std::collections::BTreeMap;

use tid3r_models::lpips::{Config, Net};

use super::plan::{Hints, Plan, differences, unfit};
use super::{Beside, Network, Source};
use crate::error::excerpt;
use crate::synth::Adjustment;
use crate::{Checkpoint, Error, Result};

const UPSTREAM: &str = "https://github.com/richzhang/PerceptualSimilarity";
const LICENCE: &str = "BSD-3-Clause (torchvision), BSD-2-Clause (lpips)";
/// A tensor of the heads.
const HEAD: &str = "lin0.model.1.weight";

/// ReLUs let less and less through from layer to layer; and heads are never negative.
const ADJUSTMENTS: &[Adjustment] = &[
    Adjustment::Times(".weight", 1.5),
    Adjustment::Magnitude(".model.1.weight"),
];

pub(super) const ALEX: Network = Network {
    name: "lpips-alex",
    title: "LPIPS 0.1 on AlexNet",
    source: Source::Page("https://download.pytorch.org/models/alexnet-owt-7be5be79.pth"),
    files: &["alexnet-owt-7be5be79.pth"],
    folder: None,
    beside: Some(Beside {
        file: "alex.pth",
        source: "https://github.com/richzhang/PerceptualSimilarity/tree/master/lpips/weights/v0.1",
    }),
    purpose: "evaluation: how different pictures look",
    upstream: UPSTREAM,
    licence: LICENCE,
    parameters: 2_470_848,
    released: || super::Config::Lpips(Config::released(Net::Alex)),
    tiny: || {
        super::Config::Lpips(Config {
            net: Net::Alex,
            channels: vec![8, 12, 16, 12, 8],
        })
    },
    adjustments: ADJUSTMENTS,
};

pub(super) const VGG: Network = Network {
    name: "lpips-vgg",
    title: "LPIPS 0.1 on VGG16",
    source: Source::Page("https://download.pytorch.org/models/vgg16-397923af.pth"),
    files: &["vgg16-397923af.pth"],
    beside: Some(Beside {
        file: "vgg.pth",
        source: "https://github.com/richzhang/PerceptualSimilarity/tree/master/lpips/weights/v0.1",
    }),
    parameters: 14_716_160,
    released: || super::Config::Lpips(Config::released(Net::Vgg)),
    tiny: || {
        super::Config::Lpips(Config {
            net: Net::Vgg,
            channels: vec![4, 4, 6, 6, 8, 8, 8, 10, 10, 10, 12, 12, 12],
        })
    },
    ..ALEX
};

/// What becomes of a checkpoint of LPIPS; `None` if it is of something else.
pub(super) fn plan(checkpoint: &Checkpoint, hints: &Hints<'_>) -> Result<Option<Plan>> {
    let mut tensors: BTreeMap<String, (Vec<usize>, String)> = BTreeMap::new();
    for (original, shape) in checkpoint.shapes() {
        if let Some(name) = name_here(original) {
            tensors.insert(name, (shape.to_vec(), original.to_owned()));
        }
    }
    let [has_classifier, has_heads] =
        ["features.0.weight", HEAD].map(|name| tensors.contains_key(name));
    match (has_classifier, has_heads) {
        (true, _) => {}
        (false, true) => return Err(alone(checkpoint, "heads")),
        (false, false) => return Ok(None),
    }
    let shapes: BTreeMap<_, _> = (tensors.iter())
        .map(|(name, (shape, _))| (name.clone(), shape.clone()))
        .collect();
    let config = match hints.config {
        Some(super::Config::Lpips(config)) => config.clone(),
        _ => match Config::from_shapes(&shapes) {
            Ok(config) => config,
            Err(_) => return Ok(None),
        },
    };
    if !has_heads {
        return Err(alone(checkpoint, "classifier"));
    }
    let config = super::Config::Lpips(config);
    let refuse = |problem: String| unfit(checkpoint.path(), config.network(), &problem);
    let wanted = config.tensors().map_err(refuse)?;
    let found = tensors
        .iter()
        .map(|(name, (shape, _))| (name.as_str(), shape.as_slice()));
    let problems = differences(&wanted, &found.collect());
    if !problems.is_empty() {
        return Err(refuse(problems.join("; ")));
    }
    Ok(Some(Plan {
        config,
        tensors,
        notes: Vec::new(),
    }))
}

/// What a tensor of the network is called here, torchvision's names of the classifier being kept; `None` for
/// what has no effect: the classifier's last layers, constants of the scaling layer, and the heads' second
/// names in a whole LPIPS.
fn name_here(name: &str) -> Option<String> {
    if let Some(rest) = name.strip_prefix("net.slice") {
        // In a whole LPIPS, slices number the layers as torchvision does.
        let (_, layer) = rest.split_once('.')?;
        return Some(format!("features.{layer}"));
    }
    let is_head = name.starts_with("lin") && !name.starts_with("lins.");
    (is_head || name.starts_with("features.")).then(|| name.to_owned())
}

/// Half of the network.
fn alone(checkpoint: &Checkpoint, what: &str) -> Error {
    let remedy = match what {
        "heads" => {
            "give the classifier's checkpoint first: weights convert alexnet-owt-7be5be79.pth \
                    --with alex.pth, or weights convert vgg16-397923af.pth --with vgg.pth"
        }
        _ => "give the heads of LPIPS, too: --with alex.pth for AlexNet, --with vgg.pth for VGG16",
    };
    let names = checkpoint.shapes();
    let first = names.keys().next().copied().unwrap_or_default();
    Error::file(
        checkpoint.path(),
        format!("the {what} of LPIPS alone (`{}`, ..)", excerpt(first)),
        remedy,
    )
}
