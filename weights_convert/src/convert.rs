//! Published checkpoints to the form in which tid3r reads them.

use std::path::Path;

use crate::folder::{ConfigFile, NewFolder, Provenance};
use crate::networks::{Hints, Plan};
use crate::{
    CONFIG_FILE, Checkpoint, Error, Network, Precision, Result, Step, Written, hash,
    safetensors_file,
};

/// How a checkpoint is converted.
#[derive(Clone, Copy, Debug, Default)]
pub struct ConvertOptions {
    /// The type of the numbers to write.
    pub precision: Precision,
    /// Whether weights that are in the folder already are replaced.
    pub replace: bool,
    /// Attention heads of encoder and decoder, for a checkpoint that does not say them.
    pub heads: Option<(usize, usize)>,
}

/// Converts the checkpoint at `source` to `model.safetensors` and `config.json` in `folder`.
///
/// The source is a file of `torch.save`, with a state dict or with the network's objects, or a
/// safetensors file, or the index of several; which network it is of is found out from its tensors. They
/// must be exactly those of the network, except that
///
/// - tensors without effect are left out, such as `num_batches_tracked`, and so is what else is in the
///   file of a whole SAM of which the network is a part,
/// - in MV-DUSt3R, `dec_blocks2` is a copy of `dec_blocks` where there is none at all, and heads that
///   are absent as a whole are switched off in the configuration.
///
/// Weights are written as they are read: memory use is a few megabytes whatever the size.
///
/// # Errors
///
/// If the source is no checkpoint of a known network, lacks a tensor or has one too many or of
/// another shape, has a value that is not finite or would not be after rounding, or if a file cannot
/// be read or written.
pub fn convert(
    source: &Path,
    folder: &Path,
    options: &ConvertOptions,
    progress: &mut dyn FnMut(Step),
) -> Result<Written> {
    NewFolder::check(folder, options.replace)?;
    let (checkpoint, plan, ours) = plan(source, options)?;
    let provenance = match ours {
        Some(file) => Provenance {
            converter: Provenance::CONVERTER.to_owned(),
            ..file.provenance
        },
        None => {
            let network = plan.config.network();
            Provenance {
                source: file_name(source),
                source_sha256: Some(hash::of_files(checkpoint.files(), progress)?),
                seed: None,
                upstream: network.upstream.to_owned(),
                licence: network.licence.to_owned(),
                converter: Provenance::CONVERTER.to_owned(),
            }
        }
    };
    let new = NewFolder {
        folder,
        replace: options.replace,
        config: plan.config,
        precision: options.precision,
        provenance,
        notes: plan.notes,
    };
    let shapes = plan
        .tensors
        .iter()
        .map(|(name, (shape, _))| (name.clone(), shape.clone()));
    let written = new.write(shapes.collect(), |path, metadata, specs| {
        progress(Step::Begin {
            task: "convert, tensors",
            total: specs.len(),
        });
        let mut bytes = Vec::new();
        safetensors_file::write(path, metadata, specs, |out, name, spec| {
            let (_, original) = &plan.tensors[name];
            let mut done = 0;
            checkpoint.read(original, |values| {
                let values = &values[..values.len().min(spec.elements() - done)];
                bytes.clear();
                let encoded = options.precision.encode(values, &mut bytes);
                encoded.map_err(|index| {
                    let value = values[index];
                    let at = done + index;
                    Error::file(
                        source,
                        format!(
                            "tensor `{original}`: element {at} is {value}, too large for {}",
                            options.precision
                        ),
                        "convert to bf16 or f32",
                    )
                })?;
                done += values.len();
                out.write_all(&bytes).map_err(Error::io("write", path))
            })?;
            progress(Step::Advance(1));
            Ok(())
        })
    })?;
    progress(Step::End);
    Ok(written)
}

/// Which network the checkpoint at `source` is of: what [`convert()`] would make of it, without writing.
///
/// # Errors
///
/// As [`convert()`], but for those about values and about the folder.
pub fn network_of(source: &Path, options: &ConvertOptions) -> Result<&'static Network> {
    let (_, plan, _) = plan(source, options)?;
    Ok(plan.config.network())
}

/// The checkpoint, what becomes of it, and what tid3r has noted about it if it wrote it.
fn plan(source: &Path, options: &ConvertOptions) -> Result<(Checkpoint, Plan, Option<ConfigFile>)> {
    let checkpoint = Checkpoint::open(source)?;
    let ours = (checkpoint.metadata().contains_key("converter"))
        .then(|| ConfigFile::read(&source.with_file_name(CONFIG_FILE)))
        .transpose()?;
    let hints = Hints {
        heads: options.heads,
        config: ours.as_ref().map(|file| &file.config),
    };
    let plan = Plan::of(&checkpoint, hints)?;
    Ok((checkpoint, plan, ours))
}

fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}
