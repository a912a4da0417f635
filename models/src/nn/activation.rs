//! Activation functions.

use candle_core::{Result, Tensor};

/// The exact GELU, `x Phi(x)` with the normal distribution function `Phi` (Hendrycks and Gimpel
/// 2016), element by element.
///
/// It is PyTorch's default. Not [`Tensor::gelu`], which is the approximation by tanh.
///
/// # Errors
///
/// If `x` holds integers.
pub fn gelu(x: &Tensor) -> Result<Tensor> {
    x.gelu_erf()
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn it_is_the_exact_form() {
        let x = Tensor::new(&[-2.0_f32, -1.0, 0.0, 1.0, 2.0], &Device::Cpu).unwrap();
        let got = gelu(&x).unwrap().to_vec1::<f32>().unwrap();
        // x Phi(x) from a table of Phi; by tanh, 2 gives 1.954598.
        let want = [-0.045_500_264, -0.158_655_25, 0.0, 0.841_344_8, 1.954_499_7];
        for (got, want) in got.iter().zip(want) {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }
}
