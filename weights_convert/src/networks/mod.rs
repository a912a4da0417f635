//! The networks whose weights tid3r knows: where they come from, what tensors they have, and how
//! their published checkpoints are read.
//!
//! A new network is an entry of [`Network::all`], a variant of [`Config`] and a module that finds
//! out from a checkpoint what configuration it is of.

mod constructor;
mod mvdust3r;

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use tid3r_models::mvdust3r as network;

use crate::error::excerpt;
use crate::{Checkpoint, Error, Result};

/// A network that tid3r can run.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct Network {
    /// What it is called on the command line and as a folder.
    pub name: &'static str,
    /// What its authors call it.
    pub title: &'static str,
    /// The model repository on Hugging Face in which its weights are published.
    pub repository: &'static str,
    /// Checkpoint files in that repository; the first is the one to take.
    pub files: &'static [&'static str],
    /// Where its code is published.
    pub upstream: &'static str,
    /// The licence of its weights.
    pub licence: &'static str,
    /// How many numbers it has learned.
    pub parameters: u64,
}

const MV_DUST3R: Network = Network {
    name: "mvdust3r",
    title: "MV-DUSt3R",
    repository: "Zhenggang/MV-DUSt3R",
    files: &["checkpoints/MVD.pth"],
    upstream: "https://github.com/facebookresearch/mvdust3r",
    licence: "CC BY-NC 4.0, non-commercial use only",
    parameters: 547_989_522,
};

/// Stage 1 was trained on 8 views; stage 2 is stage 1 finetuned on 4 to 12.
const MV_DUST3R_PLUS: Network = Network {
    name: "mvdust3r-plus",
    title: "MV-DUSt3R+",
    files: &["checkpoints/MVDp_s2.pth", "checkpoints/MVDp_s1.pth"],
    parameters: 661_429_266,
    ..MV_DUST3R
};

static NETWORKS: [Network; 2] = [MV_DUST3R, MV_DUST3R_PLUS];

impl Network {
    /// Every network, in the order in which they are listed.
    pub fn all() -> &'static [Self] {
        &NETWORKS
    }

    /// The network called `name`.
    ///
    /// # Errors
    ///
    /// If there is none; the message lists those that there are.
    pub fn named(name: &str) -> Result<&'static Self> {
        let found = Self::all().iter().find(|network| network.name == name);
        found.ok_or_else(|| {
            let names: Vec<_> = Self::all().iter().map(|network| network.name).collect();
            Error::request(
                format!("there is no network called `{name}`"),
                format!("the networks are {}", names.join(", ")),
            )
        })
    }

    /// Size of its weights as f32, in bytes.
    pub fn bytes(&self) -> u64 {
        4 * self.parameters
    }

    /// The configuration of the published weights.
    pub fn released(&self) -> Config {
        Config::MvDust3r(match self.name {
            "mvdust3r" => network::Config::mv_dust3r(),
            _ => network::Config::mv_dust3r_plus(),
        })
    }

    /// A configuration with all parts of the published one, but so small that it runs in a moment:
    /// for tests of what is around the network.
    pub fn tiny(&self) -> Config {
        let Config::MvDust3r(released) = self.released();
        Config::MvDust3r(mvdust3r::tiny(&released))
    }
}

/// The configuration of a network; in JSON, with the architecture under `model`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model")]
#[non_exhaustive]
pub enum Config {
    /// MV-DUSt3R or MV-DUSt3R+.
    #[serde(rename = "mvdust3r")]
    MvDust3r(network::Config),
}

impl Config {
    /// Names and shapes of the tensors of the network: exactly those that it uses.
    ///
    /// A published checkpoint has some more, without effect: counters of batches, a token for
    /// masked training. They are left out of converted files.
    ///
    /// # Errors
    ///
    /// If no network has this configuration.
    pub fn tensors(&self) -> Result<BTreeMap<String, Vec<usize>>, String> {
        match self {
            Self::MvDust3r(config) => mvdust3r::tensors(config),
        }
    }

    /// Which network it is of.
    pub fn network(&self) -> &'static Network {
        match self {
            Self::MvDust3r(config) if config.m_ref_flag => &NETWORKS[1],
            Self::MvDust3r(_) => &NETWORKS[0],
        }
    }
}

/// What is known about a checkpoint from elsewhere.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Hints<'a> {
    /// Attention heads of the encoder and of the decoder, which the shapes of tensors do not tell.
    pub(crate) heads: Option<(usize, usize)>,
    /// The configuration, if another file says it.
    pub(crate) config: Option<&'a Config>,
}

/// How a checkpoint becomes the weights of a network.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) config: Config,
    /// For each tensor of the network, its shape and its name in the checkpoint.
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
        format!(
            "get {} from https://huggingface.co/{}",
            network.files[0], network.repository
        ),
    )
}
