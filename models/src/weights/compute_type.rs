//! What layers compute with.

use std::fmt;
use std::str::FromStr;

use candle_core::{DType, Device};
use serde::{Deserialize, Serialize};

use crate::nn::cpu::kernels_fit;

/// The type of the numbers that layers multiply. Sums, norms, softmaxes and whatever passes from one
/// layer to the next are in f32 in any case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ComputeType {
    /// Single precision.
    #[default]
    F32,
    /// The upper half of single precision: its range, and 8 significant bits.
    Bf16,
    /// Half precision: 11 significant bits, but no number beyond 65504. For GPUs: kernels of the CPU multiply in f32
    /// all the same.
    F16,
}

impl ComputeType {
    /// Every type, the default first.
    pub const ALL: [Self; 3] = [Self::F32, Self::Bf16, Self::F16];

    /// Whether layers on `device` compute with it: f16 is for where candle's operations do.
    pub fn fits(self, device: &Device) -> bool {
        self != Self::F16 || !kernels_fit(device)
    }

    /// Whether it is what layers compute with unless something else is asked for.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// What candle calls it.
    pub(crate) fn dtype(self) -> DType {
        match self {
            Self::F32 => DType::F32,
            Self::Bf16 => DType::BF16,
            Self::F16 => DType::F16,
        }
    }

    /// Bytes of a weight that is laid out for a kernel.
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::Bf16 | Self::F16 => 2,
        }
    }

    /// What people call it: what [`Self::from_str`] takes.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bf16 => "bf16",
            Self::F16 => "f16",
        }
    }
}

impl fmt::Display for ComputeType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for ComputeType {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let named = Self::ALL.into_iter().find(|of| of.name() == text);
        named.ok_or_else(|| format!("'{text}' is neither f32, bf16 nor f16"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for of in ComputeType::ALL {
            assert_eq!(of.to_string().parse(), Ok(of));
            let written = serde_json::to_string(&of).unwrap();
            assert_eq!(written, format!("\"{of}\""));
        }
        assert_eq!(ComputeType::default(), ComputeType::F32);
        assert!("f64".parse::<ComputeType>().is_err());
    }

    #[test]
    fn kernels_leave_f16_to_gpus() {
        let [f32, bf16, f16] = ComputeType::ALL.map(|of| of.fits(&Device::Cpu));
        assert!(f32 && bf16 && !f16);
    }
}
