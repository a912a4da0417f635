//! Tensors beside recorded ones.

use crate::case::Case;
use anyhow::{Result, bail, ensure};
use candle_core::{DType, Tensor};
use serde::Deserialize;
use std::collections::BTreeMap;

/// What came of comparing tensors with those that a case expects.
pub(crate) struct Comparison<'a> {
    case: &'a Case,
    /// By name: a figure for whoever reads the output, or what is wrong.
    outcomes: BTreeMap<String, Result<String>>,
}

impl<'a> Comparison<'a> {
    /// Nothing has been compared yet.
    pub(crate) fn new(case: &'a Case) -> Self {
        Self {
            case,
            outcomes: BTreeMap::new(),
        }
    }

    /// Whether the case expects a tensor of this name: cases record a selection.
    pub(crate) fn expects(&self, name: &str) -> bool {
        self.case.expected().contains_key(name)
    }

    /// Compares `got` with the expected tensor called `name`: floats by their relative L2 error,
    /// integers for equality.
    pub(crate) fn check(&mut self, name: &str, got: &Tensor) {
        let tolerance = self.case.tolerance();
        self.compare(name, got, |got, want, is_float| {
            if !is_float {
                let differing = got.iter().zip(want).filter(|(g, w)| g != w).count();
                ensure!(differing == 0, "{differing} of {} differ", got.len());
                return Ok("equal".to_owned());
            }
            let error = relative_l2(got, want);
            ensure!(
                error <= tolerance,
                "relative L2 error {error:.2e}, allowed {tolerance:.0e}"
            );
            Ok(format!("relative L2 error {error:.2e}"))
        });
    }

    /// Compares `got` with the expected tensor called `name`, if the case expects one.
    pub(crate) fn check_if_expected(&mut self, name: &str, got: &Tensor) {
        if self.expects(name) {
            self.check(name, got);
        }
    }

    /// Compares `got`, if the case expects it, with what was recorded of the tensor called `name`: every
    /// so many elements of it, as `strides` of the configuration say (all without an entry there), and
    /// under `<name>.mean` its mean over all axes but the second.
    pub(crate) fn check_sampled(&mut self, name: &str, got: &Tensor) -> Result<()> {
        #[derive(Deserialize)]
        struct Config {
            #[serde(default)]
            strides: BTreeMap<String, Vec<usize>>,
        }
        let Config { strides } = self.case.config()?;
        if self.expects(name) {
            let of_name = |(pattern, _): &(&String, _)| match pattern.strip_suffix('*') {
                Some(beginning) => name.starts_with(beginning),
                None => *pattern == name,
            };
            let mut sampled = got.clone();
            let steps = strides
                .iter()
                .find(of_name)
                .map_or(&[][..], |(_, steps)| steps);
            for (axis, &step) in steps.iter().enumerate() {
                let places: Vec<u32> = (0..sampled.dim(axis)? as u32).step_by(step).collect();
                let places = Tensor::new(places, sampled.device())?;
                sampled = sampled.contiguous()?.index_select(&places, axis)?;
            }
            self.check(name, &sampled);
        }
        let mean = format!("{name}.mean");
        if self.expects(&mean) {
            let channels = got.transpose(0, 1)?.flatten_from(1)?;
            self.check(&mean, &channels.to_dtype(DType::F64)?.mean(1)?);
        }
        Ok(())
    }

    /// Compares `got` with the expected tensor called `name`, of which a `share` may differ, each by
    /// at most `step`.
    pub(crate) fn check_all_but(&mut self, name: &str, got: &Tensor, share: f64, step: f64) {
        self.compare(name, got, |got, want, _| {
            let steps = got.iter().zip(want).map(|(g, w)| (g - w).abs());
            let differing = steps.clone().filter(|&step| step > 0.0).count();
            let largest = steps.fold(0.0, f64::max);
            let found = differing as f64 / got.len().max(1) as f64;
            let figures = format!("{:.3} % differ, at most by {largest}", 100.0 * found);
            ensure!(found <= share && largest <= step, "{figures}");
            Ok(figures)
        });
    }

    fn compare(
        &mut self,
        name: &str,
        got: &Tensor,
        judge: impl Fn(&[f64], &[f64], bool) -> Result<String>,
    ) {
        let outcome = || {
            let Some(want) = self.case.expected().get(name) else {
                bail!("the case expects no such tensor");
            };
            let (shape, wanted) = (got.dims(), want.dims());
            ensure!(shape == wanted, "shape {shape:?}, expected {wanted:?}");
            let (got, want_values) = (values(got)?, values(want)?);
            ensure!(got.iter().all(|v| v.is_finite()), "holds NaN or infinity");
            judge(&got, &want_values, want.dtype().is_float())
        };
        let outcome = outcome();
        self.outcomes.insert(name.to_owned(), outcome);
    }

    /// Prints every figure, if they shall be shown.
    ///
    /// An error, a line for each tensor, if one is too far off or was expected and not compared.
    pub(crate) fn finish(self, show: bool) -> Result<()> {
        let mut problems = Vec::new();
        for name in self.case.expected().keys() {
            if !self.outcomes.contains_key(name) {
                problems.push(format!("  {name}: not compared"));
            }
        }
        ensure!(!self.outcomes.is_empty(), "nothing was compared");
        for (name, outcome) in &self.outcomes {
            match outcome {
                Ok(figure) if show => println!("  {name}: {figure}"),
                Ok(_) => {}
                Err(problem) => problems.push(format!("  {name}: {problem}")),
            }
        }
        ensure!(problems.is_empty(), "\n{}", problems.join("\n"));
        Ok(())
    }
}

fn values(x: &Tensor) -> Result<Vec<f64>> {
    Ok(x.flatten_all()?.to_dtype(DType::F64)?.to_vec1()?)
}

/// `||got - want|| / ||want||`; the absolute error where everything wanted is 0.
fn relative_l2(got: &[f64], want: &[f64]) -> f64 {
    let norm = |it: &mut dyn Iterator<Item = f64>| it.map(|v| v * v).sum::<f64>().sqrt();
    let error = norm(&mut got.iter().zip(want).map(|(g, w)| g - w));
    let length = norm(&mut want.iter().copied());
    if length == 0.0 { error } else { error / length }
}
