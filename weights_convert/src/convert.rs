//! Published checkpoints to the form in which tid3r reads them.

use std::path::{Path, PathBuf};

use crate::folder::{ConfigFile, NewFolder, Provenance};
use crate::networks::{Hints, Plan};
use crate::repository::checkpoint_at;
use crate::{
    CONFIG_FILE, Checkpoint, Error, Found, Network, Precision, Result, Step, Written, hash,
    safetensors_file,
};

/// How a checkpoint is converted.
#[derive(Clone, Copy, Debug, Default)]
pub struct ConvertOptions<'a> {
    /// The type of the numbers to write.
    pub precision: Precision,
    /// Whether weights that are in the folder already are replaced.
    pub replace: bool,
    /// Attention heads of encoder and decoder, for a checkpoint that does not say them.
    pub heads: Option<(usize, usize)>,
    /// Which network it must be of: where several have the same tensors, it is.
    pub network: Option<&'static Network>,
    /// Checkpoints with the tensors that the first one lacks, for a network that is published in several
    /// files: LPIPS.
    pub with: &'a [PathBuf],
}

/// Converts the checkpoint at `source` to `model.safetensors` and `config.json` in `folder`.
///
/// The source is a file of `torch.save`, with a state dict or with the network's objects, or a
/// safetensors file, or the index of several, or a folder with one of these under a name that Hugging
/// Face's libraries give it; which network it is of is found out from its tensors. They must be exactly
/// those of the network, except that
///
/// - tensors without effect are left out, such as `num_batches_tracked`, and so is what else is in the
///   file of a whole SAM or CLIP of which the network is a part,
/// - in MV-DUSt3R, `dec_blocks2` is a copy of `dec_blocks` where there is none at all, and heads that
///   are absent as a whole are switched off in the configuration.
///
/// Checkpoints of See3D need the `config.json` beside them, and take the pipeline's settings from the
/// folders beside and above. Weights are written as they are read: memory use is a few megabytes whatever
/// the size.
///
/// # Errors
///
/// If the source is no checkpoint of a known network, lacks a tensor or has one too many or of
/// another shape, has a value that is not finite or would not be after rounding, or if a file cannot
/// be read or written.
pub fn convert(
    source: &Path,
    folder: &Path,
    options: &ConvertOptions<'_>,
    progress: &mut dyn FnMut(Step),
) -> Result<Written> {
    NewFolder::check(folder, options.replace)?;
    Conversion::plan(source, options)?.write(folder, progress)
}

/// Which network the checkpoint at `source` is of: what [`convert()`] would make of it, without writing.
///
/// # Errors
///
/// As [`convert()`], but for those about values and about the folder.
pub fn network_of(source: &Path, options: &ConvertOptions<'_>) -> Result<&'static Network> {
    Ok(Conversion::plan(source, options)?.plan.config.network())
}

/// A conversion that has been found possible as far as names and shapes tell.
pub(crate) struct Conversion<'a> {
    checkpoint: Checkpoint,
    plan: Plan,
    /// What tid3r has noted about the checkpoint, if it wrote it.
    ours: Option<ConfigFile>,
    /// What the checkpoint is called.
    source: String,
    options: ConvertOptions<'a>,
}

impl<'a> Conversion<'a> {
    pub(crate) fn plan(source: &Path, options: &ConvertOptions<'a>) -> Result<Self> {
        let mut checkpoint = Checkpoint::open(&checkpoint_at(source)?)?;
        let mut name = file_name(checkpoint.path());
        for other in options.with {
            checkpoint = checkpoint.and(Checkpoint::open(other)?)?;
            name = format!("{name} + {}", file_name(other));
        }
        let path = checkpoint.path();
        let ours = (checkpoint.metadata().contains_key("converter"))
            .then(|| ConfigFile::read(&path.with_file_name(CONFIG_FILE)))
            .transpose()?;
        let hints = Hints {
            heads: options.heads,
            config: ours.as_ref().map(|file| &file.config),
            network: options.network,
        };
        let plan = Plan::of(&checkpoint, hints)?;
        let network = plan.config.network();
        if let Some(wanted) = options.network.filter(|wanted| *wanted != network) {
            return Err(Error::file(
                path,
                format!("weights of {}, not of {}", network.title, wanted.title),
                format!("give a checkpoint of {}", wanted.name),
            ));
        }
        Ok(Self {
            source: name,
            checkpoint,
            plan,
            ours,
            options: *options,
        })
    }

    /// The same, with the checkpoint's path within what it was published in.
    pub(crate) fn with_source(self, source: &Path) -> Self {
        Self {
            source: source.to_string_lossy().into_owned(),
            ..self
        }
    }

    /// What is in `folder` already, if it is what this conversion would make.
    pub(crate) fn existing(
        &self,
        folder: &Path,
        progress: &mut dyn FnMut(Step),
    ) -> Result<Option<Written>> {
        let Ok(found) = Found::at(folder) else {
            return Ok(None);
        };
        let Ok(weights) = Checkpoint::open(&found.weights) else {
            return Ok(None);
        };
        let dtype = self.options.precision.dtype();
        let is_same = |(name, (shape, _)): (&String, &(Vec<usize>, String))| {
            (weights.spec(name)).is_some_and(|spec| spec.shape() == shape && spec.dtype() == dtype)
        };
        let is_alike = found.file.config == self.plan.config
            && weights.shapes().len() == self.plan.tensors.len()
            && self.plan.tensors.iter().all(is_same);
        if !is_alike
            || found.file.provenance.source_sha256 != self.provenance(progress)?.source_sha256
        {
            return Ok(None);
        }
        Ok(Some(Written {
            folder: found.folder,
            network: found.network.name,
            dtype: self.options.precision,
            tensors: self.plan.tensors.len(),
            numbers: self.numbers(),
            bytes: weights.length(),
            sha256: found.file.weights_sha256,
            provenance: found.file.provenance,
            kept: true,
            notes: Vec::new(),
        }))
    }

    fn numbers(&self) -> u64 {
        let shapes = self.plan.tensors.values().map(|(shape, _)| shape);
        shapes
            .map(|shape| shape.iter().product::<usize>() as u64)
            .sum()
    }

    /// Writes the folder.
    pub(crate) fn write(self, folder: &Path, progress: &mut dyn FnMut(Step)) -> Result<Written> {
        let ConvertOptions {
            precision, replace, ..
        } = self.options;
        NewFolder::check(folder, replace)?;
        let provenance = self.provenance(progress)?;
        let Self {
            checkpoint, plan, ..
        } = self;
        let new = NewFolder {
            folder,
            replace,
            config: plan.config,
            precision,
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
                    let encoded = precision.encode(values, &mut bytes);
                    encoded.map_err(|index| {
                        let value = values[index];
                        let at = done + index;
                        Error::file(
                            checkpoint.path(),
                            format!(
                                "tensor `{original}`: element {at} is {value}, too large for {precision}"
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

    fn provenance(&self, progress: &mut dyn FnMut(Step)) -> Result<Provenance> {
        if let Some(file) = &self.ours {
            return Ok(Provenance {
                converter: Provenance::CONVERTER.to_owned(),
                ..file.provenance.clone()
            });
        }
        let network = self.plan.config.network();
        Ok(Provenance {
            source: self.source.clone(),
            source_sha256: Some(hash::of_files(self.checkpoint.files(), progress)?),
            seed: None,
            upstream: network.upstream.to_owned(),
            licence: network.licence.to_owned(),
            converter: Provenance::CONVERTER.to_owned(),
        })
    }
}

fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}
