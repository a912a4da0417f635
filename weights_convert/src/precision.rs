//! Types of numbers in which weights are kept.

use std::fmt;
use std::str::FromStr;

use half::{bf16, f16};
use safetensors::Dtype;
use serde::Serialize;

/// The type of the numbers in a converted file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32 bits: as published.
    #[default]
    F32,
    /// 16 bits, 11 of precision: half the size.
    F16,
    /// 16 bits, 8 of precision, with the range of f32.
    Bf16,
}

impl Precision {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::F32, Self::F16, Self::Bf16];

    /// As the file format calls it.
    pub(crate) fn dtype(self) -> Dtype {
        match self {
            Self::F32 => Dtype::F32,
            Self::F16 => Dtype::F16,
            Self::Bf16 => Dtype::BF16,
        }
    }

    /// The precision of numbers of type `dtype`, if there is one.
    pub(crate) fn of(dtype: Dtype) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|precision| precision.dtype() == dtype)
    }

    /// Writes `values` to the end of `bytes`, little-endian, rounded to nearest, ties to even.
    ///
    /// # Errors
    ///
    /// With the index of the first value that is too large, which would become infinite.
    pub(crate) fn encode(self, values: &[f32], bytes: &mut Vec<u8>) -> Result<(), usize> {
        match self {
            Self::F32 => values
                .iter()
                .for_each(|value| bytes.extend(value.to_le_bytes())),
            Self::F16 => {
                for (index, &value) in values.iter().enumerate() {
                    let half = f16::from_f32(value);
                    bytes.extend(half.to_le_bytes());
                    if half.is_infinite() {
                        return Err(index);
                    }
                }
            }
            Self::Bf16 => {
                for (index, &value) in values.iter().enumerate() {
                    let half = bf16::from_f32(value);
                    bytes.extend(half.to_le_bytes());
                    if half.is_infinite() {
                        return Err(index);
                    }
                }
            }
        }
        Ok(())
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Bf16 => "bf16",
        })
    }
}

impl FromStr for Precision {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL
            .into_iter()
            .find(|precision| precision.to_string() == text);
        found.ok_or_else(|| "expected f32, f16 or bf16".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_rounded_to_nearest() {
        let encoded = |precision: Precision, value: f32| {
            let mut bytes = Vec::new();
            precision
                .encode(&[0.0, value], &mut bytes)
                .map(|()| bytes.split_off(bytes.len() / 2))
        };
        assert_eq!(encoded(Precision::F32, 1.5).unwrap(), 1.5_f32.to_le_bytes());
        // 1 + 3 * 2^-11 lies between 1 + 2^-10 and 1 + 2 * 2^-10; the tie goes to the even one.
        let tie = 1.0 + 3.0 / 2048.0;
        assert_eq!(
            encoded(Precision::F16, tie).unwrap(),
            0x3c02_u16.to_le_bytes()
        );
        assert_eq!(
            encoded(Precision::Bf16, 1.0 + 1.0 / 256.0).unwrap(),
            0x3f80_u16.to_le_bytes()
        );
        assert_eq!(
            encoded(Precision::F16, 65504.0).unwrap(),
            0x7bff_u16.to_le_bytes()
        );
        assert_eq!(encoded(Precision::F16, 65520.0), Err(1));
        assert_eq!(encoded(Precision::Bf16, f32::MAX), Err(1));
    }

    #[test]
    fn names_can_be_read_back() {
        for precision in Precision::ALL {
            assert_eq!(precision.to_string().parse(), Ok(precision));
            assert_eq!(Precision::of(precision.dtype()), Some(precision));
        }
        assert!("f64".parse::<Precision>().is_err());
    }
}
