//! How long networks take.

use candle_core::Result;
use tid3r_models::{ComputeType, nn::cpu::measured_peak_flops};

/// The shares of a processor's best in f32 that a network reaches, by measurement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reached {
    /// In f32, and in bf16 where processors only convert it.
    pub(crate) f32: f64,
    /// In bf16, where processors multiply pairs of it.
    pub(crate) bf16: f64,
}

/// What this machine does in a second.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    /// Operations of f32, at best.
    peak: f64,
    in_pairs: bool,
}

impl Pace {
    /// Measures that with all threads, for networks that compute in `dtype`. Takes some 50 ms.
    ///
    /// # Errors
    /// When the machine cannot be measured.
    pub(crate) fn measured(dtype: ComputeType) -> Result<Self> {
        Ok(Self {
            peak: measured_peak_flops(rayon::current_num_threads())?,
            in_pairs: dtype.is_in_pairs_here()?,
        })
    }

    /// Seconds that so many multiply-adds of a network take, about.
    pub(crate) fn seconds(&self, multiply_adds: f64, reached: Reached) -> f64 {
        let share = match self.in_pairs {
            true => reached.bf16,
            false => reached.f32,
        };
        2.0 * multiply_adds / (share * self.peak)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_are_operations_by_what_is_reached() {
        let reached = Reached {
            f32: 0.5,
            bf16: 0.8,
        };
        let pace = |in_pairs| Pace {
            peak: 1e9,
            in_pairs,
        };
        assert_eq!(pace(false).seconds(1e9, reached), 4.0);
        assert_eq!(pace(true).seconds(1e9, reached), 2.5);
        assert!(!Pace::measured(ComputeType::F32).unwrap().in_pairs);
    }
}
