//! Activation functions.

use candle_core::{Result, Tensor};

use super::cpu::{self, HostTensor, Isa};

/// What a layer does to each of its outputs, element by element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    Identity,
    /// The exact GELU, `x Phi(x)` with the normal distribution function `Phi` (Hendrycks and Gimpel
    /// 2016): PyTorch's default, not the approximation by tanh.
    Gelu,
    /// GELU's approximation by tanh, `x / 2 (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3)))`.
    GeluTanh,
    /// `max(x, 0)`.
    Relu,
    /// `scale x` above 0, `scale alpha (exp(x) - 1)` below (Klambauer et al. 2017).
    Selu,
    /// `x / (1 + exp(-x))`, also called swish.
    Silu,
}

impl Activation {
    /// SELU's factor for all `x`.
    pub const SELU_SCALE: f64 = 1.050_700_987_355_480_5;
    /// SELU's factor below 0.
    pub const SELU_ALPHA: f64 = 1.673_263_242_354_377_2;

    /// The activation of each element of `x`.
    ///
    /// # Errors
    ///
    /// If `x` holds integers.
    pub fn apply(self, x: &Tensor) -> Result<Tensor> {
        if self != Self::Identity && HostTensor::fits(x) {
            cpu::activation(Isa::current()?, self, x)
        } else {
            self.plain(x)
        }
    }

    /// The activation by candle's own operations.
    pub(super) fn plain(self, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::Identity => Ok(x.clone()),
            Self::Gelu => x.gelu_erf(),
            Self::GeluTanh => x.gelu(),
            Self::Relu => x.relu(),
            Self::Selu => x.elu(Self::SELU_ALPHA)? * Self::SELU_SCALE,
            Self::Silu => x.silu(),
        }
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use proptest::prelude::*;

    use super::*;

    fn check(activation: Activation, want: [f32; 5]) {
        let x = Tensor::new(&[-2.0_f32, -1.0, 0.0, 1.0, 2.0], &Device::Cpu).unwrap();
        let got = activation.apply(&x).unwrap().to_vec1::<f32>().unwrap();
        for (got, want) in got.iter().zip(want) {
            assert!((got - want).abs() < 1e-6, "{activation:?}: {got} {want}");
        }
    }

    #[test]
    fn by_table() {
        check(Activation::Identity, [-2.0, -1.0, 0.0, 1.0, 2.0]);
        check(Activation::Relu, [0.0, 0.0, 0.0, 1.0, 2.0]);
        // x Phi(x) from a table of Phi; by tanh, 2 gives 1.954598.
        let gelu = [-0.045_500_264, -0.158_655_25, 0.0, 0.841_344_8, 1.954_499_7];
        check(Activation::Gelu, gelu);
        let selu = [-1.520_166_5, -1.111_330_7, 0.0, 1.050_701, 2.101_402];
        check(Activation::Selu, selu);
        let gelu_tanh = [-0.045_402_3, -0.158_808, 0.0, 0.841_192, 1.954_597_7];
        check(Activation::GeluTanh, gelu_tanh);
        let silu = [-0.238_405_84, -0.268_941_42, 0.0, 0.731_058_6, 1.761_594_2];
        check(Activation::Silu, silu);
    }

    proptest! {
        #[test]
        fn as_by_candle(x in prop::collection::vec(-12.0_f32..12.0, 0..70)) {
            let x = Tensor::from_vec(x.clone(), x.len(), &Device::Cpu).unwrap();
            for activation in [
                Activation::Gelu,
                Activation::GeluTanh,
                Activation::Relu,
                Activation::Selu,
                Activation::Silu,
            ] {
                let want = activation.plain(&x).unwrap().to_vec1::<f32>().unwrap();
                for isa in Isa::available() {
                    let got = cpu::activation(isa, activation, &x).unwrap();
                    for (got, want) in got.to_vec1::<f32>().unwrap().iter().zip(&want) {
                        // SELU subtracts 1 from what may be next to it.
                        let bound = 2e-7 + 3e-7 * want.abs();
                        prop_assert!((got - want).abs() < bound, "{isa}: {got} {want}");
                    }
                }
            }
        }
    }

    #[test]
    fn infinities_and_nan_pass() {
        let x = Tensor::new(&[f32::INFINITY, f32::NAN, f32::NEG_INFINITY], &Device::Cpu).unwrap();
        for isa in Isa::available() {
            let of = |activation| {
                let y = cpu::activation(isa, activation, &x).unwrap();
                y.to_vec1::<f32>().unwrap()
            };
            for activation in [
                Activation::Gelu,
                Activation::GeluTanh,
                Activation::Relu,
                Activation::Selu,
                Activation::Silu,
            ] {
                let y = of(activation);
                assert!(y[1].is_nan(), "{isa}: {activation:?} {y:?}");
                assert_eq!(y[0], f32::INFINITY, "{isa}: {activation:?}");
            }
            assert!(of(Activation::Gelu)[2].abs() < 1e-13, "{isa}");
            assert_eq!(of(Activation::Relu)[2], 0.0);
            assert!((of(Activation::Selu)[2] + 1.758_099_3).abs() < 1e-6);
            assert_eq!(of(Activation::Selu)[0], f32::INFINITY);
        }
    }
}
