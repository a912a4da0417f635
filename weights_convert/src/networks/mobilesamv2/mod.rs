//! The networks of MobileSAMv2: a detector, three image encoders to choose from, and a decoder.
//!
//! Each is published in files of several layouts, and some files hold a whole SAM of which one network
//! is a part. All that a configuration says is in the shapes of the tensors, but for the heads of the
//! decoder's attention.

mod decoder;
mod detector;
mod encoders;

use std::collections::BTreeMap;

use super::plan::{Hints, Plan, differences, unfit};
use super::{Config, Network, Source};
use crate::error::excerpt;
use crate::{Checkpoint, Result};

pub(super) use decoder::DECODER;
pub(super) use detector::DETECTOR;
pub(super) use encoders::{EFFICIENT_VIT, TINY_VIT, VIT};

/// Where the code of MobileSAMv2 is published.
const UPSTREAM: &str = "https://github.com/ChaoningZhang/MobileSAM";
/// The address of the weights is in it.
const README: Source =
    Source::Page("https://github.com/ChaoningZhang/MobileSAM#getting-started-mobilesamv2");

/// How a network is found in checkpoints.
struct Part {
    network: Network,
    /// Tensors by whose names it is known.
    marks: &'static [&'static str],
    /// The ways in which checkpoints name its tensors.
    layouts: &'static [Layout],
    /// Whether a tensor is in checkpoints without having an effect.
    is_idle: fn(&str) -> bool,
    /// Finds out the configuration.
    configure: fn(&mut Found<'_>, &Hints<'_>) -> Result<Config, String>,
}

/// What a tensor of the network is called here, by its name in the checkpoint; `None` if it is of
/// something else.
type Layout = fn(&str) -> Option<String>;

/// The encoders come first: a whole SAM has a decoder, too, but not that of MobileSAMv2.
static PARTS: [Part; 5] = [
    detector::PART,
    encoders::EFFICIENT_VIT_PART,
    encoders::TINY_VIT_PART,
    encoders::VIT_PART,
    decoder::PART,
];

/// The tensors of a checkpoint that are of a network.
struct Found<'a> {
    checkpoint: &'a Checkpoint,
    /// By the names that they have here: shape, and name in the checkpoint.
    tensors: BTreeMap<String, (Vec<usize>, &'a str)>,
    /// What a person should know about the result.
    notes: Vec<String>,
}

impl<'a> Found<'a> {
    /// The tensors in a layout; or what is wrong with them.
    fn in_layout(checkpoint: &'a Checkpoint, layout: Layout) -> Result<Self, String> {
        let mut found = Self {
            checkpoint,
            tensors: BTreeMap::new(),
            notes: Vec::new(),
        };
        for (original, shape) in checkpoint.shapes() {
            let Some(name) = layout(original) else {
                continue;
            };
            let tensor = (shape.to_vec(), original);
            if let Some((_, other)) = found.tensors.insert(name, tensor) {
                let (original, other) = (excerpt(original), excerpt(other));
                return Err(format!("`{original}` and `{other}` are the same tensor"));
            }
        }
        Ok(found)
    }

    fn shapes(&self) -> BTreeMap<String, Vec<usize>> {
        let shape = |(name, (shape, _)): (&String, &(Vec<usize>, _))| (name.clone(), shape.clone());
        self.tensors.iter().map(shape).collect()
    }
}

/// What becomes of a checkpoint of one of these networks; `None` if it is of something else.
pub(super) fn plan(checkpoint: &Checkpoint, hints: &Hints<'_>) -> Result<Option<Plan>> {
    let shapes = checkpoint.shapes();
    for part in &PARTS {
        let layout = part.layouts.iter().find(|layout| {
            let named: Vec<_> = shapes.keys().filter_map(|name| layout(name)).collect();
            (part.marks.iter()).all(|mark| named.iter().any(|name| name == mark))
        });
        if let Some(layout) = layout {
            let plan = part.plan(checkpoint, *layout, hints);
            let refuse = |problem: String| unfit(checkpoint.path(), &part.network, &problem);
            return plan.map(Some).map_err(refuse);
        }
    }
    Ok(None)
}

impl Part {
    fn plan(
        &self,
        checkpoint: &Checkpoint,
        layout: Layout,
        hints: &Hints<'_>,
    ) -> Result<Plan, String> {
        let mut found = Found::in_layout(checkpoint, layout)?;
        let config = match hints.config {
            Some(config) if *config.network() == self.network => config.clone(),
            _ => (self.configure)(&mut found, hints)?,
        };
        let wanted = config.tensors()?;
        // Only what is wanted can be wrong: other parts of a SAM are no concern.
        found
            .tensors
            .retain(|name, _| wanted.contains_key(name) || !(self.is_idle)(name));
        let shapes = found.tensors.iter();
        let shapes = shapes.map(|(name, (shape, _))| (name.as_str(), shape.as_slice()));
        let problems = differences(&wanted, &shapes.collect());
        if !problems.is_empty() {
            return Err(problems.join("; "));
        }
        let source = |(name, (shape, original)): (String, (Vec<usize>, &str))| {
            (name, (shape, original.to_owned()))
        };
        Ok(Plan {
            config,
            tensors: found.tensors.into_iter().map(source).collect(),
            notes: found.notes,
        })
    }
}

/// The names in the checkpoint are those that are used here.
fn as_it_is(name: &str) -> Option<String> {
    Some(name.to_owned())
}

/// Whether a tensor counts the batches that a norm was trained on.
fn is_counter(name: &str) -> bool {
    name.ends_with(".num_batches_tracked")
}
