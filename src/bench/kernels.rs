//! How much faster the kernels are than candle's own operations.

use super::{failed, median};
use crate::{Error, Result, progress::Progress};
use serde::Serialize;
use std::time::Instant;
use tid3r_models::nn::compare::{Comparison, comparisons};

/// Milliseconds that a measurement takes at least: what is faster is done several times.
const LEAST_MILLISECONDS: f64 = 10.0;

/// How often what seems too slow is measured again: something else may have kept the machine busy.
const AGAIN: usize = 2;

/// A kernel beside candle's operations for the same.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KernelRow {
    /// The layer and its size.
    pub kernel: &'static str,
    /// What the kernel takes: the median of the runs.
    pub milliseconds: f64,
    /// What candle takes, likewise.
    pub candle_milliseconds: f64,
    /// How many times as fast the kernel is.
    pub ratio: f64,
    /// What the ratio must be at least.
    pub floor: f64,
}

impl KernelRow {
    /// Whether the kernel is slower than it must be.
    pub fn is_slow(&self) -> bool {
        // No number is no ratio.
        self.ratio.is_nan() || self.ratio < self.floor
    }
}

/// Measures the kernels, each `runs` times, by turns with candle's operations.
///
/// # Errors
/// When a kernel's result is not that of candle.
pub fn run_kernels(runs: u32, progress: &dyn Progress) -> Result<Vec<KernelRow>> {
    let comparisons = comparisons().map_err(failed)?;
    progress.begin("measuring kernels", comparisons.len());
    let rows = comparisons.iter().map(|comparison| {
        comparison.check().map_err(failed)?;
        let mut row = measure(comparison, runs).map_err(failed)?;
        for _ in 0..AGAIN {
            if !row.is_slow() {
                break;
            }
            row = measure(comparison, runs).map_err(failed)?;
        }
        progress.advance(1);
        Ok(row)
    });
    let rows = rows.collect();
    progress.end();
    rows
}

/// Makes sure that no kernel is slower than it must be.
///
/// # Errors
/// Names those that are.
pub fn check_kernels(rows: &[KernelRow]) -> Result<()> {
    let slow = rows.iter().filter(|row| row.is_slow()).map(|row| {
        let KernelRow {
            kernel,
            ratio,
            floor,
            ..
        } = row;
        format!("{kernel} ({ratio:.2} of {floor:.2})")
    });
    let slow: Vec<_> = slow.collect();
    if slow.is_empty() {
        return Ok(());
    }
    Err(Error::request(
        format!(
            "kernels are slower than they must be beside candle's: {}",
            slow.join(", ")
        ),
        "measure again on an idle machine, and find out what has become of them",
    ))
}

fn measure(comparison: &Comparison, runs: u32) -> candle_core::Result<KernelRow> {
    let ways: [&dyn Fn() -> candle_core::Result<()>; 2] =
        [&|| comparison.by_kernel().map(drop), &|| {
            comparison.by_candle().map(drop)
        }];
    let mut milliseconds = [Vec::new(), Vec::new()];
    for _ in 0..runs {
        for (way, milliseconds) in ways.iter().zip(&mut milliseconds) {
            milliseconds.push(time(way)?);
        }
    }
    let [kernel, candle] = milliseconds.map(|all| median(&all));
    Ok(KernelRow {
        kernel: comparison.name,
        milliseconds: kernel,
        candle_milliseconds: candle,
        ratio: candle / kernel,
        floor: comparison.floor,
    })
}

/// Milliseconds that `work` takes.
fn time(work: &dyn Fn() -> candle_core::Result<()>) -> candle_core::Result<f64> {
    let start = Instant::now();
    let mut times = 0.0;
    loop {
        work()?;
        times += 1.0;
        let milliseconds = 1e3 * start.elapsed().as_secs_f64();
        if milliseconds >= LEAST_MILLISECONDS {
            return Ok(milliseconds / times);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_kernels_are_named() {
        let row = |kernel, ratio| KernelRow {
            kernel,
            milliseconds: 1.0,
            candle_milliseconds: ratio,
            ratio,
            floor: 1.5,
        };
        assert!(check_kernels(&[]).is_ok());
        assert!(check_kernels(&[row("a", 1.5), row("b", 90.0)]).is_ok());
        let rows = [row("a", 1.4), row("b", 2.0), row("c", f64::NAN)];
        let message = check_kernels(&rows).unwrap_err().to_string();
        assert!(message.contains("a (1.40 of 1.50), c ("), "{message}");
        assert!(!message.contains("b ("), "{message}");
    }
}
