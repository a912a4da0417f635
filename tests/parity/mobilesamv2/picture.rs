//! What the encoders of recorded cases see.

use crate::case::Case;
use anyhow::Result;
use candle_core::{DType, Tensor};
use serde::Deserialize;

/// SAM's normalisation, of values 0 to 255.
const MEAN: [f32; 3] = [123.675, 116.28, 103.53];
const STD: [f32; 3] = [58.395, 57.12, 57.375];

/// The input of an encoder, (1, side, side, 3), from the input `image`: every pixel repeated, then
/// normalised, then zeros to the right and at the bottom.
pub(super) fn network_input(case: &Case) -> Result<Tensor> {
    #[derive(Deserialize)]
    struct Config {
        nearest_upsample: usize,
        #[serde(default = "released_side")]
        pad_to: usize,
    }
    fn released_side() -> usize {
        1024
    }
    let config: Config = case.config()?;
    let image = case.input("image")?.to_dtype(DType::F32)?;
    let (height, width, _) = image.dims3()?;
    let times = config.nearest_upsample;
    let (wide, tall) = (width * times, height * times);
    let constant = |values: [f32; 3]| Tensor::new(&values, image.device());
    Ok(image
        .reshape((height, 1, width, 1, 3))?
        .broadcast_as((height, times, width, times, 3))?
        .reshape((1, tall, wide, 3))?
        .broadcast_sub(&constant(MEAN)?)?
        .broadcast_div(&constant(STD)?)?
        .pad_with_zeros(1, 0, config.pad_to - tall)?
        .pad_with_zeros(2, 0, config.pad_to - wide)?)
}
