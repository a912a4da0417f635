//! Boxes as tokens, and where an image's places are.

use std::f64::consts::TAU;

use candle_core::{D, DType, Device, Result, Tensor, bail};

use super::PromptEncoderConfig;
use crate::{Parameter, Weights};

/// SAM's prompt encoder, for boxes (the original's `PromptEncoder`).
///
/// Places are encoded by sines and cosines of their coordinates in random directions (Tancik et al.
/// 2020), half of the channels each.
#[derive(Clone, Debug)]
pub struct PromptEncoder {
    config: PromptEncoderConfig,
    /// Directions (2, channels / 2), x first.
    gaussian: Parameter,
    /// What is added to the first and to the second corner of a box, (1, channels) each.
    corners: [Parameter; 2],
    /// (1, channels).
    no_mask: Parameter,
}

impl PromptEncoder {
    /// Reads `pe_layer`, `point_embeddings.2`, `point_embeddings.3` and `no_mask_embed`; what is
    /// there for points and for masks as prompts is not used.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &PromptEncoderConfig, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let channels = config.embed_dim;
        let embedding = |name: &str| weights.pp(name).get([1, channels], "weight");
        let directions = "positional_encoding_gaussian_matrix";
        Ok(Self {
            config: config.clone(),
            gaussian: weights.pp("pe_layer").get([2, channels / 2], directions)?,
            corners: [
                embedding("point_embeddings.2")?,
                embedding("point_embeddings.3")?,
            ],
            no_mask: embedding("no_mask_embed")?,
        })
    }

    /// The tokens (boxes, 2, channels) of the upper left and the lower right corner of each box.
    ///
    /// `boxes` (boxes, 4) are f64: x and y of the two corners, in pixels of the padded image, 0 being
    /// the middle of the first pixel.
    ///
    /// # Errors
    ///
    /// If `boxes` has another shape or type.
    pub fn boxes(&self, boxes: &Tensor) -> Result<Tensor> {
        let &[count, 4] = boxes.dims() else {
            bail!("boxes (boxes, 4) are wanted, got {:?}", boxes.shape());
        };
        if boxes.dtype() != DType::F64 {
            bail!("boxes in f64 are wanted, got {:?}", boxes.dtype());
        }
        let [height, width] = self.config.input_image_size.map(|size| size as f64);
        let places = (boxes.reshape((count, 2, 2))? + 0.5)?
            .broadcast_div(&Tensor::new(&[width, height], boxes.device())?)?
            .to_dtype(DType::F32)?;
        let [first, second] = &self.corners;
        let corners = Tensor::cat(&[first.tensor()?, second.tensor()?], 0)?;
        self.encode(&places.to_device(corners.device())?)?
            .broadcast_add(&corners)
    }

    /// What is added to every place of the image when there is no mask as a prompt, (channels).
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn no_mask(&self) -> Result<Tensor> {
        self.no_mask.tensor()?.flatten_all()
    }

    /// The encodings (height, width, channels) of the middles of the embedding's places.
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn places(&self) -> Result<Tensor> {
        let [height, width] = self.config.image_embedding_size;
        let middle = |i: usize, count: usize| (i as f32 + 0.5) / count as f32;
        let places: Vec<f32> = (0..height * width)
            .flat_map(|i| [middle(i % width, width), middle(i / width, height)])
            .collect();
        let places = Tensor::from_vec(places, (height, width, 2), &Device::Cpu)?;
        self.encode(&places.to_device(self.gaussian.tensor()?.device())?)
    }

    /// The encodings (.., channels) of places (.., 2): x and y, in 0 to 1 over the image.
    fn encode(&self, places: &Tensor) -> Result<Tensor> {
        let places = places.affine(2.0, -1.0)?;
        let directions = self.gaussian.tensor()?;
        let along = |axis: usize| {
            let coordinate = places.narrow(D::Minus1, axis, 1)?;
            coordinate.broadcast_mul(&directions.get(axis)?)
        };
        let angles = ((along(0)? + along(1)?)? * TAU)?;
        Tensor::cat(&[angles.sin()?, angles.cos()?], D::Minus1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One direction along x, and one along y of an eighth; corners are 10 and 20.
    fn encoder() -> PromptEncoder {
        let make = |name: &str, shape: &[usize]| match name {
            "pe_layer.positional_encoding_gaussian_matrix" => vec![1.0, 0.0, 0.0, 0.125],
            "point_embeddings.2.weight" => vec![10.0; 4],
            "point_embeddings.3.weight" => vec![20.0; 4],
            _ => vec![0.5; shape.iter().product()],
        };
        let config = PromptEncoderConfig {
            embed_dim: 4,
            image_embedding_size: [2, 4],
            input_image_size: [32, 64],
        };
        PromptEncoder::new(&config, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn check(got: &Tensor, want: &[f32]) {
        let got = got.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(got.len(), want.len());
        for (got, want) in got.iter().zip(want) {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
    }

    #[test]
    fn boxes_by_hand() {
        // The first corner is at an eighth of the width and three quarters of the height: -3/4 and
        // 1/2, so angles of -3/2 pi and 1/8 pi. The second is in the middle.
        let boxes = Tensor::new(&[[7.5_f64, 23.5, 31.5, 15.5]], &Device::Cpu).unwrap();
        let got = encoder().boxes(&boxes).unwrap();
        assert_eq!(got.dims(), [1, 2, 4]);
        let (sin, cos) = (0.382_683_43, 0.923_879_5);
        let first = [11.0, 10.0 + sin, 10.0, 10.0 + cos];
        check(&got, &[&first[..], &[20.0, 20.0, 21.0, 21.0]].concat());
    }

    #[test]
    fn places_are_the_middles() {
        // Along x: -3/4, -1/4, 1/4, 3/4; along y: -1/2 and 1/2, which are angles of 1/8 pi.
        let got = encoder().places().unwrap();
        assert_eq!(got.dims(), [2, 4, 4]);
        let (sin, cos) = (0.382_683_43, 0.923_879_5);
        let row = |sin: f32| [1.0, -1.0, 1.0, -1.0].map(|x| [x, sin, 0.0, cos]);
        check(&got, [row(-sin), row(sin)].as_flattened().as_flattened());
        check(&encoder().no_mask().unwrap(), &[0.5; 4]);
    }

    #[test]
    fn other_boxes_are_refused() {
        let of = |dtype, columns| {
            let boxes = Tensor::zeros((3, columns), dtype, &Device::Cpu).unwrap();
            encoder().boxes(&boxes)
        };
        assert!(of(DType::F64, 4).is_ok());
        assert!(of(DType::F32, 4).unwrap_err().to_string().contains("f64"));
        assert!(of(DType::F64, 5).is_err());
    }
}
