//! The files beside a checkpoint that say what it does not: its own `config.json`, and those of the
//! pipeline's other parts, in folders beside its own or above.
//!
//! They are what anybody may have written: short files are read as JSON, and every value is checked
//! where it is used.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use tid3r_models::see3d::clip::Tokenizer;

use super::config::Preprocessor;
use crate::error::{excerpt, first_line, shortened};
use crate::{CONFIG_FILE, Error, Result};

/// The longest file that is read, in bytes. Those that are published have some kilobytes.
const LONGEST: u64 = 1 << 20;
/// How many folders above that of a checkpoint are looked into: a UNet is three below the pipeline's.
const HIGHEST: usize = 3;

const REMEDY: &str = "get it again, as it is published beside the weights";

/// A JSON file, and what it says.
pub(super) struct Beside {
    path: PathBuf,
    object: Map<String, Value>,
}

impl Beside {
    /// The `config.json` of the checkpoint at `checkpoint`.
    pub(super) fn config(checkpoint: &Path) -> Result<Self> {
        let path = checkpoint.with_file_name(CONFIG_FILE);
        if !path.is_file() {
            return Err(Error::file(
                checkpoint,
                format!("no {CONFIG_FILE} is beside it, without which it cannot be understood"),
                "give the checkpoint in the folder in which it is published",
            ));
        }
        Self::read(path)
    }

    /// The file of this name in the folder of the pipeline that `checkpoint` is a part of, or beside it.
    pub(super) fn named(name: &str, checkpoint: &Path) -> Result<Option<Self>> {
        above(checkpoint, name, Path::is_file)
            .map(Self::read)
            .transpose()
    }

    fn read(path: PathBuf) -> Result<Self> {
        let length = fs::metadata(&path).map_err(Error::io("read", &path))?.len();
        if length > LONGEST {
            return Err(Error::file(&path, "too long for a configuration", REMEDY));
        }
        let text = fs::read(&path).map_err(Error::io("read", &path))?;
        match serde_json::from_slice(&text) {
            Ok(Value::Object(object)) => Ok(Self { path, object }),
            Ok(_) => Err(Error::file(&path, "not a JSON object", REMEDY)),
            Err(e) => {
                let problem = format!("not JSON: {}", excerpt(&e.to_string()));
                Err(Error::file(&path, problem, REMEDY))
            }
        }
    }

    /// What it says.
    pub(super) fn object(&self) -> &Map<String, Value> {
        &self.object
    }

    /// The same, as a value.
    pub(super) fn value(&self) -> Value {
        Value::Object(self.object.clone())
    }

    /// What it says, as a `C`.
    pub(super) fn parse<C: DeserializeOwned>(&self) -> Result<C> {
        C::deserialize(&self.object).map_err(|e| self.refuse(&e.to_string()))
    }

    /// An error about it.
    pub(super) fn refuse(&self, problem: &str) -> Error {
        // It may quote the file.
        Error::file(&self.path, shortened(problem, 300), REMEDY)
    }
}

/// What is called `name` beside the checkpoint or in a folder above, the nearest first.
fn above(checkpoint: &Path, name: &str, is_it: fn(&Path) -> bool) -> Option<PathBuf> {
    let checkpoint = std::path::absolute(checkpoint).ok()?;
    let folders = checkpoint.ancestors().skip(1).take(1 + HIGHEST);
    let mut paths = folders.map(|folder| folder.join(name));
    paths.find(|path| is_it(path))
}

/// The empty text as numbers of tokens, by the tokenizer that is published with the text encoder;
/// `None` if it is not there.
pub(super) fn empty_prompt(checkpoint: &Path) -> Result<Option<Vec<u32>>> {
    let Some(folder) = above(checkpoint, "tokenizer", Path::is_dir) else {
        return Ok(None);
    };
    let tokens = Tokenizer::open(&folder).and_then(|tokenizer| tokenizer.encode(""));
    tokens.map(Some).map_err(|e| {
        let problem = excerpt(&first_line(&e));
        Error::file(&folder, format!("no tokenizer: {problem}"), REMEDY)
    })
}

/// How pictures are prepared, by the `preprocessor_config.json` that is published with the image
/// encoder; `None` if it is not there.
pub(super) fn preprocessor(checkpoint: &Path) -> Result<Option<Preprocessor>> {
    const NAME: &str = "preprocessor_config.json";
    let file = match Beside::named(NAME, checkpoint)? {
        Some(file) => file,
        None => match Beside::named(&format!("feature_extractor/{NAME}"), checkpoint)? {
            Some(file) => file,
            None => return Ok(None),
        },
    };
    let processor: Processor = file.parse()?;
    processor
        .checked()
        .map(Some)
        .map_err(|problem| file.refuse(&problem))
}

/// What the file says, as far as it matters. Values that are absent are the library's.
#[derive(Deserialize)]
#[serde(default)]
struct Processor {
    do_resize: bool,
    size: Extent,
    resample: u32,
    do_center_crop: bool,
    crop_size: Extent,
    do_normalize: bool,
    image_mean: [f32; 3],
    image_std: [f32; 3],
}

impl Default for Processor {
    fn default() -> Self {
        let usual = Preprocessor::of_side(224);
        Self {
            do_resize: true,
            size: Extent::Side(usual.shortest_edge),
            resample: BICUBIC,
            do_center_crop: true,
            crop_size: Extent::Side(usual.shortest_edge),
            do_normalize: true,
            image_mean: usual.mean,
            image_std: usual.std,
        }
    }
}

/// Pillow's number of the bicubic filter.
const BICUBIC: u32 = 3;

/// A size in one of the ways in which it is written.
#[derive(Deserialize)]
#[serde(untagged)]
enum Extent {
    /// Of the shorter side to be resized to, or of a square to be cut out.
    Side(usize),
    Shorter {
        shortest_edge: usize,
    },
    Both {
        height: usize,
        width: usize,
    },
}

impl Processor {
    /// What is done, if nothing else is: no other way is known here.
    fn checked(self) -> Result<Preprocessor, String> {
        /// The longest side of a picture.
        const MOST: usize = 1 << 12;
        for (does, what) in [
            (self.do_resize, "do_resize"),
            (self.do_center_crop, "do_center_crop"),
            (self.do_normalize, "do_normalize"),
        ] {
            if !does {
                return Err(format!("{what} is false, where only true is known"));
            }
        }
        if self.resample != BICUBIC {
            let filter = self.resample;
            return Err(format!(
                "resample is {filter}, where only {BICUBIC} (bicubic) is known"
            ));
        }
        let shortest_edge = match self.size {
            Extent::Side(side)
            | Extent::Shorter {
                shortest_edge: side,
            } => side,
            Extent::Both { .. } => return Err("size is not that of the shorter side".to_owned()),
        };
        let crop = match self.crop_size {
            Extent::Side(side) => [side; 2],
            Extent::Both { height, width } => [height, width],
            Extent::Shorter { .. } => return Err("crop_size has no height and width".to_owned()),
        };
        if crop.contains(&0)
            || crop.iter().any(|&side| side > shortest_edge)
            || shortest_edge > MOST
        {
            return Err(format!(
                "a picture with a shorter side of {shortest_edge} pixels cannot be cut to {crop:?}"
            ));
        }
        let numbers = self.image_mean.iter().chain(&self.image_std);
        if !numbers.clone().all(|value| value.is_finite())
            || self.image_std.iter().any(|&std| std <= 0.0)
        {
            return Err("image_mean or image_std is no number to normalise with".to_owned());
        }
        Ok(Preprocessor {
            shortest_edge,
            crop,
            mean: self.image_mean,
            std: self.image_std,
        })
    }
}
