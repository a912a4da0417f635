//! The networks of MobileSAMv2.

use super::{BenchParams, Load, Size, Source, Trial, failed, made_up};
use crate::Result;
use candle_core::{Device, Tensor};
use std::rc::Rc;
use tid3r_models::{
    Unobserved,
    mobilesamv2::{
        ImageEncoder,
        decoder::{self, Decoder},
        detector::{self, Detector},
    },
};

/// The detector, on one picture.
pub(super) fn detector(
    params: &BenchParams,
    config: &detector::Config,
    source: &Source<'_>,
) -> Result<Vec<Trial>> {
    const STEP: u32 = 32;
    let size = params.size.unwrap_or(Size::square(ImageEncoder::SIDE));
    let (width, height) = size.in_steps_of(STEP)?;
    let network = Detector::new(config, &source.weights()?).map_err(failed)?;
    let work = detector::Work::new(config, (height, width)).map_err(failed)?;
    let memory = detector::Memory::new(config, (height, width), params.dtype).map_err(failed)?;
    let image = made_up(&[1, height, width, 3])?;
    Ok(vec![Trial {
        load: Load::of_size(size),
        defined: work.total(),
        computed: work.computed(),
        memory: memory.total(),
        run: Box::new(move || network.forward(&image, &mut Unobserved).map(drop)),
    }])
}

/// An encoder that takes so many multiply-adds and so much memory, on one picture.
pub(super) fn encoder(encoder: ImageEncoder, work: f64, memory: usize) -> Result<Vec<Trial>> {
    let image = made_up(&[1, ImageEncoder::SIDE, ImageEncoder::SIDE, 3])?;
    Ok(vec![Trial {
        load: Load::of_size(Size::square(ImageEncoder::SIDE)),
        defined: work,
        computed: work,
        memory,
        run: Box::new(move || encoder.forward(&image, &mut Unobserved).map(drop)),
    }])
}

/// The decoder, on each number of boxes.
pub(super) fn decoder(
    params: &BenchParams,
    config: &decoder::Config,
    source: &Source<'_>,
) -> Result<Vec<Trial>> {
    const BOXES: [u32; 1] = [100];
    let network = Rc::new(Decoder::new(config, &source.weights()?).map_err(failed)?);
    let prompts = &config.prompt_encoder;
    let [height, width] = prompts.image_embedding_size;
    let image = made_up(&[1, height, width, prompts.embed_dim])?;
    let [tall, wide] = prompts.input_image_size;
    let work = decoder::Work::new(config);
    let (options, footprint) = (decoder::Options::default(), source.footprint()?);
    let counts = match params.boxes.is_empty() {
        true => &BOXES[..],
        false => &params.boxes,
    };
    let trial = |&count: &u32| {
        let boxes = spread(count, (wide as f64, tall as f64))?;
        let (network, image) = (Rc::clone(&network), image.clone());
        let memory = decoder::Memory::new(config, count as usize, &options, footprint);
        Ok(Trial {
            memory: memory.map_err(failed)?.total(),
            load: Load {
                boxes: Some(count),
                ..Load::of_size(Size {
                    width: wide as u32,
                    height: tall as u32,
                })
            },
            defined: work.total(count as usize),
            computed: work.total(count as usize),
            run: Box::new(move || {
                let options = decoder::Options::default();
                network
                    .forward(&image, &boxes, &options, &mut Unobserved)
                    .map(drop)
            }),
        })
    };
    counts.iter().map(trial).collect()
}

/// Boxes of several sizes all over a picture, (count, 4).
fn spread(count: u32, (width, height): (f64, f64)) -> Result<Tensor> {
    let share = |i: u32, step: f64| (f64::from(i) * step).fract();
    let corners = (0..count).flat_map(|i| {
        let (x, y) = (0.6 * share(i, 0.618), 0.6 * share(i, 0.414));
        let side = 0.1 + 0.3 * share(i, 0.732);
        [
            x * width,
            y * height,
            (x + side) * width,
            (y + side) * height,
        ]
    });
    Tensor::from_iter(corners, &Device::Cpu)
        .and_then(|corners| corners.reshape((count as usize, 4)))
        .map_err(failed)
}
