//! Whether weights on disk are as they must be.

use std::collections::BTreeSet;
use std::path::PathBuf;

use serde::Serialize;

use crate::error::excerpt;
use crate::networks::differences;
use crate::stored::is_float;
use crate::{Checkpoint, Found, Precision, Provenance, Result, Step, hash};

/// What was found out about a folder of weights.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// Whether there is nothing wrong.
    pub ok: bool,
    /// What is wrong, each with its tensor or file.
    pub problems: Vec<String>,
    /// Name of the network.
    pub network: &'static str,
    /// The file with the tensors.
    pub weights: PathBuf,
    /// The types of its numbers: one, as a rule.
    pub dtypes: Vec<String>,
    /// How many tensors there are.
    pub tensors: usize,
    /// How many numbers they have.
    pub numbers: u64,
    /// Size of the file.
    pub bytes: u64,
    /// Its SHA-256.
    pub sha256: String,
    /// Where the weights come from.
    pub provenance: Provenance,
}

/// What the header of a file of weights says.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspected {
    /// What is wrong, each with its tensor or file.
    pub problems: Vec<String>,
    /// The types of its numbers: one, as a rule.
    pub dtypes: Vec<String>,
    /// How many tensors there are.
    pub tensors: usize,
    /// How many numbers they have.
    pub numbers: u64,
    /// Size of the file.
    pub bytes: u64,
}

/// Checks that the tensors are those of the configuration, of the right shapes and types, and all there, by the
/// file's header and length: a moment, however large it is. Every problem is listed.
///
/// # Errors
///
/// If the file cannot be read or is no whole safetensors file.
pub fn inspect(found: &Found) -> Result<Inspected> {
    Ok(inspected(found, &Checkpoint::open(&found.weights)?))
}

fn inspected(found: &Found, checkpoint: &Checkpoint) -> Inspected {
    let shapes = checkpoint.shapes();
    let mut problems = match found.file.config.tensors() {
        Ok(wanted) => differences(&wanted, &shapes),
        Err(problem) => vec![format!("config.json: {problem}")],
    };
    let mut dtypes = BTreeSet::new();
    let mut numbers = 0;
    for &name in shapes.keys() {
        let Some(spec) = checkpoint.spec(name) else {
            continue;
        };
        let dtype = spec.dtype();
        numbers += spec.elements() as u64;
        let known = Precision::of(dtype);
        dtypes.insert(known.map_or(format!("{dtype:?}"), |precision| precision.to_string()));
        if known.is_none() {
            problems.push(format!(
                "tensor `{}` is of type {dtype:?}, which is not loaded",
                excerpt(name)
            ));
        }
    }
    Inspected {
        problems,
        dtypes: dtypes.into_iter().collect(),
        tensors: shapes.len(),
        numbers,
        bytes: checkpoint.length(),
    }
}

/// Checks all that [`inspect`] does, that each number is finite, and that the file is the one that was written, by
/// its SHA-256. Every problem is listed.
///
/// # Errors
///
/// As [`inspect`].
pub fn verify(found: &Found, progress: &mut dyn FnMut(Step)) -> Result<Verdict> {
    let sha256 = hash::of_file(&found.weights, progress)?;
    let checkpoint = Checkpoint::open(&found.weights)?;
    let Inspected {
        mut problems,
        dtypes,
        tensors,
        numbers,
        bytes,
    } = inspected(found, &checkpoint);
    if sha256 != found.file.weights_sha256 {
        problems
            .push("the file is not the one that was written: its SHA-256 is another".to_owned());
    }
    progress(Step::Begin {
        task: "verify, tensors",
        total: tensors,
    });
    for name in checkpoint.shapes().into_keys() {
        let floats = checkpoint
            .spec(name)
            .is_some_and(|spec| is_float(spec.dtype()));
        if floats && let Err(error) = checkpoint.read(name, |_| Ok(())) {
            problems.push(error.problem());
        }
        progress(Step::Advance(1));
    }
    progress(Step::End);
    Ok(Verdict {
        ok: problems.is_empty(),
        problems,
        network: found.network.name,
        weights: found.weights.clone(),
        dtypes,
        tensors,
        numbers,
        bytes,
        sha256,
        provenance: found.file.provenance.clone(),
    })
}
