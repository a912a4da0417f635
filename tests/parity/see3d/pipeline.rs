//! The pipeline: pictures on their way in and out, frames and groups, and everything in between.

use super::{channels_first, channels_last};
use crate::{
    case::{Case, device},
    comparison::Comparison,
};
use anyhow::{Context, Result, bail, ensure};
use candle_core::{DType, Device, IndexOp, Tensor};
use image::{GrayImage, RgbImage};
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use tid3r::{
    photos::{PillowFilter, pillow_resize},
    render::see3d::{
        ClipFrame, Frames, Group, from_unit_range, in_unit_range, luma, main_groups, quantised,
        squashed, super_resolution_groups,
    },
};
use tid3r_models::{
    Observer, Weights,
    see3d::{
        clip::{TextConfig, TextEncoder, VisionConfig, VisionEncoder},
        denoise::{self, Conditions, Draw, Halves, Quality, Sampler, Variant, denoise},
        schedule::{self, Schedule},
        unet::{self, Unet},
        vae::{self, Vae},
    },
};
use tid3r_weights_convert::{Config as Converted, Network, see3d::Preprocessor, synth};

/// Bytes of a tensor.
fn bytes(tensor: &Tensor) -> Result<Vec<u8>> {
    Ok(tensor.to_dtype(DType::U8)?.flatten_all()?.to_vec1()?)
}

/// The picture in an 8-bit tensor (height, width, 3).
fn picture(tensor: &Tensor) -> Result<RgbImage> {
    let (height, width, 3) = tensor.dims3()? else {
        bail!("a picture has {:?}", tensor.shape());
    };
    let picture = RgbImage::from_raw(width as u32, height as u32, bytes(tensor)?);
    picture.context("a picture is too short")
}

/// The grey picture in an 8-bit tensor (height, width) or (height, width, 3).
fn grey(tensor: &Tensor) -> Result<GrayImage> {
    if tensor.rank() == 3 {
        return Ok(luma(&picture(tensor)?));
    }
    let (height, width) = tensor.dims2()?;
    let picture = GrayImage::from_raw(width as u32, height as u32, bytes(tensor)?);
    picture.context("a mask is too short")
}

/// Pictures of one size as an 8-bit tensor (pictures, height, width, 3).
fn stacked(pictures: &[RgbImage]) -> Result<Tensor> {
    let tensors = pictures.iter().map(|picture| {
        let (width, height) = picture.dimensions();
        let shape = (height as usize, width as usize, 3);
        Tensor::from_slice(picture.as_raw(), shape, &Device::Cpu)
    });
    Ok(Tensor::stack(
        &tensors.collect::<candle_core::Result<Vec<_>>>()?,
        0,
    )?)
}

/// The inputs `name`_0, `name`_1, ..
fn numbered<T>(case: &Case, name: &str, read: impl Fn(&Tensor) -> Result<T>) -> Result<Vec<T>> {
    let tensors = (0..).map_while(|k| case.inputs().get(&format!("{name}_{k}")));
    tensors.map(read).collect()
}

/// Pillow's bicubic filter and its grey.
pub(crate) fn resize(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        jobs: Vec<Job>,
    }
    #[derive(Deserialize)]
    struct Job {
        to: [usize; 2],
        mode: String,
    }
    for (k, Job { to, mode }) in case.config::<Config>()?.jobs.into_iter().enumerate() {
        let input = case.input(&format!("image_{k}"))?;
        let [height, width] = to;
        let size = [width as u32, height as u32];
        let resized = match mode.as_str() {
            "RGB" => Tensor::from_vec(
                squashed(&picture(input)?, size).into_raw(),
                (height, width, 3),
                &Device::Cpu,
            )?,
            _ => {
                let resized = pillow_resize(&grey(input)?, size, PillowFilter::Bicubic);
                Tensor::from_vec(resized.into_raw(), (height, width), &Device::Cpu)?
            }
        };
        comparison.check(&format!("resized_{k}"), &resized);
    }
    if let Ok(input) = case.input("rgb") {
        let grey = luma(&picture(input)?);
        let shape = (grey.height() as usize, grey.width() as usize);
        let grey = Tensor::from_vec(grey.into_raw(), shape, &Device::Cpu)?;
        comparison.check("luma", &grey);
    }
    Ok(())
}

#[derive(Deserialize)]
struct Size {
    height: u32,
    width: u32,
}

/// The frames that a case gives: photos `ref_i`, then projections `warp_i` with masks `mask_i`.
fn frames(case: &Case) -> Result<Frames> {
    let Size { height, width } = case.config()?;
    let warps = numbered(case, "warp", picture)?;
    let masks = numbered(case, "mask", grey)?;
    ensure!(
        warps.len() == masks.len(),
        "there are fewer masks than warps"
    );
    let targets: Vec<_> = warps.into_iter().zip(masks).collect();
    Ok(Frames::new(
        &numbered(case, "ref", picture)?,
        &targets,
        [width, height],
    ))
}

/// The masks of the pictures themselves, (frames, 1, height, width).
fn masks(frames: &Frames) -> Result<Tensor> {
    let masks = frames.masks.iter().map(|mask| {
        let values: Vec<f32> = mask
            .values()
            .iter()
            .map(|&known| f32::from(u8::from(known)))
            .collect();
        let shape = (1, mask.height() as usize, mask.width() as usize);
        Tensor::from_vec(values, shape, &Device::Cpu)
    });
    Ok(Tensor::stack(
        &masks.collect::<candle_core::Result<Vec<_>>>()?,
        0,
    )?)
}

/// Pictures and masks as the networks see them.
pub(crate) fn preprocessing(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let frames = frames(case)?;
    let pictures = channels_first(&frames.tensor()?)?;
    comparison.check("conditioning", &pictures);
    let masks = masks(&frames)?;
    comparison.check("masks", &masks);
    // What the original can do, but does not: what is not known is black.
    let black = (masks.broadcast_mul(&pictures)? + masks.broadcast_as(pictures.shape())?)?;
    comparison.check("conditioning_logical_not", &(black - 1.0)?);
    let latents = channels_first(&frames.latent_masks()?)?;
    comparison.check("mask_latents", &latents);
    Ok(())
}

/// What CLIP sees of pictures.
pub(crate) fn clip_preprocessing(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        size: u32,
        image_mean: [f32; 3],
        image_std: [f32; 3],
    }
    let config: Config = case.config()?;
    let frame = ClipFrame {
        shortest_edge: config.size,
        crop: [config.size; 2],
        mean: config.image_mean,
        std: config.image_std,
    };
    for (k, picture) in numbered(case, "image", picture)?.iter().enumerate() {
        let values = channels_first(&frame.tensor(picture)?)?;
        comparison.check(&format!("pixel_values_{k}"), &values);
        let name = format!("quantised_{k}");
        comparison.check_if_expected(&name, &stacked(&[quantised(picture)])?.i(0)?);
        let resized = frame.resized(picture).picture;
        comparison.check_if_expected(&format!("resized_{k}"), &stacked(&[resized])?.i(0)?);
    }
    Ok(())
}

/// What `inference.py` feeds to its two models.
///
/// Frames are as tid3r groups them. Masks are those of the original, which in super-resolution gives each
/// picture the mask at its own place in a list that begins with those of the photos; tid3r does not.
pub(crate) fn grouping(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        references: usize,
        targets: usize,
        #[serde(default)]
        super_resolution: bool,
    }
    const KNOWN: i64 = 64;
    let Config {
        references,
        targets,
        super_resolution,
    } = case.config()?;
    let photos = 0..references as i64;
    let all_masks: Vec<i64> = photos
        .clone()
        .map(|_| KNOWN)
        .chain(1..=targets as i64)
        .collect();
    let mut number = 0;
    let mut check = |frames: Vec<i64>, masks: &[i64]| -> Result<()> {
        let tensor = |values: &[i64]| Tensor::new(values, &Device::Cpu);
        comparison.check(&format!("call_{number}.frames"), &tensor(&frames)?);
        comparison.check(&format!("call_{number}.mask_rows"), &tensor(masks)?);
        number += 1;
        Ok(())
    };
    let ids = |first: i64, views: &mut dyn Iterator<Item = usize>| -> Vec<i64> {
        views.map(|view| first + view as i64).collect()
    };
    for Group { targets, .. } in main_groups(targets, references + targets) {
        let frames = photos.clone().chain(ids(100, &mut targets.clone()));
        check(frames.collect(), &all_masks)?;
    }
    if super_resolution {
        let mut masks: Vec<i64> = Vec::new();
        for Group { carried, targets } in super_resolution_groups(references, targets) {
            let frames = photos.clone();
            let frames = frames.chain(ids(300, &mut carried.iter().copied()));
            let frames = frames.chain(ids(200, &mut targets.clone()));
            let before = match carried.is_empty() {
                true => Vec::new(),
                false => vec![masks[masks.len() / 2], masks[masks.len() - 1]],
            };
            let own = targets.map(|view| all_masks[view]);
            masks = photos
                .clone()
                .map(|_| KNOWN)
                .chain(before)
                .chain(own)
                .collect();
            check(frames.collect(), &masks)?;
        }
    }
    Ok(())
}

#[derive(Deserialize)]
struct PipelineConfig {
    pipeline: String,
    condition_num_frames: usize,
    num_frames: usize,
    num_inference_steps: usize,
    guidance_scale: f64,
    #[serde(default)]
    guidance_rescale: f64,
    scheduler: schedule::Config,
    unet: Value,
    vae: vae::Config,
    vision: Value,
    text: Value,
    #[serde(default)]
    component_seeds: BTreeMap<String, u64>,
}

/// The networks of a pipeline.
struct Networks {
    unet: Unet,
    vae: Vae,
    vision: VisionEncoder,
    text: TextEncoder,
    clip_frame: ClipFrame,
}

impl Networks {
    /// Those in the folder that the case names, of UNets the one with the case's configuration; or made up
    /// from the seeds of its parts.
    fn of(case: &Case, config: &PipelineConfig) -> Result<Self> {
        let unet_config: unet::Config = serde_json::from_value(config.unet.clone())?;
        let vision_config = VisionConfig::from_json(&config.vision)?;
        let text_config = TextConfig::from_json(&config.text)?;
        if case.source().is_err() {
            let weights = |part: &str| -> Result<Weights> {
                let seed = config.component_seeds.get(part).copied();
                let seed = seed.with_context(|| format!("no seed for `{part}`"))?;
                let make = move |name: &str, shape: &[usize]| synth::tensor(name, shape, seed);
                Ok(Weights::from_fn(make, device()?))
            };
            return Ok(Self {
                unet: Unet::new(&unet_config, &weights("unet")?)?,
                vae: Vae::new(&config.vae, &weights("vae")?)?,
                clip_frame: clip_frame(&Preprocessor::of_side(vision_config.image_size)),
                vision: VisionEncoder::new(&vision_config, &weights("vision")?)?,
                text: TextEncoder::new(&text_config, &weights("text")?)?,
            });
        }
        let converted = case.converted()?;
        let mut unet = None;
        for network in Network::all() {
            if let Ok((Converted::Unet(found), weights)) = converted.network(network.name)
                && found.unet == unet_config
            {
                unet = Some(Unet::new(&found.unet, &weights)?);
            }
        }
        let (Converted::Vae(vae), vae_weights) = converted.network("see3d-vae")? else {
            bail!("see3d-vae is another network");
        };
        let (Converted::ImageEncoder(image), image_weights) =
            converted.network("see3d-image-encoder")?
        else {
            bail!("see3d-image-encoder is another network");
        };
        let (Converted::TextEncoder(text), text_weights) =
            converted.network("see3d-text-encoder")?
        else {
            bail!("see3d-text-encoder is another network");
        };
        ensure!(vae == config.vae, "the autoencoder is not the case's");
        Ok(Self {
            unet: unet.context("no UNet has the case's configuration")?,
            vae: Vae::new(&vae, &vae_weights)?,
            clip_frame: clip_frame(&image.preprocessor),
            vision: VisionEncoder::new(&image.vision, &image_weights)?,
            text: TextEncoder::new(&text.text, &text_weights)?,
        })
    }
}

fn clip_frame(of: &Preprocessor) -> ClipFrame {
    ClipFrame {
        shortest_edge: of.shortest_edge as u32,
        crop: of.crop.map(|side| side as u32),
        mean: of.mean,
        std: of.std,
    }
}

/// Recorded draws.
struct Recorded<'a>(&'a Case);

impl denoise::Noise for Recorded<'_> {
    fn draw(&mut self, draw: Draw, _: (usize, usize, usize, usize)) -> candle_core::Result<Tensor> {
        let recorded = || match draw {
            Draw::Latents => channels_last(self.0.input("noise_latents")?),
            Draw::Warp(step) => channels_last(&self.0.input("noise_warp")?.i(step)?),
        };
        let recorded = recorded().map_err(|error| candle_core::Error::Msg(error.to_string()))?;
        // Only networks compute elsewhere.
        recorded.to_device(&Device::Cpu)
    }
}

/// The tensors of all steps.
#[derive(Default)]
struct Steps(BTreeMap<String, Vec<Tensor>>);

impl Observer for Steps {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        if ["unet_input", "unet_output", "guided", "latents"].contains(&name) {
            let tensor = tensor()?.permute((0, 3, 1, 2))?.contiguous()?;
            self.0.entry(name.to_string()).or_default().push(tensor);
        }
        Ok(())
    }
}

/// From bytes to bytes.
pub(crate) fn whole(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let config: PipelineConfig = case.config()?;
    let networks = Networks::of(case, &config)?;
    let frames = frames(case)?;
    let count = frames.pictures.len();
    ensure!(count == config.num_frames && frames.references == config.condition_num_frames);
    let pictures = frames.tensor()?;
    comparison.check_if_expected("conditioning_pixel_values", &channels_first(&pictures)?);
    comparison.check_if_expected("masks", &masks(&frames)?);

    let moments = networks.vae.encoder.encode(&pictures)?;
    comparison.check_if_expected("moments", &channels_first(&moments.parameters)?);
    let latents = moments.latents(&channels_last(case.input("noise_vae")?)?)?;
    let references = latents.narrow(0, 0, frames.references)?;
    comparison.check_if_expected("img_latents", &channels_first(&references)?);

    let seen = frames
        .pictures
        .iter()
        .map(|picture| networks.clip_frame.tensor(picture));
    let seen = Tensor::cat(&seen.collect::<candle_core::Result<Vec<_>>>()?, 0)?;
    comparison.check_if_expected("clip_pixel_values", &channels_first(&seen)?);
    let looks = networks.vision.forward(&seen)?;
    comparison.check_if_expected("image_embeds", &looks);

    let variant = match config.pipeline.as_str() {
        "main" => Variant::Main,
        "SR" => Variant::SuperResolution,
        other => bail!("there is no pipeline `{other}`"),
    };
    let sampler = Sampler {
        steps: config.num_inference_steps,
        guidance: config.guidance_scale,
        rescale: config.guidance_rescale,
        quality: Quality::Exact,
        variant,
        halves: Halves::Together,
    };
    let ids = |name: &str| -> Result<Tensor> { Ok(case.input(name)?.to_dtype(DType::U32)?) };
    let ids = match sampler.groups() {
        1 => ids("input_ids_prompt")?,
        _ => Tensor::cat(&[ids("input_ids_negative")?, ids("input_ids_prompt")?], 0)?,
    };
    let text = networks.text.forward(&ids)?;
    let context = denoise::context(&text, &looks.i(0)?, sampler.groups(), count)?;
    let rows = sampler.groups() * count;
    let all_rows = match context.dim(0)? {
        1 => context.repeat((rows, 1, 1))?,
        _ => context.clone(),
    };
    comparison.check_if_expected("context", &all_rows);

    let schedule = Schedule::new(&config.scheduler)?;
    let timesteps: Vec<f32> = sampler
        .timesteps(&schedule)?
        .into_iter()
        .map(|t| t as f32)
        .collect();
    comparison.check_if_expected("timesteps", &Tensor::new(timesteps, &Device::Cpu)?);
    let conditions = Conditions {
        latents,
        mask: frames.latent_masks()?,
        references: frames.references,
    };
    let mut steps = Steps::default();
    let context = networks.unet.context(&context)?;
    let latents = denoise(
        &networks.unet,
        &context,
        &conditions,
        &schedule,
        &sampler,
        &mut Recorded(case),
        &mut steps,
    )?;
    for (name, tensors) in steps.0 {
        comparison.check_if_expected(&name, &Tensor::stack(&tensors, 0)?);
    }

    let images = in_unit_range(&networks.vae.decoder.decode(&latents)?)?;
    comparison.check_if_expected("images", &images);
    let decoded = from_unit_range(&images)?;
    // A share of the bytes may be on the other side of a half.
    let mut check_bytes = |name: &str, pictures: &[RgbImage]| -> Result<()> {
        if comparison.expects(name) {
            comparison.check_all_but(name, &stacked(pictures)?, 0.01, 1.0);
        }
        Ok(())
    };
    check_bytes("images_u8", &decoded)?;
    let first = picture(case.input("ref_0")?)?;
    let size = [first.width(), first.height()];
    let output = decoded[frames.references..]
        .iter()
        .map(|picture| squashed(picture, size));
    check_bytes("output_u8", &output.collect::<Vec<_>>())
}
