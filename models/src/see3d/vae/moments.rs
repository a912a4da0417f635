//! Distributions of latents.

use candle_core::{Result, Tensor, bail};

/// What the encoder says about a picture: a normal distribution for each latent.
#[derive(Clone, Debug)]
pub struct Moments {
    /// The network's result (batch, height, width, 2 * channels): means, then logarithms of variances.
    pub parameters: Tensor,
    /// What latents are multiplied with.
    pub scaling_factor: f64,
}

impl Moments {
    /// Bounds of the logarithm of a variance.
    const LOG_VARIANCE: (f64, f64) = (-30.0, 20.0);

    /// The means (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn mean(&self) -> Result<Tensor> {
        self.half(0)
    }

    /// The standard deviations (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn standard_deviation(&self) -> Result<Tensor> {
        let (lowest, highest) = Self::LOG_VARIANCE;
        (self.half(1)?.clamp(lowest, highest)? / 2.0)?.exp()
    }

    /// Latents (batch, height, width, channels) drawn with `noise`, standard normal numbers of the same
    /// shape: `(mean + standard_deviation * noise) * scaling_factor`.
    ///
    /// # Errors
    ///
    /// If `noise` has another shape.
    pub fn latents(&self, noise: &Tensor) -> Result<Tensor> {
        let mean = self.mean()?;
        if noise.dims() != mean.dims() {
            bail!(
                "noise {:?} is wanted, got {:?}",
                mean.shape(),
                noise.shape()
            );
        }
        let noise = noise.to_device(mean.device())?;
        (mean + (self.standard_deviation()? * noise)?)? * self.scaling_factor
    }

    fn half(&self, i: usize) -> Result<Tensor> {
        let channels = self.parameters.dim(3)? / 2;
        self.parameters
            .narrow(3, i * channels, channels)?
            .contiguous()
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn by_hand() {
        // Two places of one channel: variances exp(2 ln 3) = 9 and, clamped, exp(20).
        let values = [1.0, 2.0 * 3.0_f32.ln(), -1.0, 50.0];
        let moments = Moments {
            parameters: Tensor::from_slice(&values, (1, 1, 2, 2), &Device::Cpu).unwrap(),
            scaling_factor: 0.5,
        };
        let noise = Tensor::new(&[2.0_f32, 1.0], &Device::Cpu).unwrap();
        let latents = moments.latents(&noise.reshape((1, 1, 2, 1)).unwrap());
        let latents = latents.unwrap().flatten_all().unwrap();
        let [a, b] = latents.to_vec1::<f32>().unwrap()[..] else {
            panic!("two latents are wanted");
        };
        assert!((a - 3.5).abs() < 1e-6, "{a}");
        let want = (10.0_f32.exp() - 1.0) / 2.0;
        assert!((b / want - 1.0).abs() < 1e-6, "{b} {want}");
        assert!(moments.latents(&noise).is_err());
    }
}
