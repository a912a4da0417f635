//! Parity with an original network: recorded cases, and the comparison.
//!
//! A case is a folder in `tests/fixtures/reference` with `case.json` (configuration, seed of the
//! weights, tolerance), `inputs.safetensors` and `expected.safetensors`. A test loads it, builds
//! what it tests from [`Case::config`] and [`Case::weights`], runs it on [`Case::input`], gives
//! each tensor that it got to [`Parity::check`], and ends with [`Parity::finish`].

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use candle_core::{DType, Device, Result, Shape, Tensor};
use candle_nn::var_builder::SimpleBackend;
use candle_nn::{Init, VarBuilder};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use tid3r_weights_convert::synth;

/// A file or folder among the recorded ones.
pub(crate) fn reference(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/fixtures/reference")
        .join(name)
}

/// One recorded case.
pub(crate) struct Case {
    name: String,
    config: serde_json::Value,
    seed: u64,
    tolerance: f64,
    inputs: HashMap<String, Tensor>,
    expected: BTreeMap<String, Tensor>,
}

#[derive(Deserialize)]
struct CaseFile {
    config: serde_json::Value,
    weights: Weights,
    tolerance: Tolerance,
}

#[derive(Deserialize)]
struct Weights {
    synthetic_seed: u64,
}

#[derive(Deserialize)]
struct Tolerance {
    max_relative_l2: f64,
}

impl Case {
    /// The case called `name`: `network/case`.
    pub(crate) fn load(name: &str) -> Self {
        let folder = reference(name);
        let text = std::fs::read_to_string(folder.join("case.json")).unwrap();
        let case: CaseFile = serde_json::from_str(&text).unwrap();
        let tensors =
            |file| candle_core::safetensors::load(folder.join(file), &Device::Cpu).unwrap();
        Self {
            name: name.to_owned(),
            config: case.config,
            seed: case.weights.synthetic_seed,
            tolerance: case.tolerance.max_relative_l2,
            inputs: tensors("inputs.safetensors"),
            expected: tensors("expected.safetensors").into_iter().collect(),
        }
    }

    /// The case's configuration; fields that `C` does not have are ignored.
    pub(crate) fn config<C: DeserializeOwned>(&self) -> C {
        serde_json::from_value(self.config.clone()).unwrap()
    }

    /// The case's weights, whatever their names.
    pub(crate) fn weights(&self) -> VarBuilder<'static> {
        let backend = Synthetic { seed: self.seed };
        VarBuilder::from_backend(Box::new(backend), DType::F32, Device::Cpu)
    }

    /// The input called `name`.
    pub(crate) fn input(&self, name: &str) -> &Tensor {
        &self.inputs[name]
    }

    /// The recorded tensor called `name`.
    pub(crate) fn expected(&self, name: &str) -> &Tensor {
        &self.expected[name]
    }

    /// The input called `name`, positions (batch, tokens, 2), as one list for each item.
    pub(crate) fn positions(&self, name: &str) -> Vec<Vec<[u32; 2]>> {
        let items = self.input(name).to_dtype(DType::U32).unwrap();
        items
            .to_vec3::<u32>()
            .unwrap()
            .iter()
            .map(|item| item.iter().map(|p| [p[0], p[1]]).collect())
            .collect()
    }

    /// Begins a comparison with what this case expects.
    pub(crate) fn parity(&self) -> Parity<'_> {
        Parity {
            case: self,
            outcomes: BTreeMap::new(),
        }
    }
}

/// What came of comparing tensors with those of a case.
pub(crate) struct Parity<'a> {
    case: &'a Case,
    /// By name: the relative L2 error, or why there is none.
    outcomes: BTreeMap<String, std::result::Result<f64, String>>,
}

impl Parity<'_> {
    /// Whether the case expects a tensor of this name: cases record a selection.
    pub(crate) fn expects(&self, name: &str) -> bool {
        self.case.expected.contains_key(name)
    }

    /// Compares `got` with the expected tensor called `name`.
    pub(crate) fn check(&mut self, name: &str, got: &Tensor) {
        let outcome = match self.case.expected.get(name) {
            Some(want) => relative_l2(got, want),
            None => Err("the case expects no such tensor".to_owned()),
        };
        self.outcomes.insert(name.to_owned(), outcome);
    }

    /// The largest relative L2 error; or a report, if a tensor is too far off or if one of those
    /// expected that are in the `scope` of the test was not compared.
    pub(crate) fn finish(self, scope: impl Fn(&str) -> bool) -> std::result::Result<f64, String> {
        let mut report = String::new();
        let mut worst = 0.0_f64;
        for name in self.case.expected.keys().filter(|name| scope(name)) {
            if !self.outcomes.contains_key(name) {
                report += &format!("\n  {name}: not compared");
            }
        }
        for (name, outcome) in &self.outcomes {
            match outcome {
                Ok(error) if *error <= self.case.tolerance => worst = worst.max(*error),
                Ok(error) => report += &format!("\n  {name}: relative L2 error {error:.2e}"),
                Err(problem) => report += &format!("\n  {name}: {problem}"),
            }
        }
        let (case, tolerance) = (&self.case.name, self.case.tolerance);
        if self.outcomes.is_empty() {
            report += "\n  nothing was compared";
        }
        if !report.is_empty() {
            return Err(format!("{case} (tolerance {tolerance:.0e}):{report}"));
        }
        let count = self.outcomes.len();
        println!("{case}: {count} tensors, worst relative L2 {worst:.2e} of {tolerance:.0e}");
        Ok(worst)
    }
}

/// `||got - want|| / ||want||`, in f64; an error if the shapes differ or a number is not finite.
fn relative_l2(got: &Tensor, want: &Tensor) -> std::result::Result<f64, String> {
    if got.dims() != want.dims() {
        return Err(format!(
            "shape {:?}, expected {:?}",
            got.dims(),
            want.dims()
        ));
    }
    let values = |x: &Tensor| {
        let x = x.flatten_all().unwrap().to_dtype(DType::F64).unwrap();
        x.to_vec1::<f64>().unwrap()
    };
    let (got, want) = (values(got), values(want));
    if !got.iter().all(|v| v.is_finite()) {
        return Err("holds NaN or infinity".to_owned());
    }
    let norm = |it: &mut dyn Iterator<Item = f64>| it.map(|v| v * v).sum::<f64>().sqrt();
    let error = norm(&mut got.iter().zip(&want).map(|(g, w)| g - w));
    if error == 0.0 {
        return Ok(0.0);
    }
    Ok(error / norm(&mut want.iter().copied()))
}

/// Weights made up on demand, from the name and the shape that the network asks for.
struct Synthetic {
    seed: u64,
}

impl SimpleBackend for Synthetic {
    fn get(
        &self,
        shape: Shape,
        name: &str,
        _: Init,
        dtype: DType,
        device: &Device,
    ) -> Result<Tensor> {
        let values = synth::tensor(name, shape.dims(), self.seed);
        Tensor::from_vec(values, shape, device)?.to_dtype(dtype)
    }

    fn get_unchecked(&self, name: &str, _: DType, _: &Device) -> Result<Tensor> {
        candle_core::bail!("a synthetic weight needs a shape: {name}")
    }

    fn contains_tensor(&self, _: &str) -> bool {
        true
    }
}
