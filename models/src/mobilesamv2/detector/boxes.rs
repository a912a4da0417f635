//! Boxes out of the head's maps.

use candle_core::{DType, Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::HeadMaps;
use crate::{Parameter, Weights};

/// What the detector says of one image: a box and scores for each anchor. Anchors are the pixels of the
/// finest map row by row, then those of the next ones.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// (anchors, 4), f32 on the CPU: centre x, centre y, width, height of the box, in pixels of the image
    /// that the network saw, whose corner is (0, 0). They may reach beyond it.
    pub boxes: Tensor,
    /// (anchors, classes), f32 on the CPU: from 0 to 1.
    pub scores: Tensor,
}

impl Prediction {
    /// Reads `maps`, in which a pixel is as many of the image as `strides` say.
    pub(super) fn read(maps: &[HeadMaps; 3], strides: [usize; 3], dfl: &Dfl) -> Result<Self> {
        let (mut boxes, mut scores) = (Vec::new(), Vec::new());
        let mut classes = 0;
        for (maps, stride) in maps.iter().zip(strides) {
            let (batch, height, width, count) = maps.classes.dims4()?;
            if batch != 1 || maps.sides.dims4()?.2 != width || maps.sides.dims4()?.1 != height {
                bail!(
                    "maps of one image are wanted, got {:?} and {:?}",
                    maps.sides.shape(),
                    maps.classes.shape()
                );
            }
            classes = count;
            let sides = dfl.forward(&maps.sides)?.flatten_all()?.to_vec1::<f32>()?;
            let (sides, _) = sides.as_chunks::<4>();
            let stride = stride as f32;
            let anchors = (0..height * width).map(|i| [i % width, i / width]);
            boxes.extend(anchors.zip(sides).flat_map(|(anchor, sides)| {
                let [x, y] = anchor.map(|at| at as f32 + 0.5);
                box_around(x, y, *sides).map(|length| length * stride)
            }));
            let logits = host(&maps.classes)?;
            scores.extend(logits.into_iter().map(logistic));
        }
        let anchors = boxes.len() / 4;
        Ok(Self {
            boxes: Tensor::from_vec(boxes, (anchors, 4), &Device::Cpu)?,
            scores: Tensor::from_vec(scores, (anchors, classes), &Device::Cpu)?,
        })
    }
}

/// Centre, width and height of the box whose sides have these distances from (x, y): left, top, right,
/// bottom.
fn box_around(x: f32, y: f32, [left, top, right, bottom]: [f32; 4]) -> [f32; 4] {
    let ([x1, y1], [x2, y2]) = ([x - left, y - top], [x + right, y + bottom]);
    [(x1 + x2) / 2.0, (y1 + y2) / 2.0, x2 - x1, y2 - y1]
}

fn logistic(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

fn host(x: &Tensor) -> Result<Vec<f32>> {
    let x = x.to_device(&Device::Cpu)?.to_dtype(DType::F32)?;
    x.flatten_all()?.to_vec1()
}

/// Distances from their distribution over bins (Li et al. 2020, generalised focal loss).
#[derive(Clone, Debug)]
pub struct Dfl {
    /// (1, bins, 1, 1): the distance that each bin stands for. 0, 1, 2, .. in all that was trained.
    weight: Parameter,
}

impl Dfl {
    /// Reads `conv.weight`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks it or has it in another shape.
    pub fn new(bins: usize, weights: &Weights) -> Result<Self> {
        Ok(Self {
            weight: weights.get([1, bins, 1, 1], "conv.weight")?,
        })
    }

    /// The distances to the four sides (pixels, 4), f32 on the CPU, of logits `x` (.., 4 * bins), side
    /// after side: the mean of the bins' distances under the softmax of each side's logits.
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let bins = host(&self.weight.tensor()?)?;
        if x.dims().last() != Some(&(4 * bins.len())) {
            bail!(
                "4 sides of {} bins are wanted, got {:?}",
                bins.len(),
                x.shape()
            );
        }
        let logits = host(x)?;
        let sides: Vec<f32> = logits
            .par_chunks(bins.len())
            .with_min_len(256)
            .map(|logits| expectation(logits, &bins))
            .collect();
        let pixels = sides.len() / 4;
        Tensor::from_vec(sides, (pixels, 4), &Device::Cpu)
    }
}

/// The mean of `values` under the softmax of `logits`.
fn expectation(logits: &[f32], values: &[f32]) -> f32 {
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (mut sum, mut weighted) = (0.0, 0.0);
    for (logit, value) in logits.iter().zip(values) {
        let share = (logit - largest).exp();
        sum += share;
        weighted += share * value;
    }
    weighted / sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bins that stand for 0, 1, 2, ..
    fn dfl(bins: usize) -> Dfl {
        let values = |_: &str, shape: &[usize]| (0..shape[1]).map(|bin| bin as f32).collect();
        Dfl::new(bins, &Weights::from_fn(values, &Device::Cpu)).unwrap()
    }

    fn tensor(values: Vec<f32>, shape: &[usize]) -> Tensor {
        Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
    }

    #[test]
    fn distances_are_means_over_bins() {
        // Even; all on bin 2; a quarter and three quarters; so large that only the difference counts.
        let (even, last) = ([1.0; 3], [0.0, 0.0, 200.0]);
        let quarter = [0.0, 3_f32.ln(), -1000.0];
        let large = [1000.0, 1000.0 + 3_f32.ln(), 0.0];
        let x = tensor([even, last, quarter, large].concat(), &[1, 12]);
        let got = dfl(3).forward(&x).unwrap().to_vec2::<f32>().unwrap();
        for (got, want) in got[0].iter().zip([1.0, 2.0, 0.75, 0.75]) {
            assert!((got - want).abs() < 1e-4, "{got} {want}");
        }
        assert!(dfl(4).forward(&x).is_err());
    }

    /// Maps of `height` x `width` pixels with two bins: all distances are 1/2 but that to the right,
    /// which is 1. Of the two classes, the first is as likely as not.
    fn maps(height: usize, width: usize) -> HeadMaps {
        let sides = [0.0, 0.0, 0.0, 0.0, -100.0, 100.0, 0.0, 0.0];
        let pixels = height * width;
        HeadMaps {
            sides: tensor(sides.repeat(pixels), &[1, height, width, 8]),
            classes: tensor([0.0, 3_f32.ln()].repeat(pixels), &[1, height, width, 2]),
        }
    }

    #[test]
    fn anchors_are_centres_of_pixels_row_by_row_level_by_level() {
        let maps = [maps(2, 3), maps(1, 2), maps(1, 1)];
        let prediction = Prediction::read(&maps, [8, 16, 32], &dfl(2)).unwrap();
        let boxes = prediction.boxes.to_vec2::<f32>().unwrap();
        assert_eq!(boxes.len(), 9);
        // The pixel (1, 0) of the finest map reaches from 1 to 2.5 and from 0 to 1, in 8 pixels.
        assert_eq!(boxes[1], [14.0, 4.0, 12.0, 8.0]);
        assert_eq!(boxes[3], [6.0, 12.0, 12.0, 8.0]);
        assert_eq!(boxes[7], [28.0, 8.0, 24.0, 16.0]);
        assert_eq!(boxes[8], [24.0, 16.0, 48.0, 32.0]);
        let scores = prediction.scores.to_vec2::<f32>().unwrap();
        assert_eq!(scores.len(), 9);
        assert_eq!(scores[4][0], 0.5);
        assert!((scores[4][1] - 0.75).abs() < 1e-6);
    }

    #[test]
    fn maps_that_do_not_belong_together_are_refused() {
        let mixed = HeadMaps {
            sides: maps(2, 3).sides,
            classes: maps(3, 2).classes,
        };
        let maps = [maps(1, 1), mixed, maps(1, 1)];
        assert!(Prediction::read(&maps, [8, 16, 32], &dfl(2)).is_err());
    }
}
