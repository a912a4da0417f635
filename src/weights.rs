//! Weights that were found, on their way to becoming networks.

use crate::{
    Error,
    error::network_problem,
    machine::{check_type, device},
};
use std::fmt::Display;
use tid3r_models::{ComputeType, Footprint, Weights};
use tid3r_weights_convert::{Config, Found};

/// Whether weights are merely not there, rather than damaged.
pub(crate) fn are_missing(error: &Error) -> bool {
    matches!(
        error,
        Error::Request { .. } | Error::Weights(tid3r_weights_convert::Error::Request { .. })
    )
}

/// The first error about weights that are damaged; else one that says all that are missing of the networks
/// of `whose`.
pub(crate) fn joined(whose: &str, mut errors: Vec<Error>) -> Error {
    if let Some(damaged) = errors.iter().position(|error| !are_missing(error)) {
        return errors.swap_remove(damaged);
    }
    if errors.len() == 1 {
        return errors.swap_remove(0);
    }
    // What was looked at and what to do would be as long for each.
    let brief = |error: &Error| {
        let text = error.to_string();
        text.split(": ").next().unwrap_or_default().to_string()
    };
    let all: Vec<String> = errors.iter().map(brief).collect();
    Error::request(
        format!(
            "{} of {whose} networks are missing: {}",
            all.len(),
            all.join(", ")
        ),
        "`tid3r weights list` says what to get from where; `tid3r weights convert` makes it usable",
    )
}

/// An error about weights that are there.
pub(crate) fn damaged(found: &Found, problem: &dyn Display) -> Error {
    Error::file(
        &found.folder,
        format!("the weights cannot be used: {problem}"),
        "make them again with `tid3r weights convert`",
    )
}

/// The weights themselves, mapped, for layers that compute with this type.
pub(crate) fn open(found: &Found, compute_type: ComputeType) -> Result<Weights, Error> {
    check_type(compute_type)?;
    let weights = Weights::open(&found.weights, device());
    let weights = weights.map_err(|error| damaged(found, &network_problem(&error)))?;
    Ok(weights.in_type(compute_type))
}

/// What the weights take in memory when layers compute with this type.
pub(crate) fn footprint(found: &Found, compute_type: ComputeType) -> Result<Footprint, Error> {
    Ok(open(found, compute_type)?.footprint())
}

/// Builds a network of all tensors of the weights that were found, which computes with this type; `build`
/// gives `None` for another network's configuration.
pub(crate) fn network<N>(
    found: &Found,
    compute_type: ComputeType,
    build: impl FnOnce(&Config, &Weights) -> Option<candle_core::Result<N>>,
) -> Result<N, Error> {
    let weights = open(found, compute_type)?;
    let network = part(found, &weights, build)?;
    match weights.unused().first() {
        None => Ok(network),
        Some(name) => Err(damaged(
            found,
            &format!(
                "the file holds {} tensors that the network does not have, {name} the first",
                weights.unused().len()
            ),
        )),
    }
}

/// Builds a network of some of the tensors.
pub(crate) fn part<N>(
    found: &Found,
    weights: &Weights,
    build: impl FnOnce(&Config, &Weights) -> Option<candle_core::Result<N>>,
) -> Result<N, Error> {
    build(&found.file.config, weights)
        .ok_or_else(|| damaged(found, &format!("they are of {}", found.network.title)))?
        .map_err(|error| damaged(found, &network_problem(&error)))
}
