//! One recorded case.

use anyhow::{Context, Result, anyhow, bail};
use candle_core::{Device, Tensor, safetensors};
use serde::{Deserialize, de::DeserializeOwned};
use serde_json::Value;
use std::{
    collections::{BTreeMap, HashMap},
    env, fs,
    path::{Path, PathBuf},
    sync::OnceLock,
};
use tempfile::TempDir;
use tid3r_models::{ComputeType, Weights, device::Place};
use tid3r_weights_convert::{
    Checkpoint, Config, ConvertOptions, Found, Repository, WEIGHTS_FILE, convert, network_of, synth,
};

/// The largest relative L2 error of any recorded tensor of a network that computes in bf16. Rounding a number
/// to that costs up to 1/256 of it.
const IN_BF16: f64 = 4e-2;
/// The same for detectors: the small made-up one makes errors of its first layers thirty times as large. The
/// one of full size stays below 1e-2.
const IN_BF16_DETECTOR: f64 = 0.15;
/// The same two in f16, which is eight times as precise.
const IN_F16: f64 = 5e-3;
const IN_F16_DETECTOR: f64 = 0.02;

/// Where weights and inputs are: what `PARITY_DEVICE` says, as in `cuda`, or else the CPU.
pub(crate) fn device() -> Result<&'static Device> {
    static DEVICE: OnceLock<Result<Device, String>> = OnceLock::new();
    let opened = DEVICE.get_or_init(|| {
        let place: Place = match env::var("PARITY_DEVICE") {
            Ok(name) => name.parse()?,
            Err(_) => Place::Cpu,
        };
        place.open().map_err(|error| error.to_string())
    });
    opened.as_ref().map_err(|problem| anyhow!("{problem}"))
}

/// One recorded case.
pub(crate) struct Case {
    folder: PathBuf,
    file: CaseFile,
    inputs: HashMap<String, Tensor>,
    expected: BTreeMap<String, Tensor>,
    compute_type: ComputeType,
}

#[derive(Deserialize)]
struct CaseFile {
    model: String,
    config: Value,
    weights: WeightsOf,
    tolerance: Option<Tolerance>,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum WeightsOf {
    /// `None` where nothing has weights.
    SyntheticSeed(Option<u64>),
    File(PathBuf),
}

/// What is done to synthetic weights so that a deep network's result does not come out constant.
#[derive(Deserialize)]
struct Gains {
    #[serde(default)]
    weight_gains: Vec<Gain>,
    #[serde(default)]
    not_synthesised: Vec<String>,
}

#[derive(Clone, Deserialize)]
struct Gain {
    suffix: String,
    factor: f32,
}

/// Synthetic weights, with the gains in `config`; the bins of a box's sides are their own numbers
/// wherever `config` says that something is not made up.
fn synthetic(config: &Value, seed: u64) -> Result<Weights> {
    let gains: Gains = serde_json::from_value(config.clone()).context("the gains")?;
    let values = move |name: &str, shape: &[usize]| {
        if !gains.not_synthesised.is_empty() && name.ends_with("dfl.conv.weight") {
            return (0..shape.iter().product())
                .map(|bin: usize| bin as f32)
                .collect();
        }
        let mut values = synth::tensor(name, shape, seed);
        for gain in gains
            .weight_gains
            .iter()
            .filter(|gain| name.ends_with(&gain.suffix))
        {
            values.iter_mut().for_each(|value| *value *= gain.factor);
        }
        values
    };
    Ok(Weights::from_fn(values, device()?))
}

/// Converted networks, each in a folder of its name.
pub(crate) struct Converted {
    folder: TempDir,
}

impl Converted {
    /// The folder of their folders.
    pub(crate) fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The configuration and the weights of the network called `name`.
    pub(crate) fn network(&self, name: &str) -> Result<(Config, Weights)> {
        let found = Found::at(&self.folder().join(name))?;
        Ok((found.file.config, Weights::open(&found.weights, device()?)?))
    }
}

#[derive(Deserialize)]
struct Tolerance {
    max_relative_l2: f64,
}

/// The folders at and below `root` that hold a case, in order.
pub(crate) fn folders_below(root: &Path) -> Result<Vec<PathBuf>> {
    let mut folders = Vec::new();
    if root.join("case.json").exists() {
        folders.push(root.to_path_buf());
    }
    let mut entries: Vec<PathBuf> = fs::read_dir(root)?
        .map(|entry| Ok(entry?.path()))
        .collect::<Result<_>>()?;
    entries.sort();
    for entry in entries.iter().filter(|entry| entry.is_dir()) {
        folders.extend(folders_below(entry)?);
    }
    Ok(folders)
}

impl Case {
    /// The case in `folder`.
    pub(crate) fn load(folder: &Path) -> Result<Self> {
        let read = |name: &'static str| fs::read_to_string(folder.join(name)).context(name);
        let tensors = |name: &'static str, device: &Device| {
            safetensors::load(folder.join(name), device).context(name)
        };
        let expected = tensors("expected.safetensors", &Device::Cpu)?;
        Ok(Self {
            folder: folder.to_path_buf(),
            file: serde_json::from_str(&read("case.json")?).context("case.json")?,
            inputs: tensors("inputs.safetensors", device()?)?,
            expected: expected.into_iter().collect(),
            compute_type: ComputeType::F32,
        })
    }

    /// The same, computed with this type.
    pub(crate) fn in_type(self, compute_type: ComputeType) -> Self {
        Self {
            compute_type,
            ..self
        }
    }

    /// Whether it is about a network or a part of one that has synthetic weights.
    pub(crate) fn has_synthetic_weights(&self) -> bool {
        matches!(self.file.weights, WeightsOf::SyntheticSeed(Some(_)))
    }

    /// Which module it is about.
    pub(crate) fn model(&self) -> &str {
        &self.file.model
    }

    /// The configuration; fields that `C` does not have are ignored.
    pub(crate) fn config<C: DeserializeOwned>(&self) -> Result<C> {
        serde_json::from_value(self.file.config.clone()).context("the configuration")
    }

    /// The largest relative L2 error that is allowed: what the case says, else 1e-3 for a whole network
    /// and 1e-4 for a part of one; in 16 bits [`IN_BF16`] and [`IN_F16`].
    pub(crate) fn tolerance(&self) -> f64 {
        match (self.compute_type, self.model(), &self.file.tolerance) {
            (ComputeType::Bf16, "object_aware_yolov8", _) => IN_BF16_DETECTOR,
            (ComputeType::Bf16, ..) => IN_BF16,
            (ComputeType::F16, "object_aware_yolov8", _) => IN_F16_DETECTOR,
            (ComputeType::F16, ..) => IN_F16,
            (ComputeType::F32, _, Some(tolerance)) => tolerance.max_relative_l2,
            (ComputeType::F32, "mvdust3r", None) => 1e-3,
            (ComputeType::F32, _, None) => 1e-4,
        }
    }

    /// The weights: synthetic ones whatever their names, or those of a checkpoint, converted.
    pub(crate) fn weights(&self) -> Result<Weights> {
        match &self.file.weights {
            WeightsOf::SyntheticSeed(_) => {
                Ok(synthetic(&self.file.config, self.seed()?)?.in_type(self.compute_type))
            }
            WeightsOf::File(_) => {
                let folder = tempfile::tempdir()?;
                let source = self.source()?;
                let options = ConvertOptions::default();
                convert(&source, folder.path(), &options, &mut |_| ())?;
                // The mapping outlives the file's name.
                Ok(Weights::open(&folder.path().join(WEIGHTS_FILE), device()?)?)
            }
        }
    }

    /// The networks in the checkpoint or in the folder that the case names, converted.
    pub(crate) fn converted(&self) -> Result<Converted> {
        let source = self.source()?;
        let folder = tempfile::tempdir()?;
        let options = ConvertOptions::default();
        match Repository::at(&source) {
            Some(repository) => {
                repository.convert(folder.path(), &options, &mut |_| ())?;
            }
            None => {
                let network = network_of(&source, &options)?;
                let folder = folder.path().join(network.name);
                convert(&source, &folder, &options, &mut |_| ())?;
            }
        }
        Ok(Converted { folder })
    }

    /// The file or folder that the case has its weights from.
    pub(crate) fn source(&self) -> Result<PathBuf> {
        match &self.file.weights {
            WeightsOf::File(name) => Ok(self.folder.join(name)),
            WeightsOf::SyntheticSeed(_) => bail!("the weights are in no file"),
        }
    }

    /// The weights in the case's checkpoint under the names that they have there, with those that the
    /// network has no use for.
    pub(crate) fn unconverted_weights(&self) -> Result<Weights> {
        let checkpoint = Checkpoint::open(&self.source()?)?;
        let mut values: BTreeMap<String, Vec<f32>> = BTreeMap::new();
        for name in checkpoint.shapes().into_keys() {
            let tensor = values.entry(name.to_string()).or_default();
            // Counters of batches are no real numbers.
            let _ = checkpoint.read(name, |part| {
                tensor.extend_from_slice(part);
                Ok(())
            });
        }
        let make = move |name: &str, _: &[usize]| values.get(name).cloned().unwrap_or_default();
        Ok(Weights::from_fn(make, device()?))
    }

    /// Synthetic weights of the network whose configuration is `config.<part>`: of the same seed as all
    /// others, with the gains of that part.
    pub(crate) fn weights_of(&self, part: &str) -> Result<Weights> {
        synthetic(&self.file.config[part], self.seed()?)
    }

    /// The seed of synthetic weights.
    pub(crate) fn seed(&self) -> Result<u64> {
        match self.file.weights {
            WeightsOf::SyntheticSeed(seed) => seed.context("the case has no weights"),
            WeightsOf::File(_) => bail!("the weights are in a file"),
        }
    }

    /// The input called `name`.
    pub(crate) fn input(&self, name: &str) -> Result<&Tensor> {
        let input = self.inputs.get(name);
        input.with_context(|| format!("the case has no input `{name}`"))
    }

    /// The inputs.
    pub(crate) fn inputs(&self) -> &HashMap<String, Tensor> {
        &self.inputs
    }

    /// The recorded tensors.
    pub(crate) fn expected(&self) -> &BTreeMap<String, Tensor> {
        &self.expected
    }
}
