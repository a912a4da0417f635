//! What the machine could do at best.

use std::hint::black_box;
use std::time::{Duration, Instant};

use candle_core::Result;
use rayon::prelude::*;

use super::Isa;
use super::isa::Task;
use super::simd::Simd;

/// Multiply-adds of f32 a second, counted as two operations each, that `threads` threads reach
/// together when nothing is read from memory. Takes some 50 ms.
///
/// It is what the instruction set in use can do: a share of it says how good a kernel is.
///
/// # Errors
///
/// If threads cannot be started, or the environment asks for an instruction set that this CPU lacks.
pub fn measured_peak_flops(threads: usize) -> Result<f64> {
    let isa = Isa::current()?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.max(1))
        .build()
        .map_err(candle_core::Error::wrap)?;
    let rates = pool.broadcast(|_| {
        let end = Instant::now() + Duration::from_millis(50);
        let mut best = 0.0_f64;
        // The best of short runs: a thread may be interrupted.
        while Instant::now() < end {
            let start = Instant::now();
            let flops = isa.run(Chains);
            best = best.max(flops / start.elapsed().as_secs_f64());
        }
        best
    });
    Ok(rates.into_par_iter().sum())
}

/// Independent chains of multiply-adds in registers.
struct Chains;

impl Task for Chains {
    /// Number of operations.
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f64 {
        const CHAINS: usize = 12;
        const STEPS: usize = 20_000;
        let factor = simd.splat(black_box(0.5));
        let mut sums = [simd.splat(black_box(1.0)); CHAINS];
        for _ in 0..STEPS {
            for sum in &mut sums {
                *sum = simd.fma(*sum, factor, factor);
            }
        }
        let total = sums
            .into_iter()
            .fold(simd.splat(0.0), |a, b| simd.add(a, b));
        black_box(simd.sum(total));
        (2 * CHAINS * STEPS * S::LANES) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_a_rate() {
        let peak = measured_peak_flops(1).unwrap();
        assert!(peak.is_finite() && peak > 1e6, "{peak}");
    }
}
