//! From pointmaps to cameras, and the metrics of pointmaps and poses.

use crate::{case::Case, comparison::Comparison};
use anyhow::{Context, Result};
use candle_core::{DType, Device, Tensor};
use serde::Deserialize;
use tid3r::{
    Map,
    evaluate::{pointmaps, poses},
    geometry::{FocalError, Point, Pose, estimate_focal, matrix4},
    progress::Silent,
    reconstruct::{Pointmap, RecoveryParams, recover_cameras, recover_cameras_under_masks},
};

/// Any will do.
const SEED: u64 = 42;

#[derive(Deserialize)]
struct FocalConfig {
    iterations: usize,
}

/// Focal lengths of pointmaps under masks.
pub(crate) fn estimate_focals(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let iterations = case.config::<FocalConfig>()?.iterations;
    for name in case.expected().keys() {
        let scene = name.strip_prefix("focal_").context("an unknown tensor")?;
        let points = vectors(case.input(&format!("pts3d_{scene}"))?)?;
        let mask = numbers(case.input(&format!("mask_{scene}"))?)?.map(|&m| m != 0.0);
        let focal = match estimate_focal(&points, &mask, iterations) {
            // The original ends at 0 there.
            Err(FocalError::NoLens(_)) => 0.0,
            focal => focal?,
        };
        comparison.check(name, &scalar(focal)?);
    }
    Ok(())
}

#[derive(Deserialize)]
struct DemoConfig {
    min_conf_thr: f64,
}

/// Masks, focal length and poses as the demo has them.
pub(crate) fn demo_geometry(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let params = RecoveryParams {
        min_confidence: case.config::<DemoConfig>()?.min_conf_thr,
        ..RecoveryParams::default()
    };
    let views = pointmaps_of(case, "pts3d", "conf")?;
    let unknown = vec![None; views.len()];
    let recovery = recover_cameras(&views, &unknown, &params, SEED, &Silent)?;
    let (mut masks, mut cameras) = (Vec::new(), Vec::new());
    for view in recovery.views {
        let size = (view.kept.height() as usize, view.kept.width() as usize);
        let mask: Vec<u8> = view.kept.values().iter().map(|&kept| kept.into()).collect();
        masks.push(Tensor::from_vec(mask, size, &Device::Cpu)?);
        cameras.push(pose_tensor(&view.outcome?.camera.cam_to_world)?);
    }
    comparison.check("mask", &Tensor::stack(&masks, 0)?);
    comparison.check("c2w", &Tensor::stack(&cameras, 0)?);
    let focal = recovery.shared_focal.context("no focal length")?;
    comparison.check("focal", &scalar(focal)?);
    Ok(())
}

/// Errors of pointmaps and poses.
pub(crate) fn metrics(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let poses_of = |name| -> Result<Vec<Pose>> {
        let tensor = case.input(name)?;
        views(tensor)?.iter().map(read_pose).collect()
    };
    let truth_poses = poses_of("gt_c2w")?;
    let views_of = |name| -> Result<Vec<Map<[f32; 3]>>> {
        views(case.input(name)?)?.iter().map(vectors).collect()
    };
    let to_first = truth_poses.first().context("no view")?.inverse();
    let in_first = |points: &Map<[f32; 3]>| {
        points.map(|point| {
            let point = to_first * Point::from(point.map(f64::from));
            [point.x, point.y, point.z].map(|x| x as f32)
        })
    };
    let truth: Vec<Map<[f32; 3]>> = views_of("gt_pts3d_world")?.iter().map(in_first).collect();
    let predicted = views_of("pred_pts3d")?;
    let valid = views(case.input("valid")?)?;
    let valid = valid
        .iter()
        .map(|view| Ok(numbers(view)?.map(|&v| v != 0.0)));
    let valid: Vec<Map<bool>> = valid.collect::<Result<_>>()?;

    let alignment = pointmaps::align(&predicted, &truth, &valid)?;
    comparison.check("pred_aligned", &stack(&alignment.predicted)?);
    comparison.check("gt_aligned", &stack(&alignment.truth)?);
    let errors = alignment.errors();
    comparison.check("mean_distance", &scalar(errors.mean_distance)?);
    comparison.check("chamfer", &scalar(errors.chamfer)?);

    let truth_scale = pointmaps::mean_distance_from_origin(&truth, &valid)?;
    let scale = pointmaps::mean_distance_from_origin(&predicted, &valid)?;
    let predicted = pointmaps::divided(&predicted, scale);
    comparison.check("pred_normalised", &stack(&predicted)?);
    comparison.check(
        "gt_normalised",
        &stack(&pointmaps::divided(&truth, truth_scale))?,
    );

    let confidence = views(case.input("pred_conf")?)?;
    let confidence = confidence.iter().map(numbers);
    let views = predicted.into_iter().zip(confidence);
    let views = views.map(|(points, confidence)| {
        let confidence = confidence?;
        Ok(Pointmap { points, confidence })
    });
    let views: Vec<Pointmap> = views.collect::<Result<_>>()?;
    let unknown = vec![None; views.len()];
    let params = RecoveryParams::default();
    let recovered = recover_cameras_under_masks(&views, &valid, &unknown, &params, SEED, &Silent)?;
    let recovered = recovered.into_iter();
    let predicted_poses: Vec<Pose> = recovered
        .map(|view| Ok(view.outcome?.camera.cam_to_world))
        .collect::<Result<_>>()?;
    let truth_poses: Vec<Pose> = truth_poses
        .iter()
        .map(|pose| {
            let mut pose = to_first * pose;
            pose.translation.vector /= truth_scale;
            pose
        })
        .collect();
    let tensors = |poses: &[Pose]| -> Result<Tensor> {
        let tensors = poses.iter().map(pose_tensor).collect::<Result<Vec<_>>>()?;
        Ok(Tensor::stack(&tensors, 0)?)
    };
    comparison.check("c2w_pred", &tensors(&predicted_poses)?);
    comparison.check("c2w_gt_normalised", &tensors(&truth_poses)?);
    // The script looks at motions from the scene's frame: those of the inverse poses.
    let inverse = |pose: &Pose| pose.inverse();
    let predicted_poses: Vec<_> = (predicted_poses.iter())
        .map(|pose| Some(inverse(pose)))
        .collect();
    let truth_poses: Vec<Pose> = truth_poses.iter().map(inverse).collect();
    let pairs = poses::pair_errors(&predicted_poses, &truth_poses)?;
    let of_pairs =
        |of: fn(&poses::PairError) -> f64| Tensor::from_iter(pairs.iter().map(of), &Device::Cpu);
    comparison.check(
        "pair_rotation_deg",
        &of_pairs(|pair| rotation_of_the_script(pair.rotation_deg))?,
    );
    comparison.check(
        "pair_translation_deg",
        &of_pairs(|pair| pair.translation_deg)?,
    );
    let accuracy = poses::accuracy(&pairs)?;
    comparison.check("RRA_at_15", &scalar(accuracy.rra_15)?);
    comparison.check("RTA_at_15", &scalar(accuracy.rta_15)?);
    comparison.check("mAA_at_30", &scalar(accuracy.maa_30)?);
    Ok(())
}

/// A rotation error, in degrees, as the script has it: acos, within 1e-4 of ±1 continued by its tangent.
fn rotation_of_the_script(degrees: f64) -> f64 {
    const EDGE: f64 = 1.0 - 1e-4;
    let cosine = degrees.to_radians().cos();
    let edge = cosine.clamp(-EDGE, EDGE);
    (edge.acos() - (cosine - edge) / (1.0 - edge * edge).sqrt()).to_degrees()
}

fn pointmaps_of(case: &Case, points: &str, confidence: &str) -> Result<Vec<Pointmap>> {
    let points = views(case.input(points)?)?;
    let confidence = views(case.input(confidence)?)?;
    let views = points.iter().zip(&confidence);
    let view = |(points, confidence): (&Tensor, &Tensor)| {
        Ok(Pointmap {
            points: vectors(points)?,
            confidence: numbers(confidence)?,
        })
    };
    views.map(view).collect()
}

fn views(tensor: &Tensor) -> Result<Vec<Tensor>> {
    let views = 0..tensor.dim(0)?;
    views.map(|view| Ok(tensor.get(view)?)).collect()
}

/// A tensor (H, W).
fn numbers(tensor: &Tensor) -> Result<Map<f32>> {
    let (height, width) = tensor.dims2()?;
    let values = tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1()?;
    Map::new(width as u32, height as u32, values).context("a map")
}

/// A tensor (H, W, 3).
fn vectors(tensor: &Tensor) -> Result<Map<[f32; 3]>> {
    let (height, width, _) = tensor.dims3()?;
    let values = tensor.flatten_to(1)?.to_vec2::<f32>()?;
    let vector = |v: Vec<f32>| <[f32; 3]>::try_from(v).ok().context("not a vector");
    let values = values.into_iter().map(vector).collect::<Result<_>>()?;
    Map::new(width as u32, height as u32, values).context("a map")
}

fn stack(maps: &[Map<[f32; 3]>]) -> Result<Tensor> {
    let tensor = |map: &Map<[f32; 3]>| {
        let shape = (map.height() as usize, map.width() as usize, 3);
        Tensor::from_slice(map.values().as_flattened(), shape, &Device::Cpu)
    };
    let tensors: Vec<Tensor> = maps.iter().map(tensor).collect::<Result<_, _>>()?;
    Ok(Tensor::stack(&tensors, 0)?)
}

fn scalar(value: f64) -> Result<Tensor> {
    Ok(Tensor::new(&[value], &Device::Cpu)?)
}

fn pose_tensor(pose: &Pose) -> Result<Tensor> {
    Ok(Tensor::new(&matrix4::rows(pose), &Device::Cpu)?)
}

fn read_pose(tensor: &Tensor) -> Result<Pose> {
    let rows = tensor.to_dtype(DType::F64)?.to_vec2::<f64>()?;
    let rows = rows.into_iter().map(|row| <[f64; 4]>::try_from(row).ok());
    let rows: Vec<[f64; 4]> = rows.collect::<Option<_>>().context("not 4 columns")?;
    let rows: [[f64; 4]; 4] = rows.try_into().ok().context("not 4 rows")?;
    matrix4::from_rows(&rows).map_err(anyhow::Error::msg)
}
