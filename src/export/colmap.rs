use super::{
    ExportParams, Format,
    contents::{Contents, counted},
    photos,
};
use crate::{
    Result,
    exchange::colmap::{
        ColmapCamera, ColmapImage, ColmapPoint, Encoding, LensModel, Model, Observation,
        TrackElement,
    },
    geometry::Camera,
    scene::{Frame, Role, Scene},
};
use std::path::Path;

/// A photo sees a point if its depth there is the point's, give or take this share.
const SAME_DEPTH: f64 = 0.02;

pub(super) fn write(
    scene: &Scene,
    contents: &Contents,
    format: Format,
    folder: &Path,
    params: &ExportParams,
) -> Result<String> {
    let names: Vec<String> = if params.no_photos {
        let records = scene.records(Role::Input).iter();
        records
            .map(|record| photos::file_name(&record.photo))
            .collect()
    } else {
        let copies = photos::copies(scene, &folder.join("images"))?;
        let names = copies.iter().filter_map(|copy| copy.file_name());
        names
            .map(|name| name.to_string_lossy().into_owned())
            .collect()
    };
    let cameras = scene.records(Role::Input).iter().map(photos::camera);
    let model = model(
        contents,
        &cameras.collect::<Vec<_>>(),
        &names,
        params.max_points,
    );
    let encoding = match format {
        Format::ColmapText => Encoding::Text,
        _ => Encoding::Binary,
    };
    model.write(&folder.join("sparse/0"), encoding)?;
    let images = counted(model.images.len(), "image");
    let all = contents.cloud.len();
    Ok(match model.points.len() {
        points if points < all => format!("{images}, {points} of {all} points"),
        points => format!("{images}, {}", counted(points, "point")),
    })
}

/// Ids count from 1; each image has a camera of its own.
fn model(contents: &Contents, cameras: &[Camera], names: &[String], max_points: usize) -> Model {
    let ids = 1..;
    let lens = |(id, camera): (u32, &Camera)| ColmapCamera {
        id,
        model: LensModel::PINHOLE,
        intrinsics: camera.intrinsics,
        distortion: vec![],
    };
    let image = |((id, camera), name): ((u32, &Camera), &String)| ColmapImage {
        id,
        name: name.clone(),
        camera: id,
        cam_to_world: camera.cam_to_world,
        observations: vec![],
    };
    let mut images: Vec<_> = ids.clone().zip(cameras).zip(names).map(image).collect();
    let all = contents.cloud.len();
    let count = all.min(max_points);
    let points = (0..count).map(|k| {
        let index = (k as u64 * all as u64 / count as u64) as usize;
        point(contents, index, k as u64 + 1, &mut images)
    });
    let points = points.collect();
    Model {
        cameras: ids.zip(cameras).map(lens).collect(),
        images,
        points,
    }
}

/// A point, which becomes an observation of all images that see it. One that was moved is where no photo
/// has seen it.
fn point(contents: &Contents, index: usize, id: u64, images: &mut [ColmapImage]) -> ColmapPoint {
    let cloud = &contents.cloud;
    let mut track = Vec::new();
    if contents.motions.is_still(index) {
        for (frame, image) in contents.frames.iter().zip(images) {
            let Some(pixel) = sees(frame, contents, index) else {
                continue;
            };
            track.push(TrackElement {
                image: image.id,
                observation: image.observations.len() as u32,
            });
            image.observations.push(Observation {
                pixel: frame.transform.to_photo(pixel),
                point: Some(id),
            });
        }
    }
    ColmapPoint {
        id,
        position: cloud.positions[index].map(f64::from),
        colour: cloud.colours[index],
        // Observations are where the point projects to.
        error: if track.is_empty() { -1.0 } else { 0.0 },
        track,
    }
}

/// Where a frame sees a point, if it does.
fn sees(frame: &Frame, contents: &Contents, index: usize) -> Option<[f64; 2]> {
    let ([u, v], z) = frame.camera.project(&contents.cloud.point(index))?;
    let pixel = frame.depth.nearest(u, v)?;
    let depth = f64::from(frame.depth.values()[pixel]);
    ((depth - z).abs() <= SAME_DEPTH * z).then_some([u, v])
}
