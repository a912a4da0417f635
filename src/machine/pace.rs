//! How long networks take.

use super::device;
use candle_core::Result;
use tid3r_models::{ComputeType, device::measured_product_flops, nn::cpu::measured_peak_flops};

/// The shares of a processor's best in f32 that a network reaches, by measurement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reached {
    /// In f32, and in bf16 where processors only convert it.
    pub(crate) f32: f64,
    /// In bf16, where processors multiply pairs of it.
    pub(crate) bf16: f64,
}

/// Of a GPU's best with large products, what networks reach. Nobody has measured it yet.
const REACHED_ON_GPUS: f64 = 0.25;
/// Bytes of weights in a second that are brought to where products find them: rounded at start, or read from a mapped
/// file and laid out as they are used. By measurement; what a GPU takes, nobody has measured.
const LOADED_IN_A_SECOND: f64 = 2.2e9;

/// Seconds that so many bytes of weights take besides the products with them.
pub(crate) fn seconds_to_load(bytes: usize) -> f64 {
    bytes as f64 / LOADED_IN_A_SECOND
}

/// What this machine does in a second.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    /// Operations, at best: of f32 on a CPU, of what networks compute in on a GPU.
    peak: f64,
    kind: Kind,
}

/// Whose pace it is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Cpu,
    /// Of a CPU that multiplies pairs of bf16.
    CpuInPairs,
    Gpu,
}

impl Pace {
    /// Measures that with all threads, for networks that compute in `dtype`. Takes some 50 ms.
    ///
    /// # Errors
    /// When the machine cannot be measured.
    pub(crate) fn measured(dtype: ComputeType) -> Result<Self> {
        if !device().is_cpu() {
            return Ok(Self {
                peak: measured_product_flops(device(), dtype)?,
                kind: Kind::Gpu,
            });
        }
        Ok(Self {
            peak: measured_peak_flops(rayon::current_num_threads())?,
            kind: match dtype.is_in_pairs_here()? {
                true => Kind::CpuInPairs,
                false => Kind::Cpu,
            },
        })
    }

    /// Seconds that so many multiply-adds of a network take, about.
    pub(crate) fn seconds(&self, multiply_adds: f64, reached: Reached) -> f64 {
        let share = match self.kind {
            Kind::Cpu => reached.f32,
            Kind::CpuInPairs => reached.bf16,
            Kind::Gpu => REACHED_ON_GPUS,
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
        let pace = |kind| Pace { peak: 1e9, kind };
        assert_eq!(pace(Kind::Cpu).seconds(1e9, reached), 4.0);
        assert_eq!(pace(Kind::CpuInPairs).seconds(1e9, reached), 2.5);
        assert_eq!(pace(Kind::Gpu).seconds(1e9, reached), 8.0);
        let here = Pace::measured(ComputeType::F32).unwrap();
        assert_eq!(here.kind, Kind::Cpu);
    }
}
