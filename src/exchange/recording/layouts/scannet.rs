//! The frames of ScanNet (Dai et al., CVPR 2017) as its own reader extracts them: `color/N.jpg`,
//! `depth/N.png` (millimetres), `pose/N.txt` (4x4, camera to world), and a 4x4 camera matrix each for
//! photos and depth.

use crate::exchange::recording::{
    ImportOptions, Lens,
    folder_pictures::{DEPTH_ENDINGS, Pictures, depth_by_number},
    listing::{DepthSource, Entry, Listing, PhotoSource, PoseSource, StatedLens},
    pictures::PictureHeader,
    poses,
};
use crate::{Error, Result, photos::PHOTO_ENDINGS, scene::Scale};
use std::{
    fs,
    path::{Path, PathBuf},
};

const MILLIMETRES: f64 = 1000.0;
/// A principal point farther off centre than this share of a side is that of another image.
const OFF_CENTRE: f64 = 0.25;
/// Where the camera matrices are: extracted recordings, and the frames of the benchmark.
const COLOUR_LENS: [&str; 3] = [
    "intrinsic/intrinsic_color.txt",
    "intrinsic_color.txt",
    "intrinsics_color.txt",
];
const DEPTH_LENS: [&str; 3] = [
    "intrinsic/intrinsic_depth.txt",
    "intrinsic_depth.txt",
    "intrinsics_depth.txt",
];

/// Whether `folder` has the three folders of frames.
pub(super) fn fits(folder: &Path) -> bool {
    ["color", "depth", "pose"]
        .iter()
        .all(|name| folder.join(name).is_dir())
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let photos_folder = folder.join("color");
    let photos = Pictures::list(&photos_folder, &PHOTO_ENDINGS)?;
    let depth = Pictures::list(&folder.join("depth"), &DEPTH_ENDINGS)?;
    let mut depth = depth_by_number(&photos, depth, folder)?;
    let mut warnings = photos.warnings(&photos_folder);
    let first_depth = depth.values().next();
    let (lens, depth_lens, lens_from) = match options.intrinsics {
        Some(lens) => (lens.into(), None, folder.to_path_buf()),
        None => lenses(folder, &photos.files[0].path, first_depth, &mut warnings)?,
    };
    let units_per_length = options.depth_scale.unwrap_or(MILLIMETRES);
    let names = photos.unique_names();
    let entries = photos.files.into_iter().zip(names);
    let entries = entries.map(|(photo, name)| Entry {
        number: photo.number,
        name,
        depth: depth
            .remove(&photo.number)
            .map(|path| DepthSource::Picture {
                path,
                units_per_length,
            }),
        pose: PoseSource::File(folder.join("pose").join(format!("{}.txt", photo.stem))),
        photo: PhotoSource::File(photo.path),
        lens,
        depth_lens,
        lens_from: lens_from.clone(),
    });
    Ok(Listing {
        entries: entries.collect(),
        warnings,
        scale: Scale::Metric,
    })
}

/// The lenses of photos and, if it is another, depth; and the file that states the first.
fn lenses(
    folder: &Path,
    photo: &Path,
    depth: Option<&PathBuf>,
    warnings: &mut Vec<String>,
) -> Result<(StatedLens, Option<StatedLens>, PathBuf)> {
    let own = read_lens(folder, &DEPTH_LENS)?;
    let (path, lens, own_path, own) = match (read_lens(folder, &COLOUR_LENS)?, own) {
        (Some((path, lens)), Some((own_path, own))) => (path, lens, own_path, own),
        (Some((path, lens)), None) | (None, Some((path, lens))) => {
            return Ok((lens.into(), None, path));
        }
        (None, None) => {
            return Err(Error::file(
                folder,
                format!("holds no intrinsics ({})", COLOUR_LENS.join(", ")),
                "extract them too, or give --intrinsics fx,fy,cx,cy",
            ));
        }
    };
    let photo = PictureHeader::read(photo)?.size;
    if lens.on_image(photo).is_ok() && lens.off_centre(photo) < OFF_CENTRE {
        let stated = StatedLens {
            size: Some(photo),
            ..lens.into()
        };
        return Ok((stated, Some(own.into()), path));
    }
    // The reader can make photos smaller as it extracts them, and leaves the matrix as it was.
    if depth
        .map(|path| PictureHeader::read_depth(path))
        .transpose()?
        .map(|header| header.size)
        == Some(photo)
    {
        warnings.push(format!(
            "{} is not of the photos, which were resized to the depth's size; the lens of the depth is \
             taken for both",
            path.display()
        ));
        return Ok((own.into(), None, own_path));
    }
    Err(Error::file(
        &path,
        format!(
            "is the lens of other photos than those here, which are {}x{}",
            photo[0], photo[1]
        ),
        "give theirs with --intrinsics fx,fy,cx,cy",
    ))
}

fn read_lens(folder: &Path, names: &[&str]) -> Result<Option<(PathBuf, Lens)>> {
    let candidates = names.iter().map(|name| folder.join(name));
    let Some(path) = candidates.into_iter().find(|path| path.is_file()) else {
        return Ok(None);
    };
    let text = fs::read_to_string(&path).map_err(Error::io("read", &path))?;
    let lens = poses::matrix(&text).and_then(|rows| {
        let rows = rows.ok_or("it is not all finite numbers")?;
        Lens::from_matrix(&std::array::from_fn(|row| {
            std::array::from_fn(|column| rows[row][column])
        }))
    });
    match lens {
        Ok(lens) => Ok(Some((path, lens))),
        Err(problem) => Err(Error::file(
            &path,
            format!("holds no 4x4 camera matrix: {problem}"),
            "correct the file or give --intrinsics fx,fy,cx,cy",
        )),
    }
}
