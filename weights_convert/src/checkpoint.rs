//! Checkpoint files, whatever their format.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use crate::error::excerpt;
use crate::stored::{StoredTensor, is_float, widen};
use crate::{Error, Result, TensorSpec, safetensors_file, torch};

/// A file with tensors by name: a `.pth` or `.pt` of `torch.save`, or a `.safetensors`, told apart
/// by what is in it.
///
/// Opening reads what describes the tensors and nothing else; their numbers are read when they are
/// asked for, a piece at a time. So a file of any size takes a few megabytes of memory, and what a
/// training run saved beside the weights is never read. Nothing in the file is executed.
#[derive(Debug)]
pub struct Checkpoint {
    path: PathBuf,
    file: File,
    length: u64,
    contents: Contents,
}

/// What a checkpoint file says about itself.
#[derive(Debug)]
pub(crate) struct Contents {
    pub(crate) tensors: BTreeMap<String, StoredTensor>,
    /// The Python expression with which the training script made the network.
    pub(crate) constructor: Option<String>,
    /// Of a safetensors file.
    pub(crate) metadata: BTreeMap<String, String>,
}

impl Checkpoint {
    /// Opens the checkpoint at `path`.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is in no format that is known, is damaged or cut short, or
    /// describes tensors that it does not hold.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io("read", path))?;
        let metadata = file.metadata().map_err(Error::io("read", path))?;
        let refuse = |problem: &str, remedy: &str| Error::file(path, problem, remedy);
        if metadata.is_dir() {
            let remedy = "give the checkpoint file in it (.pth, .pt or .safetensors)";
            return Err(refuse("a folder, not a checkpoint", remedy));
        }
        let length = metadata.len();
        let mut head = Vec::new();
        (&file)
            .take(16)
            .read_to_end(&mut head)
            .map_err(Error::io("read", path))?;
        (&file).rewind().map_err(Error::io("read", path))?;
        let contents = if head.is_empty() {
            return Err(refuse("empty", "get it again"));
        } else if torch::starts_as_zip(&head) {
            torch::contents(path, &file, length)?
        } else if head.starts_with(b"\x80") && head.get(1).is_some_and(|n| (1..=5).contains(n)) {
            return Err(refuse(
                "in the format of PyTorch before 1.6, which is not read",
                "save it again where it was made: torch.save(torch.load(OLD), NEW) in Python",
            ));
        } else if head.get(8) == Some(&b'{') {
            safetensors_file::contents(path, &file, length)?
        } else {
            return Err(refuse(
                "not a checkpoint: neither an archive of torch.save nor a safetensors file",
                "give the file as it was downloaded (.pth, .pt or .safetensors)",
            ));
        };
        let checkpoint = Self {
            path: path.to_path_buf(),
            file,
            length,
            contents,
        };
        checkpoint.refuse_inflation()?;
        Ok(checkpoint)
    }

    /// Tensors may share numbers. A small file must not become a huge one that way.
    fn refuse_inflation(&self) -> Result<()> {
        let bytes = |tensor: &StoredTensor| tensor.elements() * tensor.dtype().bitsize() / 8;
        let total = (self.contents.tensors.values())
            .try_fold(0_usize, |sum, tensor| sum.checked_add(bytes(tensor)));
        match total {
            Some(total) if total as u64 / 2 <= self.length => Ok(()),
            _ => Err(Error::file(
                &self.path,
                "its tensors together are more than twice as large as the file",
                "this is no checkpoint of a network that tid3r knows",
            )),
        }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its size in bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Names and shapes of the tensors.
    pub fn shapes(&self) -> BTreeMap<&str, &[usize]> {
        let tensors = &self.contents.tensors;
        tensors
            .iter()
            .map(|(name, tensor)| (name.as_str(), tensor.shape()))
            .collect()
    }

    /// Shape and element type of a tensor, if there is one of that name.
    pub fn spec(&self, name: &str) -> Option<TensorSpec> {
        let tensor = self.contents.tensors.get(name)?;
        TensorSpec::new(tensor.shape().to_vec(), tensor.dtype())
    }

    /// The Python expression with which the training script made the network, if the file has it.
    /// It is a text that anybody may have written, not something to be evaluated.
    pub fn constructor(&self) -> Option<&str> {
        self.contents.constructor.as_deref()
    }

    /// What is noted in a safetensors file beside the tensors.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.contents.metadata
    }

    /// Reads the float tensor called `name`, row-major, and hands its values over a piece at a time.
    ///
    /// # Errors
    ///
    /// If there is no float tensor of that name, the file cannot be read, a value is no finite f32
    /// number, or `take` fails.
    pub fn read(&self, name: &str, mut take: impl FnMut(&[f32]) -> Result<()>) -> Result<()> {
        let refuse = |problem: String, remedy: &str| Error::file(&self.path, problem, remedy);
        let tensor = (self.contents.tensors.get(name))
            .filter(|tensor| is_float(tensor.dtype()))
            .ok_or_else(|| {
                let problem = format!("there is no tensor `{}` of real numbers", excerpt(name));
                refuse(
                    problem,
                    "this is no checkpoint of the network that is wanted",
                )
            })?;
        let read_error = |e| Error::io("read", &self.path)(e);
        let mut values = Vec::new();
        let mut done = 0;
        tensor.read(&self.file, read_error, |bytes| {
            values.clear();
            widen(tensor.dtype(), bytes, |value| values.push(value));
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                let (name, index) = (excerpt(name), done + index);
                let problem = format!("tensor `{name}`: element {index} is not finite");
                return Err(refuse(problem, "the checkpoint is broken: get another"));
            }
            done += values.len();
            take(&values)
        })
    }
}
