//! The networks of See3D.

use super::{BenchParams, Load, Size, Source, Trial, failed, made_up};
use crate::Result;
use candle_core::{Device, Tensor};
use std::rc::Rc;
use tid3r_models::{
    Unobserved,
    nn::Precision,
    see3d::{
        clip::{self, TextEncoder, VisionEncoder},
        unet::{self, Unet},
        vae::{self, Tiling, Vae},
    },
};
use tid3r_weights_convert::see3d::{ImageEncoderConfig, TextEncoderConfig, UnetConfig};

/// Width and height of the pictures that See3D was trained on.
const SIDE: usize = 512;
/// How renders compute convolutions; the VAE's own choice is the same.
const PRECISION: Precision = Precision::Fast;
/// Pixels along each side for one latent.
const SCALE: usize = 8;

/// One of the UNets, for each number of frames: one call with one group of them. A step of sampling with
/// guidance has two.
pub(super) fn unet(
    params: &BenchParams,
    config: &UnetConfig,
    source: &Source<'_>,
) -> Result<Vec<Trial>> {
    const VIEWS: [u32; 1] = [3];
    const TIMESTEP: f32 = 500.0;
    let config = &config.unet;
    let size = params.size.unwrap_or(Size::square(SIDE));
    let (width, height) = size.in_steps_of((SCALE * config.granularity()) as u32)?;
    let latents = (height / SCALE, width / SCALE);
    let network = Unet::with_precision(config, PRECISION, &source.weights()?);
    let network = Rc::new(network.map_err(failed)?);
    let context = made_up(&[1, unet::Work::CONTEXT_TOKENS, config.context_dim])?;
    let context = network.context(&context).map_err(failed)?;
    let views = match params.views.is_empty() {
        true => &VIEWS[..],
        false => &params.views,
    };
    let footprint = source.footprint()?;
    let trial = |&views: &u32| {
        let frames = views as usize;
        let memory = unet::Memory::new(config, 1, frames, latents, footprint);
        let frames_seen = made_up(&[frames, latents.0, latents.1, config.in_channels])?;
        let work = unet::Work::new(config, PRECISION, frames, latents);
        let (network, context) = (Rc::clone(&network), context.clone());
        Ok(Trial {
            memory: memory.map_err(failed)?.total(),
            load: Load {
                views: Some(views),
                ..Load::of_size(size)
            },
            defined: work.total(),
            computed: work.computed(),
            run: Box::new(move || {
                let timesteps = vec![TIMESTEP; frames];
                (network.forward(&frames_seen, &timesteps, &context, frames, &mut Unobserved))
                    .map(drop)
            }),
        })
    };
    views.iter().map(trial).collect()
}

/// The VAE, encoding a picture and decoding one.
pub(super) fn vae(
    params: &BenchParams,
    config: &vae::Config,
    source: &Source<'_>,
) -> Result<Vec<Trial>> {
    let size = params.size.unwrap_or(Size::square(SIDE));
    let (width, height) = size.in_steps_of(config.scale() as u32)?;
    let Vae { encoder, decoder } = Vae::new(config, &source.weights()?).map_err(failed)?;
    let work = vae::Work::new(config, (height, width), Tiling::Released).map_err(failed)?;
    let computed =
        vae::Work::computed(config, (height, width), Tiling::Released).map_err(failed)?;
    let picture = made_up(&[1, height, width, config.in_channels])?;
    let scale = config.scale();
    let latents = made_up(&[1, height / scale, width / scale, config.latent_channels])?;
    let (tiling, footprint) = (Tiling::Released, source.footprint()?);
    let encoding = vae::Memory::of_encoding(config, (height, width), tiling, footprint);
    let decoding = vae::Memory::of_decoding(config, (height, width), tiling, footprint);
    let load = |part| Load {
        part: Some(part),
        ..Load::of_size(size)
    };
    Ok(vec![
        Trial {
            load: load("encode"),
            defined: work.encode,
            computed: computed.encode,
            memory: encoding.map_err(failed)?.total(),
            run: Box::new(move || encoder.encode(&picture).map(drop)),
        },
        Trial {
            load: load("decode"),
            defined: work.decode,
            computed: computed.decode,
            memory: decoding.map_err(failed)?.total(),
            run: Box::new(move || decoder.decode(&latents).map(drop)),
        },
    ])
}

/// The image encoder, on one picture.
pub(super) fn image_encoder(
    config: &ImageEncoderConfig,
    source: &Source<'_>,
) -> Result<Vec<Trial>> {
    let config = &config.vision;
    let network = VisionEncoder::new(config, &source.weights()?).map_err(failed)?;
    let side = config.image_size;
    let picture = made_up(&[1, side, side, config.num_channels])?;
    let work = clip::Work::of_vision(config).total();
    let memory = clip::Memory::of_vision(config, source.footprint()?).map_err(failed)?;
    Ok(vec![Trial {
        load: Load::of_size(Size::square(side)),
        defined: work,
        computed: work,
        memory: memory.total(),
        run: Box::new(move || network.forward(&picture).map(drop)),
    }])
}

/// The text encoder, on the only text that it is ever given.
pub(super) fn text_encoder(config: &TextEncoderConfig, source: &Source<'_>) -> Result<Vec<Trial>> {
    let network = TextEncoder::new(&config.text, &source.weights()?).map_err(failed)?;
    let tokens = config.empty_prompt.len();
    let text = Tensor::from_slice(&config.empty_prompt, (1, tokens), &Device::Cpu);
    let text = text.map_err(failed)?;
    let work = clip::Work::of_text(&config.text, tokens).total();
    let memory =
        clip::Memory::of_text(&config.text, tokens, source.footprint()?).map_err(failed)?;
    Ok(vec![Trial {
        load: Load {
            tokens: Some(tokens as u32),
            ..Load::default()
        },
        defined: work,
        computed: work,
        memory: memory.total(),
        run: Box::new(move || network.forward(&text).map(drop)),
    }])
}
