//! Photos on their way into MV-DUSt3R, and their order.

use crate::{case::Case, comparison::Comparison};
use anyhow::{Context, Result};
use candle_core::{DType, Device, Tensor};
use image::RgbImage;
use serde::Deserialize;
use tid3r::{
    photos::{NetworkFrame, network_input},
    reconstruct::spread_order,
};

#[derive(Deserialize)]
struct PreprocessConfig {
    size: u32,
    square_ok: bool,
}

/// Frames: decoded pictures in, 8-bit frames and the network's input out.
pub(crate) fn preprocess(case: &Case, comparison: &mut Comparison) -> Result<()> {
    /// The input is recorded at every fourth pixel of every fourth row.
    const STRIDE: usize = 4;
    let config: PreprocessConfig = case.config()?;
    for index in 0..case.inputs().len() {
        let photo = picture(case.input(&format!("image_{index}"))?)?;
        let size = [photo.width(), photo.height()];
        let frame = NetworkFrame::new(size, config.size, config.square_ok)?.cut(&photo)?;
        let [width, height] = [frame.width(), frame.height()].map(|side| side as usize);

        let input = Tensor::from_vec(network_input(&frame), (1, 3, height, width), &Device::Cpu)?;
        let every_fourth = |length: usize| {
            let places: Vec<u32> = (0..length as u32).step_by(STRIDE).collect();
            Tensor::new(places, &Device::Cpu)
        };
        let input = input
            .index_select(&every_fourth(height)?, 2)?
            .index_select(&every_fourth(width)?, 3)?;
        comparison.check(&format!("img_{index}_s4"), &input);
        let true_shape = Tensor::new(&[[height as i64, width as i64]], &Device::Cpu)?;
        comparison.check(&format!("true_shape_{index}"), &true_shape);
        let pixels = Tensor::from_vec(frame.into_raw(), (height, width, 3), &Device::Cpu)?;
        comparison.check_all_but(&format!("u8_{index}"), &pixels, 0.01, 1.0);
    }
    Ok(())
}

/// The demo's order of views.
pub(crate) fn view_order(case: &Case, comparison: &mut Comparison) -> Result<()> {
    for name in case.expected().keys() {
        let count = name
            .strip_prefix("order_")
            .and_then(|count| count.parse().ok());
        let count = count.with_context(|| format!("`{name}` does not end in a number"))?;
        let order: Vec<i64> = spread_order(count).into_iter().map(|k| k as i64).collect();
        comparison.check(name, &Tensor::new(order, &Device::Cpu)?);
    }
    Ok(())
}

/// The picture in an 8-bit tensor (height, width, 3).
fn picture(tensor: &Tensor) -> Result<RgbImage> {
    let (height, width, _) = tensor.dims3()?;
    let pixels = tensor.to_dtype(DType::U8)?.flatten_all()?.to_vec1()?;
    RgbImage::from_raw(width as u32, height as u32, pixels).context("the picture is not RGB")
}
