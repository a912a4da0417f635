//! Folders of synthetic weights.

use std::path::Path;

use crate::folder::{NewFolder, Provenance};
use crate::{Config, Error, Precision, Result, Step, Written, synth};

/// Writes synthetic weights of a network with configuration `config` to `folder`, in the same form as
/// converted ones.
///
/// Values are those of [`Network::synthetic`](crate::Network::synthetic) for name, shape and `seed`,
/// rounded to `precision`; the file is the same bit for bit wherever it is made. The network runs on it,
/// and understands nothing.
///
/// # Errors
///
/// If no network has this configuration, if there are weights in the folder and `replace` is not
/// given, or if a file cannot be written.
pub fn synthesize(
    config: Config,
    seed: u64,
    precision: Precision,
    folder: &Path,
    replace: bool,
    progress: &mut dyn FnMut(Step),
) -> Result<Written> {
    let shapes = config.tensors().map_err(|problem| {
        Error::request(problem, "use the configuration of a published network")
    })?;
    let network = config.network();
    let provenance = Provenance {
        source: "synthetic".to_owned(),
        source_sha256: None,
        seed: Some(seed),
        upstream: network.upstream.to_owned(),
        licence: "none: made from a seed".to_owned(),
        converter: Provenance::CONVERTER.to_owned(),
    };
    let new = NewFolder {
        folder,
        replace,
        config,
        precision,
        provenance,
        notes: Vec::new(),
    };
    let written = new.write(shapes, |path, metadata, specs| {
        const MEGABYTE: usize = 1_000_000;
        let total: usize = specs.values().map(|spec| spec.bytes()).sum();
        progress(Step::Begin {
            task: "synthesize, MB",
            total: total / MEGABYTE,
        });
        let mut done = 0;
        synth::write(path, metadata, specs, seed, network.adjustments, |bytes| {
            progress(Step::Advance((done + bytes) / MEGABYTE - done / MEGABYTE));
            done += bytes;
        })
    })?;
    progress(Step::End);
    Ok(written)
}
