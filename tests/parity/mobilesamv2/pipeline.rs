//! What is around the networks: pictures in, boxes, masks.

use crate::{case::Case, comparison::Comparison};
use anyhow::{Context, Result, ensure};
use candle_core::{DType, Device, Tensor};
use image::RgbImage;
use serde::Deserialize;
use tid3r::segment::{
    Mask, by_area,
    mobilesamv2::{BoxSelection, Detection, Letterbox, MaskResize, SamFrame},
    painted, without_duplicates,
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
        let tensor = |rows: &[[f32; 4]]| Tensor::new(rows, &Device::Cpu);
        comparison.check(&format!("snapped{index}"), &tensor(&snapped)?);
        comparison.check(&format!("image_boxes{index}"), &tensor(&of_photo)?);
        let of_square = Tensor::new(of_square, &Device::Cpu)?;
        comparison.check(&format!("sam_boxes{index}"), &of_square);
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
        let frame = SamFrame::new([width, height], set.image_side);
        let [wide, tall] = frame.resized();
        ensure!([tall, wide] == set.input_size, "{frame:?}");
        let low_res = case.input(&format!("low_res{index}"))?;
        let (_, _, low, _) = low_res.dims4()?;
        let resize = MaskResize::new(low, &frame, [width, height]);
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

fn places(places: &[usize]) -> Result<Tensor> {
    let places: Vec<i64> = places.iter().map(|&place| place as i64).collect();
    Ok(Tensor::new(places, &Device::Cpu)?)
}
