//! The form in which weights are kept: a folder with `model.safetensors` and `config.json`.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::excerpt;
use crate::{Checkpoint, Config, Error, Precision, Result, TensorSpec};

/// The file with the tensors.
pub const WEIGHTS_FILE: &str = "model.safetensors";
/// The file that says what network they are of.
pub const CONFIG_FILE: &str = "config.json";

/// How the names of unfinished files begin and end.
pub(crate) const TEMPORARY: (&str, &str) = (".tid3r-", ".part");

/// The longest `config.json` that is read, in bytes.
const LONGEST: u64 = 1 << 20;

/// Where weights come from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// Name of the file that was converted, or `synthetic`.
    pub source: String,
    /// SHA-256 of that file; if it is the index of several, of all of them one after another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_sha256: Option<String>,
    /// Seed of synthetic weights.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Where the network's code is published.
    pub upstream: String,
    /// The licence of the weights.
    pub licence: String,
    /// Program and version that wrote the folder.
    pub converter: String,
}

impl Provenance {
    /// This program, as a converter.
    pub(crate) const CONVERTER: &str = concat!("tid3r ", env!("CARGO_PKG_VERSION"));

    fn metadata(&self) -> BTreeMap<&'static str, String> {
        let mut metadata = BTreeMap::from([
            ("source", self.source.clone()),
            ("upstream", self.upstream.clone()),
            ("licence", self.licence.clone()),
            ("converter", self.converter.clone()),
        ]);
        metadata.extend(
            self.source_sha256
                .clone()
                .map(|hash| ("source_sha256", hash)),
        );
        metadata.extend(self.seed.map(|seed| ("seed", seed.to_string())));
        metadata
    }
}

/// What `config.json` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConfigFile {
    /// The network's configuration, under the names that its authors give them.
    #[serde(flatten)]
    pub config: Config,
    /// Where the weights come from.
    pub provenance: Provenance,
    /// SHA-256 of `model.safetensors`.
    pub weights_sha256: String,
}

impl ConfigFile {
    /// Reads a `config.json`.
    ///
    /// # Errors
    ///
    /// If it cannot be read or is not of weights that tid3r has converted.
    pub fn read(path: &Path) -> Result<Self> {
        let size = fs::metadata(path).map_err(Error::io("read", path))?.len();
        let remedy = "make the folder with `tid3r weights convert`";
        if size > LONGEST {
            return Err(Error::file(path, "too long for a configuration", remedy));
        }
        let text = fs::read(path).map_err(Error::io("read", path))?;
        serde_json::from_slice(&text).map_err(|e| {
            Error::file(
                path,
                format!(
                    "not the configuration of converted weights: {}",
                    excerpt(&e.to_string())
                ),
                remedy,
            )
        })
    }
}

/// Weights that have been written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Written {
    /// The folder.
    pub folder: PathBuf,
    /// Name of the network.
    pub network: &'static str,
    /// The type of the numbers.
    pub dtype: Precision,
    /// How many tensors there are.
    pub tensors: usize,
    /// How many numbers they have.
    pub numbers: u64,
    /// Size of `model.safetensors`.
    pub bytes: u64,
    /// Its SHA-256.
    pub sha256: String,
    /// Where the weights come from.
    pub provenance: Provenance,
    /// Whether they were there already, and were kept.
    pub kept: bool,
    /// What a person should know about them.
    pub notes: Vec<String>,
}

/// A folder of weights in the making.
pub(crate) struct NewFolder<'a> {
    pub(crate) folder: &'a Path,
    /// Whether weights that are there already are replaced.
    pub(crate) replace: bool,
    pub(crate) config: Config,
    pub(crate) precision: Precision,
    pub(crate) provenance: Provenance,
    pub(crate) notes: Vec<String>,
}

impl NewFolder<'_> {
    /// Refuses a folder that has weights already, unless they are to be replaced or were never finished.
    pub(crate) fn check(folder: &Path, replace: bool) -> Result<()> {
        let replace = replace || is_unfinished(folder);
        let taken = [WEIGHTS_FILE, CONFIG_FILE].map(|name| folder.join(name));
        match taken.iter().find(|path| path.exists()) {
            Some(path) if !replace => Err(Error::file(
                path,
                "there already",
                "choose another folder, or give --force to replace it",
            )),
            _ => Ok(()),
        }
    }

    /// Writes the folder. `write_tensors` gets the path of the file with tensors, its metadata and
    /// its tensors' types and shapes; it writes that file and says its SHA-256.
    ///
    /// The configuration comes last: a folder without one is not finished.
    pub(crate) fn write(
        self,
        shapes: BTreeMap<String, Vec<usize>>,
        write_tensors: impl FnOnce(
            &Path,
            &BTreeMap<&str, String>,
            &BTreeMap<String, TensorSpec>,
        ) -> Result<String>,
    ) -> Result<Written> {
        Self::check(self.folder, self.replace)?;
        let (weights, config) = (
            self.folder.join(WEIGHTS_FILE),
            self.folder.join(CONFIG_FILE),
        );
        let mut specs = BTreeMap::new();
        for (name, shape) in shapes {
            let spec = TensorSpec::new(shape, self.precision.dtype()).ok_or_else(|| {
                let problem = format!("tensor `{name}` would be larger than memory can address");
                Error::file(&weights, problem, "use another configuration")
            })?;
            specs.insert(name, spec);
        }
        fs::create_dir_all(self.folder).map_err(Error::io("create", self.folder))?;
        clear_away(self.folder)?;
        if config.exists() {
            fs::remove_file(&config).map_err(Error::io("replace", &config))?;
        }
        let mut metadata = self.provenance.metadata();
        metadata.insert("network", self.config.network().name.to_owned());
        let sha256 = write_tensors(&weights, &metadata, &specs)?;
        let file = ConfigFile {
            config: self.config,
            provenance: self.provenance,
            weights_sha256: sha256,
        };
        write_config(&config, &file)?;
        let bytes = fs::metadata(&weights)
            .map_err(Error::io("read", &weights))?
            .len();
        Ok(Written {
            folder: self.folder.to_path_buf(),
            network: file.config.network().name,
            dtype: self.precision,
            tensors: specs.len(),
            numbers: specs.values().map(|spec| spec.elements() as u64).sum(),
            bytes,
            sha256: file.weights_sha256,
            provenance: file.provenance,
            kept: false,
            notes: self.notes,
        })
    }
}

/// Whether weights of tid3r's making are in the folder, but not their configuration, which is written
/// last.
fn is_unfinished(folder: &Path) -> bool {
    let weights = Checkpoint::open(&folder.join(WEIGHTS_FILE));
    let is_ours = weights.is_ok_and(|weights| weights.metadata().contains_key("converter"));
    is_ours && !folder.join(CONFIG_FILE).exists()
}

/// Removes what an interrupted conversion to the folder has left, which may be as large as the weights.
fn clear_away(folder: &Path) -> Result<()> {
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with(TEMPORARY.0) && name.ends_with(TEMPORARY.1) && path.is_file() {
            fs::remove_file(&path).map_err(Error::io("remove", &path))?;
        }
    }
    Ok(())
}

fn write_config(path: &Path, file: &ConfigFile) -> Result<()> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut temporary = tempfile::Builder::new()
        .prefix(TEMPORARY.0)
        .suffix(TEMPORARY.1)
        .make_in(folder, |name| fs::File::create_new(name))
        .map_err(Error::io("create a file for", path))?;
    let text = serde_json::to_string_pretty(file).map_err(std::io::Error::from);
    text.and_then(|text| writeln!(temporary, "{text}"))
        .and_then(|()| temporary.as_file().sync_all())
        .map_err(Error::io("write", path))?;
    (temporary.persist(path))
        .map_err(|e| Error::io("rename the finished file to", path)(e.error))?;
    Ok(())
}
