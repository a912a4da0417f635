//! Where weights are on this machine. Nothing here ever asks the network.

use std::env;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::hub::HubCache;
use crate::repository::{Repository, checkpoint_at};
use crate::{
    Beside, CONFIG_FILE, Checkpoint, ConfigFile, Error, Network, Result, Source, Step,
    WEIGHTS_FILE, hash,
};

/// The environment variable that names the folder of all weights: each network's are in
/// `<TID3R_MODELS>/<network>`.
const MODELS: &str = "TID3R_MODELS";

/// Weights that are there.
#[derive(Clone, Debug)]
pub struct Found {
    /// Which network they are of.
    pub network: &'static Network,
    /// Their folder.
    pub folder: PathBuf,
    /// The file with the tensors.
    pub weights: PathBuf,
    /// What `config.json` says.
    pub file: ConfigFile,
    /// Where they were looked for and found.
    pub place: Place,
}

/// A place where weights are looked for, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Place {
    /// The path that was given.
    Given,
    /// The folder that `TID3R_MODELS` names.
    Models,
    /// The local cache of Hugging Face.
    HubCache,
}

/// Finds the weights of the network called `name`: at `given` (a folder with `model.safetensors` and
/// `config.json`, or the former), else in the folder that `TID3R_MODELS` names, else in the local
/// cache of Hugging Face.
///
/// # Errors
///
/// If there is no network of that name; if what is found first is damaged or of another network; and
/// if nothing is found: the message says which file to get from where, and what to do with it.
pub fn find(name: &str, given: Option<&Path>) -> Result<Found> {
    Places::of_environment().find(Network::named(name)?, given)
}

impl Found {
    /// The weights at `path`, of whatever network: a folder with `model.safetensors` and
    /// `config.json`, or the former.
    ///
    /// # Errors
    ///
    /// If they are not there or not in that form.
    pub fn at(path: &Path) -> Result<Self> {
        Self::open(path, Place::Given)
    }

    /// The SHA-256 of the file with the tensors, in hexadecimal: it is read for that.
    ///
    /// # Errors
    ///
    /// If it cannot be read.
    pub fn hash(&self) -> Result<String> {
        hash::of_file(&self.weights, &mut |_: Step| ())
    }

    fn open(path: &Path, place: Place) -> Result<Self> {
        let weights = if path.is_dir() {
            path.join(WEIGHTS_FILE)
        } else {
            path.to_path_buf()
        };
        let is_safetensors = weights
            .extension()
            .is_some_and(|extension| extension == "safetensors");
        if !weights.is_file() || !is_safetensors {
            let problem = match (weights.exists(), path.is_dir()) {
                (false, true) => format!("no {WEIGHTS_FILE} is in it"),
                (false, false) => "not there".to_owned(),
                (true, _) => "not weights in the form that tid3r reads".to_owned(),
            };
            return Err(Error::file(path, problem, how_to_convert(path)));
        }
        let config = weights.with_file_name(CONFIG_FILE);
        if !config.is_file() {
            let problem = format!("no {CONFIG_FILE} is beside it");
            return Err(Error::file(&weights, problem, how_to_convert(path)));
        }
        let file = match ConfigFile::read(&config) {
            Err(Error::File { problem, .. }) if !is_ours(&weights) => {
                return Err(Error::file(&config, problem, how_to_convert(path)));
            }
            read => read?,
        };
        Ok(Self {
            network: file.config.network(),
            folder: weights.parent().unwrap_or(Path::new("")).to_path_buf(),
            weights,
            file,
            place,
        })
    }
}

/// What to do with weights at `path` that are not in the form that tid3r reads.
fn how_to_convert(path: &Path) -> String {
    let path_shown = path.display();
    if let Some(repository) = Repository::at(path) {
        let root = repository.root().display();
        format!(
            "convert what is in it: `tid3r weights convert {root} -o MODELS`, and set {MODELS}=MODELS"
        )
    } else if path.is_dir() && checkpoint_at(path).is_ok() {
        format!("convert it: `tid3r weights convert {path_shown} -o FOLDER`, and give FOLDER")
    } else {
        "convert a checkpoint with `tid3r weights convert FILE -o FOLDER` and give the folder"
            .to_owned()
    }
}

/// Whether tid3r wrote the file.
fn is_ours(weights: &Path) -> bool {
    Checkpoint::open(weights).is_ok_and(|file| file.metadata().contains_key("converter"))
}

/// The places on this machine where weights can be.
#[derive(Clone, Debug)]
pub struct Places {
    models: Option<PathBuf>,
    cache: Option<HubCache>,
}

impl Places {
    /// Those that the environment names.
    pub fn of_environment() -> Self {
        let set = |name| {
            env::var_os(name)
                .filter(|value| !value.is_empty())
                .map(PathBuf::from)
        };
        // The order of Hugging Face's own library.
        let cache = set("HF_HUB_CACHE")
            .or_else(|| set("HUGGINGFACE_HUB_CACHE"))
            .or_else(|| Some(set("HF_HOME")?.join("hub")))
            .or_else(|| Some(set("XDG_CACHE_HOME")?.join("huggingface/hub")))
            .or_else(|| Some(env::home_dir()?.join(".cache/huggingface/hub")));
        Self {
            models: set(MODELS),
            cache: cache.map(HubCache::new),
        }
    }

    /// The same, but converted weights are in `models`, whatever the environment says.
    #[must_use]
    pub fn with_models(self, models: impl Into<PathBuf>) -> Self {
        Self {
            models: Some(models.into()),
            ..self
        }
    }

    /// The folder in which each network has a folder of converted weights, if `TID3R_MODELS` names one.
    pub fn models(&self) -> Option<&Path> {
        self.models.as_deref()
    }

    /// The local cache of Hugging Face, if the environment says where one would be.
    pub fn cache(&self) -> Option<&Path> {
        self.cache.as_ref().map(HubCache::path)
    }

    /// The folder for converted weights of `network`, if `TID3R_MODELS` names one.
    pub fn folder(&self, network: &Network) -> Option<PathBuf> {
        Some(self.models.as_ref()?.join(network.name))
    }

    /// The published checkpoint of `network` in the local cache of Hugging Face, not converted.
    pub fn published(&self, network: &Network) -> Option<PathBuf> {
        (network.files.iter()).find_map(|file| self.file_of(network, file))
    }

    /// A file of the network's repository, if the cache has it.
    fn file_of(&self, network: &Network, path: &str) -> Option<PathBuf> {
        match network.source {
            Source::HuggingFace(repository) => self.cache.as_ref()?.file(repository, path),
            Source::Page(_) => None,
        }
    }

    /// Converted weights of `network` in the cache: beside the published files, or in a folder of the
    /// network's name.
    fn cached(&self, network: &Network) -> Option<PathBuf> {
        let name = network.name;
        [
            format!("{name}/{WEIGHTS_FILE}"),
            format!("checkpoints/{name}/{WEIGHTS_FILE}"),
        ]
        .iter()
        .find_map(|file| self.file_of(network, file))
    }

    /// As [`find()`].
    ///
    /// # Errors
    ///
    /// As [`find()`].
    pub fn find(&self, network: &'static Network, given: Option<&Path>) -> Result<Found> {
        let found = match given {
            Some(path) => Found::open(path, Place::Given)?,
            None => match self.folder(network).filter(|folder| folder.exists()) {
                Some(folder) => Found::open(&folder, Place::Models)?,
                None => match self.cached(network) {
                    Some(weights) => Found::open(&weights, Place::HubCache)?,
                    None => return Err(self.nothing(network)),
                },
            },
        };
        if found.network != network {
            return Err(Error::file(
                &found.weights,
                format!(
                    "weights of {}, not of {}",
                    found.network.title, network.title
                ),
                format!(
                    "give weights of {}, or ask for {}",
                    network.name, found.network.name
                ),
            ));
        }
        Ok(found)
    }

    /// Exactly what to get and where to put it.
    fn nothing(&self, network: &Network) -> Error {
        let looked = match (&self.models, &self.cache) {
            (Some(models), _) => format!("{} has no folder {}", models.display(), network.name),
            (None, _) => format!("{MODELS} is not set"),
        };
        let cached = match &self.cache {
            Some(cache) => format!("nothing in {}", cache.path().display()),
            None => "no cache of Hugging Face".to_owned(),
        };
        Error::request(
            format!(
                "no weights of {} are found: {looked}, {cached}",
                network.title
            ),
            self.how_to_have(network),
        )
    }

    /// What to do to have the weights of `network`: which file to get from where, under which licence, and how to
    /// convert it.
    pub fn how_to_have(&self, network: &Network) -> String {
        match network.folder {
            Some(folder) => self.how_to_get_all(network, folder),
            None => self.how_to_get(network),
        }
    }

    /// What to do to have a network that is published by itself.
    fn how_to_get(&self, network: &Network) -> String {
        let target = match self.folder(network) {
            Some(folder) => folder.display().to_string(),
            None => format!("MODELS/{}", network.name),
        };
        let export = self.export();
        match self.published(network) {
            Some(file) => format!(
                "its checkpoint is there: `tid3r weights convert {} -o {target}`{export}",
                file.display()
            ),
            None => {
                let file = network.files[0];
                let name = file.rsplit('/').next().unwrap_or(file);
                let (also, with) = match network.beside {
                    Some(Beside { file, source }) => (
                        format!(" and {file} from {source}"),
                        format!(" --with {file}"),
                    ),
                    None => (String::new(), String::new()),
                };
                format!(
                    "get {file} from {}{also} (licence: {}), then `tid3r weights convert {name}{with} -o {target}`{export}",
                    network.source, network.licence
                )
            }
        }
    }

    /// What to do to have a network that is published in a folder with others.
    fn how_to_get_all(&self, network: &Network, folder: &str) -> String {
        let target = match &self.models {
            Some(models) => models.display().to_string(),
            None => "MODELS".to_owned(),
        };
        let export = self.export();
        match self.repository_with(network) {
            Some(repository) => format!(
                "its checkpoint is there: `tid3r weights convert {} -o {target}`{export}",
                repository.root().display()
            ),
            None => {
                let name = folder.rsplit('/').next().unwrap_or(folder);
                format!(
                    "get {folder} from {} (licence: {}), then `tid3r weights convert {name} -o {target}`{export}",
                    network.source, network.licence
                )
            }
        }
    }

    /// The published folder in which the checkpoint of `network` is, if it is here: where converted weights
    /// should be, or in the local cache of Hugging Face.
    pub fn repository_with(&self, network: &Network) -> Option<Repository> {
        let cached = || {
            let file = self.published(network)?;
            let depth = network.place()?.components().count() + 1;
            Some(file.ancestors().nth(depth)?.to_path_buf())
        };
        let places = self.models.clone().into_iter().chain(cached());
        let mut repositories = places.filter_map(|place| Repository::at(&place));
        repositories.find(|repository| repository.networks().any(|other| other == network))
    }

    /// What to set so that converted weights are found.
    fn export(&self) -> String {
        match self.models {
            Some(_) => String::new(),
            None => format!(" and set {MODELS}=MODELS"),
        }
    }
}
