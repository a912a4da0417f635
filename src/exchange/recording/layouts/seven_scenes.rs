//! The layout of 7-Scenes (Shotton et al., CVPR 2013) and 3DMatch: `frame-N.color.png`,
//! `frame-N.depth.png` (millimetres), `frame-N.pose.txt` (camera to world).

use crate::exchange::recording::{
    ImportOptions, Lens,
    folder_pictures::names,
    listing::{DepthSource, Entry, Listing, PhotoSource, PoseSource},
    poses,
};
use crate::{Error, Result, scene::Scale};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

const INTRINSICS: &str = "camera-intrinsics.txt";
const MILLIMETRES: f64 = 1000.0;

/// Whether `folder`, or sequences in it, have such frames.
pub(super) fn fits(folder: &Path) -> Result<bool> {
    Ok(has_frames(folder)? || !sequences(folder)?.is_empty())
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let folder = &frames_folder(folder)?;
    let mut colour = BTreeMap::new();
    let mut depth = BTreeMap::new();
    let mut pose = BTreeMap::new();
    for name in names(folder)? {
        let Some((number, kind)) = parse_name(&name) else {
            continue;
        };
        let files = match kind {
            Kind::Colour => &mut colour,
            Kind::Depth => &mut depth,
            Kind::Pose => &mut pose,
        };
        if let Some(other) = files.insert(number, name.clone()) {
            return Err(Error::file(
                folder,
                format!("both {other} and {name} belong to frame {number}"),
                "remove one of them",
            ));
        }
    }
    let (lens, lens_from) = lens(folder, options)?;
    let units_per_length = options.depth_scale.unwrap_or(MILLIMETRES);
    let entries = colour.into_iter().map(|(number, photo)| Entry {
        number,
        name: photo.split('.').next().unwrap_or(&photo).to_string(),
        photo: PhotoSource::File(folder.join(&photo)),
        depth: depth.remove(&number).map(|name| DepthSource::Picture {
            path: folder.join(name),
            units_per_length,
        }),
        pose: PoseSource::File(match pose.remove(&number) {
            Some(name) => folder.join(name),
            None => folder.join(format!("frame-{number:06}.pose.txt")),
        }),
        lens: lens.into(),
        depth_lens: None,
        lens_from: lens_from.clone(),
    });
    Ok(Listing {
        entries: entries.collect(),
        warnings: Vec::new(),
        scale: Scale::Metric,
    })
}

enum Kind {
    Colour,
    Depth,
    Pose,
}

fn parse_name(name: &str) -> Option<(u64, Kind)> {
    let (digits, kind) = name.strip_prefix("frame-")?.split_once('.')?;
    let kind = match kind {
        "color.png" | "color.jpg" | "color.jpeg" => Kind::Colour,
        "depth.png" => Kind::Depth,
        "pose.txt" => Kind::Pose,
        _ => return None,
    };
    let number = digits.bytes().all(|b| b.is_ascii_digit());
    Some((digits.parse().ok().filter(|_| number)?, kind))
}

fn has_frames(folder: &Path) -> Result<bool> {
    Ok(names(folder)?
        .iter()
        .any(|name| matches!(parse_name(name), Some((_, Kind::Colour)))))
}

fn sequences(folder: &Path) -> Result<Vec<String>> {
    let mut sequences = names(folder)?;
    sequences.retain(|name| name.starts_with("seq-") && folder.join(name).is_dir());
    let mut with_frames = Vec::new();
    for name in sequences {
        if has_frames(&folder.join(&name))? {
            with_frames.push(name);
        }
    }
    Ok(with_frames)
}

fn frames_folder(folder: &Path) -> Result<PathBuf> {
    if has_frames(folder)? {
        return Ok(folder.to_path_buf());
    }
    match &*sequences(folder)? {
        [only] => Ok(folder.join(only)),
        [] => Err(Error::file(
            folder,
            "holds no frame-N.color.png or frame-N.color.jpg",
            "give the folder of a 7-Scenes or 3DMatch sequence",
        )),
        several => Err(Error::file(
            folder,
            format!("holds several sequences: {}", several.join(", ")),
            format!(
                "give one of them, as in {}",
                folder.join(&several[0]).display()
            ),
        )),
    }
}

fn lens(folder: &Path, options: &ImportOptions) -> Result<(Lens, PathBuf)> {
    if let Some(lens) = options.intrinsics {
        return Ok((lens, folder.to_path_buf()));
    }
    // `.` has a parent only once its name is known.
    let parent = folder.canonicalize().map_err(Error::io("read", folder))?;
    let parent = parent.parent().map(|parent| parent.join(INTRINSICS));
    let candidates = [Some(folder.join(INTRINSICS)), parent];
    let Some(path) = candidates.into_iter().flatten().find(|path| path.exists()) else {
        return Err(Error::file(
            folder,
            format!("there is no {INTRINSICS} here or in the folder above"),
            "give --intrinsics fx,fy,cx,cy; for the 7-Scenes data set it is usually \
             --intrinsics 585,585,320,240",
        ));
    };
    let text = fs::read_to_string(&path).map_err(Error::io("read", &path))?;
    let lens = poses::numbers(&text).and_then(|numbers| Lens::from_numbers(&numbers));
    let lens = lens.map_err(|problem| {
        Error::file(
            &path,
            format!("holds no intrinsics: {problem}"),
            "correct the file or give --intrinsics fx,fy,cx,cy",
        )
    })?;
    Ok((lens, path))
}
