//! What is around the networks: pictures in, boxes, masks.

use crate::{
    case::{Case, device},
    comparison::Comparison,
};
use anyhow::{Context, Result, ensure};
use candle_core::{DType, Device, Tensor, WithDType};
use image::RgbImage;
use serde::Deserialize;
use tid3r::segment::{
    Mask, by_area,
    mobilesamv2::{BoxSelection, Detection, Letterbox, MaskResize, Networks, SamFrame},
    painted, without_duplicates,
};
use tid3r_models::{
    Parameter, Unobserved, Weights,
    mobilesamv2::{
        ImageEncoder,
        decoder::{self, Decoder},
        detector::{self, Detector, MaskCoefficients},
        efficient_vit::{self, EfficientVit},
        vit::{self, Vit},
    },
};

/// The detector's pictures.
pub(crate) fn letterbox(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        geometry: Vec<Geometry>,
    }
    #[derive(Deserialize)]
    struct Geometry {
        image: [u32; 2],
        imgsz: u32,
    }
    let config: Config = case.config()?;
    for (index, geometry) in config.geometry.iter().enumerate() {
        let [height, width] = geometry.image;
        let letterbox = Letterbox::new([width, height], geometry.imgsz);
        let boxed = letterbox.apply(&picture(case.input(&format!("image{index}"))?)?);
        let input = Letterbox::tensor(&boxed)?.permute((0, 3, 1, 2))?;
        comparison.check_sampled(&format!("network_input{index}"), &input)?;
        let pixels = pixels(&boxed)?;
        comparison.check_all_but(&format!("letterboxed{index}"), &pixels, 0.0, 0.0);
    }
    Ok(())
}

/// Anchors to objects.
pub(crate) fn nms(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        sets: Vec<Set>,
    }
    #[derive(Deserialize)]
    struct Set {
        conf: f32,
        iou: f64,
        max_det: usize,
    }
    let config: Config = case.config()?;
    for (index, set) in config.sets.iter().enumerate() {
        let prediction = case.input(&format!("prediction{index}"))?.squeeze(0)?;
        let classes = prediction.dim(0)? - 4;
        let boxes = prediction.narrow(0, 0, 4)?.t()?;
        let scores = prediction.narrow(0, 4, classes)?.t()?;
        let rule = BoxSelection {
            confidence: set.conf,
            iou: set.iou,
            most: set.max_det,
        };
        let found = rule.select(&fours(&boxes)?, &floats(&scores)?, classes);
        let anchors: Vec<i64> = found.iter().map(|found| found.anchor as i64).collect();
        comparison.check(
            &format!("keep{index}"),
            &Tensor::new(anchors, &Device::Cpu)?,
        );
        let row = |found: &Detection| {
            let [left, top, right, bottom] = found.corners;
            [left, top, right, bottom, found.score, found.class as f32]
        };
        let rows: Vec<f32> = found.iter().flat_map(row).collect();
        let rows = Tensor::from_vec(rows, (found.len(), 6), &Device::Cpu)?;
        comparison.check(&format!("detections{index}"), &rows);
    }
    Ok(())
}

/// Boxes of the detector's picture to boxes of the photo, and of SAM's square.
pub(crate) fn box_postprocess(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        sam_size: u32,
        geometry: Vec<Geometry>,
    }
    #[derive(Deserialize)]
    struct Geometry {
        image: [u32; 2],
        letterboxed: [u32; 2],
    }
    let config: Config = case.config()?;
    for (index, geometry) in config.geometry.iter().enumerate() {
        let ([height, width], [tall, wide]) = (geometry.image, geometry.letterboxed);
        let letterbox = Letterbox::new([width, height], wide.max(tall));
        ensure!(letterbox.size() == [wide, tall], "{letterbox:?}");
        let boxes = fours(case.input(&format!("letterbox_boxes{index}"))?)?;
        let snapped: Vec<_> = boxes.into_iter().map(|b| letterbox.snapped(b)).collect();
        let of_photo: Vec<_> = snapped.iter().map(|&b| letterbox.to_picture(b)).collect();
        let frame = SamFrame::new([width, height], config.sam_size);
        let of_square: Vec<_> = of_photo.iter().map(|&b| frame.to_square(b)).collect();
        comparison.check(&format!("snapped{index}"), &four_columns(snapped)?);
        comparison.check(&format!("image_boxes{index}"), &four_columns(of_photo)?);
        comparison.check(&format!("sam_boxes{index}"), &four_columns(of_square)?);
    }
    Ok(())
}

/// The encoders' pictures.
pub(crate) fn sam_preprocess(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        geometry: Vec<Geometry>,
    }
    #[derive(Deserialize)]
    struct Geometry {
        image: [u32; 2],
        long_side: u32,
        stride: usize,
    }
    let config: Config = case.config()?;
    for (index, geometry) in config.geometry.iter().enumerate() {
        let [height, width] = geometry.image;
        let frame = SamFrame::new([width, height], geometry.long_side);
        let resized = frame.apply(&picture(case.input(&format!("image{index}"))?)?);
        let input = frame.tensor(&resized)?.permute((0, 3, 1, 2))?;
        let steps = [1, 1, geometry.stride, geometry.stride];
        comparison.check(&format!("network_input{index}"), &every(&input, &steps)?);
        let name = format!("resized{index}");
        if comparison.expects(&name) {
            // Pillow 13 passes over very tall pictures in the other order.
            comparison.check_all_but(&name, &pixels(&resized)?, 0.005, 1.0);
        }
    }
    Ok(())
}

/// Logits to masks.
pub(crate) fn mask_postprocess(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        sets: Vec<Set>,
    }
    #[derive(Deserialize)]
    struct Set {
        image_side: u32,
        input_size: [u32; 2],
        original_size: [u32; 2],
        stride: usize,
    }
    let config: Config = case.config()?;
    for (index, set) in config.sets.iter().enumerate() {
        let [height, width] = set.original_size;
        let [tall, wide] = set.input_size;
        let low_res = case.input(&format!("low_res{index}"))?;
        let (_, _, low, _) = low_res.dims4()?;
        let resize = MaskResize::new(low, set.image_side, [wide, tall], [width, height]);
        let mut logits = Vec::new();
        let mut masks = Vec::new();
        for map in floats(low_res)?.chunks_exact(low * low) {
            logits.extend(resize.logits(map).into_values());
            masks.push(resize.mask(map, 1.0));
        }
        let (height, width) = (height as usize, width as usize);
        let logits = Tensor::from_vec(logits, (masks.len(), 1, height, width), &Device::Cpu)?;
        let steps = [1, 1, set.stride, set.stride];
        comparison.check(&format!("logits{index}"), &every(&logits, &steps)?);
        let masks = bitmaps(&masks, (height, width))?;
        comparison.check_all_but(&format!("mask{index}"), &masks, 5e-4, 1.0);
    }
    Ok(())
}

/// What PE3R does with masks.
pub(crate) fn pe3r_masks(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        nms_threshold: f64,
    }
    let config: Config = case.config()?;
    let maps = case.input("masks")?;
    let (_, height, width) = maps.dims3()?;
    let maps: Vec<u8> = maps.to_dtype(DType::U8)?.flatten_all()?.to_vec1()?;
    let masks: Vec<Mask> = maps.chunks_exact(height * width).map(mask_of).collect();
    let order = by_area(&masks);
    comparison.check("order", &places(&order)?);
    let kept = without_duplicates(&masks, &order, config.nms_threshold);
    let place = |k: &usize| order.iter().position(|other| other == k);
    let kept: Vec<usize> = kept.iter().filter_map(place).collect();
    comparison.check("keep", &places(&kept)?);
    let kept: Vec<Mask> = kept.iter().map(|&k| masks[order[k]].clone()).collect();
    let numbers = |order: &[usize]| -> Result<Tensor> {
        let painted = painted(&kept, order, width as u32, height as u32);
        let numbers = painted.map(|&number| i64::from(number) - 1).into_values();
        Ok(Tensor::from_vec(numbers, (height, width), &Device::Cpu)?)
    };
    let mut order = by_area(&kept);
    comparison.check("seg_map", &numbers(&order)?);
    order.reverse();
    comparison.check("rev_seg_map", &numbers(&order)?);
    Ok(())
}

/// The detector's sizes as cases have them.
#[derive(Deserialize)]
struct DetectorSizes {
    depth_width_maxchannels: (f64, f64, usize),
    nc: usize,
    reg_max: usize,
    nm: usize,
}

impl DetectorSizes {
    fn config(&self) -> detector::Config {
        let scale = self.depth_width_maxchannels;
        detector::Config::scaled(scale, self.nc, self.reg_max, self.nm)
    }
}

/// The mask decoder's sizes as cases have them.
#[derive(Deserialize)]
struct DecoderSizes {
    dim: usize,
    depth: usize,
    num_heads: usize,
    mlp_dim: usize,
    iou_head_depth: usize,
    iou_head_hidden_dim: usize,
    num_multimask_outputs: usize,
}

impl DecoderSizes {
    fn config(&self) -> decoder::Config {
        let mut config = decoder::Config::released();
        config.prompt_encoder.embed_dim = self.dim;
        config.mask_decoder = decoder::MaskDecoderConfig {
            transformer_dim: self.dim,
            depth: self.depth,
            num_heads: self.num_heads,
            mlp_dim: self.mlp_dim,
            iou_head_depth: self.iou_head_depth,
            iou_head_hidden_dim: self.iou_head_hidden_dim,
            num_multimask_outputs: self.num_multimask_outputs,
            ..config.mask_decoder
        };
        config
    }
}

/// What a case of the whole pipeline says, besides its encoder.
#[derive(Deserialize)]
struct Pipeline {
    detector: DetectorSizes,
    mask_decoder: DecoderSizes,
    imgsz: u32,
    conf: f32,
    iou: f64,
    max_det: usize,
}

/// The decoder's weights, each part synthetic under its own names.
fn decoder_weights(case: &Case) -> Result<Weights> {
    let prompt = case.weights_of("prompt_encoder")?;
    let mask = case.weights_of("mask_decoder")?;
    let values = move |name: &str, shape: &[usize]| {
        let part = match name.strip_prefix("prompt_encoder.") {
            Some(rest) => prompt.get(shape, rest),
            None => mask.get(shape, name.trim_start_matches("mask_decoder.")),
        };
        let values = |part: Parameter| part.tensor()?.flatten_all()?.to_vec1();
        part.and_then(values).unwrap_or_default()
    };
    Ok(Weights::from_fn(values, device()?))
}

/// What comes of a picture, step by step.
struct Steps {
    size: (usize, usize),
    boxes: Vec<Detection>,
    frame: SamFrame,
    masks: Vec<Mask>,
}

/// Compares everything up to the masks of each box.
fn steps(case: &Case, encoder: ImageEncoder, comparison: &mut Comparison) -> Result<Steps> {
    let pipeline: Pipeline = case.config()?;
    let weights = case.weights_of("detector")?;
    let networks = Networks {
        detector: Detector::new(&pipeline.detector.config(), &weights)?,
        encoder,
        decoder: Decoder::new(&pipeline.mask_decoder.config(), &decoder_weights(case)?)?,
    };
    let rule = BoxSelection {
        confidence: pipeline.conf,
        iou: pipeline.iou,
        most: pipeline.max_det,
    };
    let picture = picture(case.input("image")?)?;
    let size = [picture.width(), picture.height()];
    let boxes = networks.boxes(&picture, pipeline.imgsz, &rule, &mut Unobserved)?;
    let corners: Vec<_> = boxes.iter().map(|found| found.corners).collect();
    comparison.check("xyxy", &four_columns(corners)?);
    let scores: Vec<f32> = boxes.iter().map(|found| found.score).collect();
    comparison.check("score", &Tensor::new(scores, &Device::Cpu)?);

    let frame = SamFrame::new(size, SamFrame::SIDE);
    let features = networks.features(&frame, &picture, &mut Unobserved)?;
    comparison.check_sampled("features", &features.permute((0, 3, 1, 2))?)?;
    let masks = networks.masks(&frame, &features, &boxes, &mut Unobserved)?;
    comparison.check_sampled("low_res", &masks.logits)?;
    // Of each box, not of each channel.
    let means = masks.logits.flatten_from(1)?.mean(1)?;
    comparison.check_if_expected("low_res.mean", &means);
    comparison.check_if_expected("iou", &masks.iou);

    let (count, _, low, _) = masks.logits.dims4()?;
    let resize = MaskResize::new(low, frame.side(), frame.resized(), size);
    let low_res = floats(&masks.logits)?;
    let maps = low_res.chunks_exact(low * low);
    let (height, width) = (size[1] as usize, size[0] as usize);
    let logits: Vec<f32> = maps
        .clone()
        .flat_map(|map| resize.logits(map).into_values())
        .collect();
    let logits = Tensor::from_vec(logits, (count, height, width), &Device::Cpu)?;
    comparison.check_sampled("logits", &logits)?;
    let masks: Vec<Mask> = maps.map(|map| resize.mask(map, 1.0)).collect();
    let areas: Vec<i64> = masks.iter().map(|mask| mask.area() as i64).collect();
    let most = SHARE * (height * width) as f64;
    comparison.check_all_but("areas", &Tensor::new(areas, &Device::Cpu)?, 1.0, most);
    Ok(Steps {
        size: (height, width),
        boxes,
        frame,
        masks,
    })
}

/// The share of pixels that may be in other masks than the original's.
const SHARE: f64 = 2e-3;

/// `Inference.py`: a picture to the masks of all objects, painted the largest first.
pub(crate) fn segment_everything(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        encoder: efficient_vit::Config,
        prompt_encoder: decoder::PromptEncoderConfig,
    }
    let config: Config = case.config()?;
    let weights = case.weights_of("encoder")?;
    let encoder = EfficientVit::new(&config.encoder, &weights)?;
    let steps = steps(case, ImageEncoder::EfficientVit(encoder), comparison)?;
    let corners = steps
        .boxes
        .iter()
        .map(|found| steps.frame.to_square(found.corners));
    let corners = four_columns(corners)?;
    comparison.check("sam_boxes", &corners);
    let weights = case.weights_of("prompt_encoder")?;
    let prompts = decoder::PromptEncoder::new(&config.prompt_encoder, &weights)?;
    comparison.check("sparse", &prompts.boxes(&corners)?);
    let maps = bitmaps(&steps.masks, steps.size)?;
    comparison.check_all_but("masks", &maps, SHARE, 1.0);
    let order = by_area(&steps.masks);
    comparison.check("order", &places(&order)?);
    let (height, width) = steps.size;
    let sorted: Vec<Mask> = order.iter().map(|&k| steps.masks[k].clone()).collect();
    let all: Vec<usize> = (0..sorted.len()).collect();
    let labels = painted(&sorted, &all, width as u32, height as u32);
    let labels = labels.map(|&number| (number as u8).wrapping_sub(1));
    let labels = Tensor::from_vec(labels.into_values(), (height, width), &Device::Cpu)?;
    comparison.check_all_but("label_map", &labels, SHARE, 255.0);
    Ok(())
}

/// PE3R: a picture to the masks that count.
pub(crate) fn pe3r_masks_from_image(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        sam_vit: vit::Config,
        min_area_share: f32,
        nms_threshold: f64,
    }
    let config: Config = case.config()?;
    let weights = case.weights_of("sam_vit")?;
    let encoder = Vit::new(&config.sam_vit, &weights)?;
    let steps = steps(case, ImageEncoder::Vit(encoder), comparison)?;
    let (height, width) = steps.size;
    let mut order = by_area(&steps.masks);
    let share = |k: usize| steps.masks[k].area() as f32 / (height * width) as f32;
    order.retain(|&k| share(k) > config.min_area_share);
    let kept = without_duplicates(&steps.masks, &order, config.nms_threshold);
    let place = |k: &usize| order.iter().position(|other| other == k);
    comparison.check(
        "keep",
        &places(&kept.iter().filter_map(place).collect::<Vec<_>>())?,
    );
    let kept: Vec<Mask> = kept.iter().map(|&k| steps.masks[k].clone()).collect();
    comparison.check_all_but("result", &bitmaps(&kept, steps.size)?, SHARE, 1.0);
    Ok(())
}

/// A detector from its published form of file, with what is before and after it.
pub(crate) fn object_aware_model(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        #[serde(flatten)]
        sizes: DetectorSizes,
        imgsz: u32,
        conf: f32,
        iou: f64,
        max_det: usize,
    }
    let config: Config = case.config()?;
    let sizes = config.sizes.config();
    let detector = Detector::new(&sizes, &case.weights()?)?;
    let picture = picture(case.input("image")?)?;
    let letterbox = Letterbox::new([picture.width(), picture.height()], config.imgsz);
    let image = Letterbox::tensor(&letterbox.apply(&picture))?;
    let prediction = detector.forward(&image, &mut Unobserved)?;
    let anchors_last = |x: &Tensor| x.t()?.unsqueeze(0)?.contiguous();
    comparison.check_sampled("boxes", &anchors_last(&prediction.boxes)?)?;
    comparison.check_sampled("scores", &anchors_last(&prediction.scores)?)?;
    let levels = detector.features(&image, &mut Unobserved)?;
    let weights = case.unconverted_weights()?.pp("model.22");
    let coefficients = MaskCoefficients::new(&sizes, &weights)?.forward(&levels)?;
    comparison.check_sampled("mask_coefficients", &anchors_last(&coefficients)?)?;
    let rule = BoxSelection {
        confidence: config.conf,
        iou: config.iou,
        most: config.max_det,
    };
    let boxes = rule.select(
        &fours(&prediction.boxes)?,
        &floats(&prediction.scores)?,
        config.sizes.nc,
    );
    let corners = boxes
        .iter()
        .map(|found| letterbox.to_picture(letterbox.snapped(found.corners)));
    comparison.check("xyxy", &four_columns(corners)?);
    let scores: Vec<f32> = boxes.iter().map(|found| found.score).collect();
    comparison.check("score", &Tensor::new(scores, &Device::Cpu)?);
    Ok(())
}

/// The picture in an 8-bit tensor (height, width, 3).
pub(super) fn picture(tensor: &Tensor) -> Result<RgbImage> {
    let (height, width, _) = tensor.dims3()?;
    let pixels = tensor.to_dtype(DType::U8)?.flatten_all()?.to_vec1()?;
    RgbImage::from_raw(width as u32, height as u32, pixels).context("the picture is not RGB")
}

/// The mask of a bitmap.
fn mask_of(bitmap: &[u8]) -> Mask {
    let inside = (0..).zip(bitmap).filter(|(_, value)| **value > 0);
    Mask::from_pixels(inside.map(|(place, _)| place), 1.0)
}

/// Bitmaps (masks, height, width) of masks.
fn bitmaps(masks: &[Mask], (height, width): (usize, usize)) -> Result<Tensor> {
    let mut values = vec![0_u8; masks.len() * height * width];
    for (map, mask) in values.chunks_exact_mut(height * width).zip(masks) {
        mask.pixels().for_each(|place| map[place as usize] = 1);
    }
    Ok(Tensor::from_vec(
        values,
        (masks.len(), height, width),
        &Device::Cpu,
    )?)
}

fn pixels(picture: &RgbImage) -> Result<Tensor> {
    let shape = (picture.height() as usize, picture.width() as usize, 3);
    Ok(Tensor::from_vec(
        picture.as_raw().clone(),
        shape,
        &Device::Cpu,
    )?)
}

/// Every so many elements along each axis.
fn every(x: &Tensor, steps: &[usize]) -> Result<Tensor> {
    let mut x = x.clone();
    for (axis, &step) in steps.iter().enumerate() {
        let places: Vec<u32> = (0..x.dim(axis)? as u32).step_by(step).collect();
        x = x
            .contiguous()?
            .index_select(&Tensor::new(places, &Device::Cpu)?, axis)?;
    }
    Ok(x)
}

fn floats(x: &Tensor) -> Result<Vec<f32>> {
    Ok(x.contiguous()?.flatten_all()?.to_vec1()?)
}

/// The rows of `x` (rows, 4).
fn fours(x: &Tensor) -> Result<Vec<[f32; 4]>> {
    let values = floats(x)?;
    Ok(values.as_chunks().0.to_vec())
}

/// The tensor (rows, 4) of rows.
fn four_columns<T: WithDType>(rows: impl IntoIterator<Item = [T; 4]>) -> Result<Tensor> {
    let values: Vec<T> = rows.into_iter().flatten().collect();
    let count = values.len() / 4;
    Ok(Tensor::from_vec(values, (count, 4), &Device::Cpu)?)
}

fn places(places: &[usize]) -> Result<Tensor> {
    let places: Vec<i64> = places.iter().map(|&place| place as i64).collect();
    Ok(Tensor::new(places, &Device::Cpu)?)
}
