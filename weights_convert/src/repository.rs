//! Folders in which all networks of a method are published together, each in a folder of its own.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::convert::Conversion;
use crate::{ConvertOptions, Error, Network, Result, Step, Written};

/// What Hugging Face's libraries call a checkpoint in the folder of a network. The first that is there
/// is taken: they are the same numbers.
const NAMES: [&str; 10] = [
    "diffusion_pytorch_model.safetensors",
    "diffusion_pytorch_model.safetensors.index.json",
    "diffusion_pytorch_model.bin",
    "diffusion_pytorch_model.bin.index.json",
    "diffusion_pytorch_model.fp16.safetensors",
    "model.safetensors",
    "model.safetensors.index.json",
    "pytorch_model.bin",
    "pytorch_model.bin.index.json",
    "model.fp16.safetensors",
];

/// The checkpoint in `folder`, if there is one.
fn checkpoint_in(folder: &Path) -> Option<PathBuf> {
    let mut paths = NAMES.iter().map(|name| folder.join(name));
    paths.find(|path| path.is_file())
}

/// The checkpoint at `path`: a file, or what is in the folder.
pub(crate) fn checkpoint_at(path: &Path) -> Result<PathBuf> {
    if !path.is_dir() {
        return Ok(path.to_path_buf());
    }
    checkpoint_in(path).ok_or_else(|| {
        Error::file(
            path,
            "a folder, and no checkpoint is in it under a name that is known",
            "give the checkpoint file (.pth, .pt, .bin, .safetensors or .index.json)",
        )
    })
}

/// A folder with checkpoints of several networks, as their authors publish it.
///
/// Where each network's checkpoint is in it is known ([`Network::folder`], [`Network::files`]). What the
/// folder says about itself, in `model_index.json`, is not needed and never followed.
#[derive(Debug)]
pub struct Repository {
    root: PathBuf,
    parts: Vec<Part>,
    missing: Vec<&'static Network>,
}

#[derive(Debug)]
struct Part {
    network: &'static Network,
    /// Where its checkpoint is, below the root.
    place: &'static Path,
    /// Its checkpoint.
    file: PathBuf,
}

impl Repository {
    /// The repository at `path`, or where its authors have it below: `checkpoint/MVD_weights`. `None` if
    /// there is none.
    pub fn at(path: &Path) -> Option<Self> {
        let folders = Network::all().iter().filter_map(|network| network.folder);
        let folders: BTreeSet<_> = folders.collect();
        let mut roots = vec![path.to_path_buf()];
        for folder in folders {
            let name = Path::new(folder).file_name().unwrap_or_default();
            roots.extend([path.join(folder), path.join(name)]);
        }
        roots.into_iter().find_map(Self::with_root)
    }

    fn with_root(root: PathBuf) -> Option<Self> {
        let mut parts = Vec::new();
        let mut missing = Vec::new();
        for network in Network::all() {
            let Some(place) = network.place() else {
                continue;
            };
            match checkpoint_in(&root.join(place)) {
                Some(file) => parts.push(Part {
                    network,
                    place,
                    file,
                }),
                None => missing.push(network),
            }
        }
        (!parts.is_empty()).then_some(Self {
            root,
            parts,
            missing,
        })
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The networks of which it has checkpoints.
    pub fn networks(&self) -> impl Iterator<Item = &'static Network> {
        self.parts.iter().map(|part| part.network)
    }

    /// The networks whose checkpoints it lacks, each with the folder in which it would be.
    pub fn missing(&self) -> impl Iterator<Item = (&'static Network, PathBuf)> {
        let placed = |&network: &&'static Network| {
            let place = network.place().unwrap_or(Path::new(""));
            (network, self.root.join(place))
        };
        self.missing.iter().map(placed)
    }

    /// Converts every network to a folder of its name in `models`.
    ///
    /// All are looked at before the first is written. Those that are there already, converted from the
    /// same file to the same type, are kept: what was interrupted goes on. So are those that are there
    /// otherwise, unless they are to be replaced; then it is an error.
    ///
    /// # Errors
    ///
    /// As [`convert()`](crate::convert()) for any of them. What has been converted before the error stays.
    pub fn convert(
        &self,
        models: &Path,
        options: &ConvertOptions<'_>,
        progress: &mut dyn FnMut(Step),
    ) -> Result<Vec<Written>> {
        let plan = |part: &Part| {
            let options = ConvertOptions {
                network: Some(part.network),
                ..*options
            };
            let conversion = Conversion::plan(&part.file, &options)?;
            let name = part.file.file_name().unwrap_or_default();
            Ok(conversion.with_source(&part.place.join(name)))
        };
        let planned: Vec<Conversion<'_>> = self.parts.iter().map(plan).collect::<Result<_>>()?;
        let mut written = Vec::new();
        for (part, conversion) in self.parts.iter().zip(planned) {
            let folder = models.join(part.network.name);
            let kept = match options.replace {
                true => None,
                false => conversion.existing(&folder, progress)?,
            };
            written.push(match kept {
                Some(kept) => kept,
                None => conversion.write(&folder, progress)?,
            });
        }
        Ok(written)
    }
}
