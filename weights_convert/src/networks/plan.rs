//! How a checkpoint becomes the weights of a network.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Config, Network, lpips, mobilesamv2, mvdust3r, see3d};
use crate::error::excerpt;
use crate::{Checkpoint, Error, Result};

/// What is known about a checkpoint from elsewhere.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Hints<'a> {
    /// Attention heads of the encoder and of the decoder, which the shapes of tensors do not tell.
    pub(crate) heads: Option<(usize, usize)>,
    /// The configuration, if another file says it.
    pub(crate) config: Option<&'a Config>,
    /// Which network it is of, where neither its tensors nor its folder say.
    pub(crate) network: Option<&'static Network>,
}

/// How a checkpoint becomes the weights of a network.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) config: Config,
    /// For each tensor of the network, its shape and its name in the checkpoint. There it may have
    /// more elements, of which the first are taken.
    pub(crate) tensors: BTreeMap<String, (Vec<usize>, String)>,
    /// What a person should know about the result.
    pub(crate) notes: Vec<String>,
}

impl Plan {
    /// Finds out which network a checkpoint is of, and whether it is complete.
    pub(crate) fn of(checkpoint: &Checkpoint, hints: Hints<'_>) -> Result<Self> {
        if mvdust3r::recognise(checkpoint) {
            return mvdust3r::plan(checkpoint, hints);
        }
        if let Some(plan) = mobilesamv2::plan(checkpoint, &hints)? {
            return Ok(plan);
        }
        if let Some(plan) = see3d::plan(checkpoint, &hints)? {
            return Ok(plan);
        }
        if let Some(plan) = lpips::plan(checkpoint, &hints)? {
            return Ok(plan);
        }
        let shapes = checkpoint.shapes();
        let some: Vec<_> = shapes
            .keys()
            .take(3)
            .map(|name| format!("`{}`", excerpt(name)))
            .collect();
        let known: Vec<_> = Network::all().iter().map(|network| network.title).collect();
        Err(Error::file(
            checkpoint.path(),
            format!(
                "its tensors ({}, ..) are of no network that is known",
                some.join(", ")
            ),
            format!("the networks are {}", known.join(", ")),
        ))
    }
}

/// How the shapes of `found` differ from those that are `wanted`; nothing if they are as they must be.
pub(crate) fn differences(
    wanted: &BTreeMap<String, Vec<usize>>,
    found: &BTreeMap<&str, &[usize]>,
) -> Vec<String> {
    let missing = wanted
        .keys()
        .filter(|name| !found.contains_key(name.as_str()));
    let unexpected = found.keys().filter(|name| !wanted.contains_key(**name));
    let misshapen = wanted.iter().filter_map(|(name, shape)| {
        let found = found.get(name.as_str()).filter(|found| **found != shape)?;
        Some(format!("`{name}` {found:?} instead of {shape:?}"))
    });
    let quoted = |name: &str| format!("`{}`", excerpt(name));
    [
        (
            "missing",
            missing.map(|name| quoted(name)).collect::<Vec<_>>(),
        ),
        ("unexpected", unexpected.map(|name| quoted(name)).collect()),
        ("of another shape", misshapen.collect()),
    ]
    .into_iter()
    .filter(|(_, tensors)| !tensors.is_empty())
    .map(|(what, tensors)| format!("{what}: {}", listed(&tensors)))
    .collect()
}

/// The first few of `things`, and how many more there are.
pub(crate) fn listed(things: &[String]) -> String {
    const MOST: usize = 6;
    let mut text = things[..things.len().min(MOST)].join(", ");
    if things.len() > MOST {
        text.push_str(&format!(" and {} more", things.len() - MOST));
    }
    text
}

/// An error about a checkpoint that is of a known network but not as it must be.
pub(crate) fn unfit(path: &Path, network: &Network, problem: &str) -> Error {
    Error::file(
        path,
        format!("not a checkpoint of {}: {problem}", network.title),
        format!("get {} from {}", network.files[0], network.source),
    )
}
