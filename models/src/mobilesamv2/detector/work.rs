//! How much there is to compute.

use candle_core::Result;

use super::{Config, Detector, STRIDES};

/// Multiply-adds of one run of the network, without mask coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// Of each layer: `layers[i]` is `model.<i>`.
    pub layers: [LayerWork; Self::HEAD + 1],
}

/// Multiply-adds of a layer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LayerWork {
    /// Convolutions as sums over their kernels.
    pub total: f64,
    /// Of these, what fast convolutions save: 3x3 layers of stride 1 compute 36 products for 16 outputs, or fewer,
    /// instead of 144.
    pub saved: f64,
}

impl Work {
    /// The head's number among the layers.
    pub(super) const HEAD: usize = 22;

    /// The work for an image of `height` x `width` pixels.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn new(config: &Config, (height, width): (usize, usize)) -> Result<Self> {
        let mut layers = [LayerWork::default(); Self::HEAD + 1];
        for (name, shape) in Detector::tensors(config)? {
            let mut path = name.split('.').skip(1);
            let (Some(Ok(layer)), &[outputs, inputs, kernel, _]) =
                (path.next().map(str::parse), &shape[..])
            else {
                continue;
            };
            let stride = match layer {
                // Names go on with the branch and the level; `dfl` has no level.
                Self::HEAD => match path.nth(1).and_then(|level| level.parse::<usize>().ok()) {
                    Some(level) => STRIDES[level],
                    None => continue,
                },
                layer => Self::stride(layer),
            };
            let outputs_of_channel = (height / stride) * (width / stride);
            let work = (outputs_of_channel * outputs * inputs * kernel * kernel) as f64;
            layers[layer].total += work;
            if Self::is_fast(&name, &shape) {
                layers[layer].saved += 0.75 * work;
            }
        }
        Ok(Self { layers })
    }

    /// Pixels of the image for one pixel of a layer's result.
    fn stride(layer: usize) -> usize {
        match layer {
            0 => 2,
            1 | 2 => 4,
            3 | 4 | 13..=15 => 8,
            5 | 6 | 10..=12 | 16..=18 => 16,
            _ => 32,
        }
    }

    /// Whether fast convolutions save multiplications with the tensor of this name and shape.
    pub(super) fn is_fast(name: &str, shape: &[usize]) -> bool {
        // Layers that halve the size of a map.
        const HALVING: [&str; 7] = ["0", "1", "3", "5", "7", "16", "19"];
        let layer = name.split('.').nth(1).unwrap_or_default();
        let &[outputs, inputs, 3, _] = shape else {
            return false;
        };
        inputs.min(outputs) >= 32 && !HALVING.contains(&layer)
    }

    /// All of it.
    pub fn total(&self) -> f64 {
        self.layers.iter().map(|layer| layer.total).sum()
    }

    /// All that is left with fast convolutions: what time goes by.
    pub fn computed(&self) -> f64 {
        self.layers.iter().map(LayerWork::computed).sum()
    }
}

impl LayerWork {
    /// What is left with fast convolutions.
    pub fn computed(&self) -> f64 {
        self.total - self.saved
    }
}

#[cfg(test)]
mod tests {
    use super::super::MaskCoefficients;
    use super::*;

    /// In 10^9, to one place.
    fn giga(work: f64) -> f64 {
        (work / 1e8).round() / 10.0
    }

    #[test]
    fn as_measured_on_the_original() {
        // The original computes mask coefficients, too.
        for (scale, [square, wide]) in [
            ((0.33, 0.25, 1024), [13.2, 9.9]),
            ((0.33, 0.5, 1024), [40.4, 30.3]),
            ((0.67, 0.75, 768), [106.8, 80.1]),
            ((1.0, 1.0, 512), [219.6, 164.7]),
            ((1.0, 1.25, 512), [339.7, 254.8]),
        ] {
            let config = Config::scaled(scale, 1, 26, 32);
            let mask = |pixels: usize| -> f64 {
                let tensors = MaskCoefficients::tensors(&config).unwrap();
                let of_tensor = |(name, shape): (&String, &Vec<usize>)| {
                    let level: usize = name.split('.').nth(3).unwrap().parse().unwrap();
                    let weights: usize = shape.iter().product();
                    let is_kernel = shape.len() == 4;
                    let outputs = pixels / STRIDES[level].pow(2);
                    (usize::from(is_kernel) * weights * outputs) as f64
                };
                tensors.iter().map(of_tensor).sum()
            };
            let all = |height, width| {
                let work = Work::new(&config, (height, width)).unwrap();
                giga(work.total() + mask(height * width))
            };
            assert_eq!(all(1024, 1024), square, "{scale:?}");
            assert_eq!(all(768, 1024), wide, "{scale:?}");
        }
    }

    #[test]
    fn layers_by_hand() {
        let work = Work::new(&Config::released(), (768, 1024)).unwrap();
        let [stem, _, c2f, ..] = work.layers;
        assert_eq!(stem.total, (384 * 512 * 27 * 80) as f64);
        assert_eq!(stem.saved, 0.0);
        // 1x1 of 160 to 160 and of 400 to 160, and six 3x3 of 80 to 80.
        let pixels = 192 * 256_usize;
        assert_eq!(
            c2f.computed(),
            (pixels * (160 * 160 + 400 * 160 + 6 * 80 * 80 * 9 / 4)) as f64
        );
        assert_eq!(work.layers[14], LayerWork::default());
    }
}
