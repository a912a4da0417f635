use super::{
    ExportParams,
    contents::{Contents, counted},
    depth, photos,
};
use crate::{
    Error, Map, Result,
    exchange::{
        ply,
        transforms::{Distortion, Transforms, TransformsFrame},
    },
    geometry::{Pose, matrix4},
    scene::{Frame, Role, Scene, files},
};
use std::path::Path;

/// Writes `transforms.json`, and what it refers to beside it: `points.ply`, photos in `images/`, and depth in
/// `depth/`. A path that does not end in `.json` is the folder. nerfstudio has z up, so all is in the floor's frame, which `applied_transform` tells.
pub(super) fn write(
    scene: &Scene,
    contents: &Contents,
    path: &Path,
    params: &ExportParams,
) -> Result<String> {
    let is_file = path
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("json"));
    let path = if is_file {
        path.to_path_buf()
    } else {
        path.join("transforms.json")
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    let to_floor = scene.manifest().floor_to_world.inverse();
    let files = match params.no_photos {
        true => photos::originals(scene)?,
        false => photos::copies(scene, &folder.join("images"))?,
    };
    let mut frames = Vec::new();
    for (record, file) in scene.records(Role::Input).iter().zip(&files) {
        let camera = photos::camera(record);
        frames.push(TransformsFrame {
            file_path: beside(folder, file)?,
            depth_file_path: params.depth.then(|| depth_path(&record.photo.name)),
            cam_to_world: to_floor * camera.cam_to_world,
            intrinsics: camera.intrinsics,
            distortion: Distortion::default(),
        });
    }
    let depth_unit = match params.depth {
        true => Some(write_depth(scene, folder)?),
        false => None,
    };
    write_points(scene, contents, &to_floor, &folder.join(POINTS))?;
    let [x, y, z, _] = matrix4::rows(&to_floor);
    let transforms = Transforms {
        frames,
        ply_file_path: Some(POINTS.into()),
        depth_unit_scale_factor: depth_unit,
        applied_transform: Some([x, y, z]),
    };
    transforms.write(&path)?;
    let photos = counted(transforms.frames.len(), "photo");
    Ok(format!(
        "{photos}, {}",
        counted(contents.cloud.len(), "point")
    ))
}

const POINTS: &str = "points.ply";

fn depth_path(name: &str) -> String {
    format!("depth/{name}.png")
}

/// A file as one in `folder` refers to it.
fn beside(folder: &Path, file: &Path) -> Result<String> {
    let path = file.strip_prefix(folder).unwrap_or(file);
    let text = path
        .to_str()
        .ok_or_else(|| Error::file(file, "has a name that JSON cannot hold", "rename the photo"))?;
    Ok(text.to_string())
}

fn write_points(scene: &Scene, contents: &Contents, to_floor: &Pose, path: &Path) -> Result<()> {
    let mut cloud = contents.cloud.clone();
    for index in 0..cloud.len() {
        let point = to_floor * cloud.point(index);
        cloud.positions[index] = point.coords.map(|x| x as f32).into();
    }
    ply::write_cloud(path, &cloud, scene.manifest().scale)
}

/// Writes the depth of each photo, and gives the unit that it is in.
fn write_depth(scene: &Scene, folder: &Path) -> Result<f64> {
    let frames = depth::cleaned(scene)?;
    let unit = depth::depth_unit(&frames, scene.manifest().scale);
    for frame in &frames {
        let path = folder.join(depth_path(&frame.photo.name));
        files::write_label_png(&path, &depth::in_steps(&of_whole_photo(frame), unit))?;
    }
    Ok(unit)
}

/// The depth of a frame with unknown depth around it for what was cut off its photo, since other programs
/// stretch depth maps to the photo's size.
fn of_whole_photo(frame: &Frame) -> Map<f32> {
    let transform = &frame.transform;
    let size: [u32; 2] = std::array::from_fn(|axis| {
        let share = f64::from(transform.photo_size[axis]) / transform.crop_size[axis];
        (f64::from(transform.frame_size[axis]) * share)
            .round()
            .max(1.0) as u32
    });
    let photo = transform.intrinsics_of_photo(&frame.camera.intrinsics);
    let whole = photo.resized(size[0], size[1]);
    let (lens, depth) = (&frame.camera.intrinsics, &frame.depth);
    Map::from_fn(size[0], size[1], |x, y| {
        let ray = whole.unproject(x.into(), y.into(), 1.0);
        let seen = lens.project(&ray).and_then(|[u, v]| depth.nearest(u, v));
        seen.map_or(0.0, |pixel| depth.values()[pixel])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{photos::PhotoTransform, scene::test_frames};

    #[test]
    fn depth_lies_where_the_frame_was_cut_out_of_the_photo() {
        let depth = Map::from_fn(32, 24, |x, y| 1.0 + x as f32 + 100.0 * y as f32);
        let mut frame = test_frames::frame(0.0, depth.clone());
        assert_eq!(of_whole_photo(&frame), depth, "not cut");
        // Twice as large, with a frame cut out of the middle.
        frame.transform = PhotoTransform {
            photo_size: [80, 60],
            crop_origin: [8.0, 6.0],
            crop_size: [64.0, 48.0],
            frame_size: [32, 24],
        };
        let whole = of_whole_photo(&frame);
        assert_eq!((whole.width(), whole.height()), (40, 30));
        for y in 0..30 {
            for x in 0..40 {
                let inside = (4..36).contains(&x) && (3..27).contains(&y);
                let wanted = if inside { depth[(x - 4, y - 3)] } else { 0.0 };
                assert_eq!(whole[(x, y)], wanted, "({x}, {y})");
            }
        }
    }
}
