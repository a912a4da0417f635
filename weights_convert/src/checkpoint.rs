//! Checkpoint files, whatever their format.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use crate::error::excerpt;
use crate::stored::{StoredTensor, is_float, widen};
use crate::{Error, Result, TensorSpec, parts, safetensors_file, torch};

/// A file with tensors by name: a `.pth` or `.pt` of `torch.save`, a `.safetensors`, or the index
/// (`.index.json`) of a checkpoint that is published in several such files, told apart by what is in
/// it.
///
/// Opening reads what describes the tensors and nothing else; their numbers are read when they are
/// asked for, a piece at a time. So a file of any size takes a few megabytes of memory, and what a
/// training run saved beside the weights is never read. Nothing in the file is executed.
#[derive(Debug)]
pub struct Checkpoint {
    path: PathBuf,
    files: Vec<OpenFile>,
    tensors: BTreeMap<String, Placed>,
    constructor: Option<String>,
    classes: Option<usize>,
    metadata: BTreeMap<String, String>,
}

/// A file of a checkpoint: most have one.
#[derive(Debug)]
struct OpenFile {
    path: PathBuf,
    file: File,
    length: u64,
}

/// A tensor, and which file it is in.
#[derive(Debug)]
struct Placed {
    file: usize,
    tensor: StoredTensor,
}

/// What a checkpoint file says about itself.
#[derive(Debug)]
pub(crate) struct Contents {
    pub(crate) tensors: BTreeMap<String, StoredTensor>,
    /// The Python expression with which the training script made the network.
    pub(crate) constructor: Option<String>,
    /// How many names of classes a detector has that was saved with its objects.
    pub(crate) classes: Option<usize>,
    /// Of a safetensors file.
    pub(crate) metadata: BTreeMap<String, String>,
}

impl OpenFile {
    /// Opens the file and says how it begins.
    fn open(path: &Path) -> Result<(Self, Vec<u8>)> {
        let file = File::open(path).map_err(Error::io("read", path))?;
        let metadata = file.metadata().map_err(Error::io("read", path))?;
        let refuse = |problem: &str, remedy: &str| Error::file(path, problem, remedy);
        if metadata.is_dir() {
            let remedy = "give the checkpoint file in it (.pth, .pt or .safetensors)";
            return Err(refuse("a folder, not a checkpoint", remedy));
        }
        let mut head = Vec::new();
        (&file)
            .take(16)
            .read_to_end(&mut head)
            .map_err(Error::io("read", path))?;
        (&file).rewind().map_err(Error::io("read", path))?;
        if head.is_empty() {
            return Err(refuse("empty", "get it again"));
        }
        let open = Self {
            path: path.to_path_buf(),
            file,
            length: metadata.len(),
        };
        Ok((open, head))
    }

    /// What is in it, if it is a file with tensors that begins with `head`.
    fn contents(&self, head: &[u8]) -> Result<Contents> {
        let Self { path, file, length } = self;
        let refuse = |problem: &str, remedy: &str| Err(Error::file(path, problem, remedy));
        if torch::starts_as_zip(head) {
            torch::contents(path, file, *length)
        } else if torch::legacy::starts_as_legacy(head) {
            torch::legacy::contents(path, file, *length)
        } else if head.starts_with(b"\x80") && head.get(1).is_some_and(|n| (1..=5).contains(n)) {
            refuse(
                "a pickle of Python that torch.save has not written",
                "save it again where it was made: torch.save(STATE_DICT, NEW) in Python",
            )
        } else if head.get(8) == Some(&b'{') {
            safetensors_file::contents(path, file, *length)
        } else {
            refuse(
                "not a checkpoint: neither an archive of torch.save nor a safetensors file",
                "give the file as it was downloaded (.pth, .pt or .safetensors)",
            )
        }
    }
}

impl Checkpoint {
    /// Opens the checkpoint at `path`.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is in no format that is known, is damaged or cut short, or
    /// describes tensors that it does not hold; the same if one of the files that an index names is
    /// not there or lacks a tensor.
    pub fn open(path: &Path) -> Result<Self> {
        let (file, head) = OpenFile::open(path)?;
        let checkpoint = if parts::starts_as_index(&head) {
            Self::of_parts(file)?
        } else {
            let contents = file.contents(&head)?;
            let placed = |(name, tensor)| (name, Placed { file: 0, tensor });
            Self {
                path: path.to_path_buf(),
                files: vec![file],
                tensors: contents.tensors.into_iter().map(placed).collect(),
                constructor: contents.constructor,
                classes: contents.classes,
                metadata: contents.metadata,
            }
        };
        checkpoint.refuse_inflation()?;
        Ok(checkpoint)
    }

    /// The checkpoint whose tensors are in the files that `index` names.
    fn of_parts(index: OpenFile) -> Result<Self> {
        let path = index.path.clone();
        let listed = parts::listed(&path, &index.file, index.length)?;
        let mut files = vec![index];
        let mut tensors = BTreeMap::new();
        for (name, wanted) in listed {
            let (file, head) = OpenFile::open(&path.with_file_name(&name))?;
            let mut contents = file.contents(&head)?;
            for tensor in wanted {
                let Some(stored) = contents.tensors.remove(&tensor) else {
                    let (tensor, index) = (excerpt(&tensor), path.display());
                    return Err(Error::file(
                        &file.path,
                        format!("there is no tensor `{tensor}`, which {index} says is in it"),
                        "the files are not of the same checkpoint: get all of them again",
                    ));
                };
                let placed = Placed {
                    file: files.len(),
                    tensor: stored,
                };
                tensors.insert(tensor, placed);
            }
            files.push(file);
        }
        Ok(Self {
            path,
            files,
            tensors,
            constructor: None,
            classes: None,
            metadata: BTreeMap::new(),
        })
    }

    /// Tensors may share numbers. A small file must not become a huge one that way.
    fn refuse_inflation(&self) -> Result<()> {
        let bytes = |tensor: &StoredTensor| tensor.elements() * tensor.dtype().bitsize() / 8;
        let total = (self.tensors.values()).try_fold(0_usize, |sum, placed| {
            sum.checked_add(bytes(&placed.tensor))
        });
        match total {
            Some(total) if total as u64 / 2 <= self.length() => Ok(()),
            _ => Err(Error::file(
                &self.path,
                "its tensors together are more than twice as large as the file",
                "this is no checkpoint of a network that tid3r knows",
            )),
        }
    }

    /// This checkpoint with the tensors of `other` as well: of a network that is published in several.
    ///
    /// # Errors
    ///
    /// If a tensor is in both.
    pub(crate) fn and(mut self, other: Self) -> Result<Self> {
        let before = self.files.len();
        for (name, mut placed) in other.tensors {
            placed.file += before;
            if self.tensors.contains_key(&name) {
                return Err(Error::file(
                    &other.path,
                    format!(
                        "has a tensor `{}` as {} has",
                        excerpt(&name),
                        self.path.display()
                    ),
                    "give files that complete each other",
                ));
            }
            self.tensors.insert(name, placed);
        }
        self.files.extend(other.files);
        Ok(self)
    }

    /// The file; the first of several that were put together.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file, and those with its tensors if it is an index.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(|file| file.path.as_path())
    }

    /// The size in bytes of all its files together.
    pub fn length(&self) -> u64 {
        self.files
            .iter()
            .fold(0, |sum: u64, file| sum.saturating_add(file.length))
    }

    /// Names and shapes of the tensors.
    pub fn shapes(&self) -> BTreeMap<&str, &[usize]> {
        self.tensors
            .iter()
            .map(|(name, placed)| (name.as_str(), placed.tensor.shape()))
            .collect()
    }

    /// Shape and element type of a tensor, if there is one of that name.
    pub fn spec(&self, name: &str) -> Option<TensorSpec> {
        let tensor = &self.tensors.get(name)?.tensor;
        TensorSpec::new(tensor.shape().to_vec(), tensor.dtype())
    }

    /// The Python expression with which the training script made the network, if the file has it.
    /// It is a text that anybody may have written, not something to be evaluated.
    pub fn constructor(&self) -> Option<&str> {
        self.constructor.as_deref()
    }

    /// How many names of classes a detector has that was saved with its objects.
    pub(crate) fn classes(&self) -> Option<usize> {
        self.classes
    }

    /// What is noted in a safetensors file beside the tensors.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// Reads the float tensor called `name`, row-major, and hands its values over a piece at a time.
    ///
    /// # Errors
    ///
    /// If there is no float tensor of that name, the file cannot be read, a value is no finite f32
    /// number, or `take` fails.
    pub fn read(&self, name: &str, mut take: impl FnMut(&[f32]) -> Result<()>) -> Result<()> {
        let refuse = |problem: String, remedy: &str| Error::file(&self.path, problem, remedy);
        let Placed { file, tensor } = (self.tensors.get(name))
            .filter(|placed| is_float(placed.tensor.dtype()))
            .ok_or_else(|| {
                let problem = format!("there is no tensor `{}` of real numbers", excerpt(name));
                refuse(
                    problem,
                    "this is no checkpoint of the network that is wanted",
                )
            })?;
        let OpenFile { path, file, .. } = &self.files[*file];
        let read_error = |e| Error::io("read", path)(e);
        let mut values = Vec::new();
        let mut done = 0;
        tensor.read(file, read_error, |bytes| {
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
