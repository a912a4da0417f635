//! Photos whose cameras are known, with depth or points: reconstruction that needs no network.
//!
//! A folder in any known layout ([`Layout`]) becomes a [`Recording`], which is a [`Reconstructor`]: depth,
//! intrinsics and pose are looked up, brought to OpenCV's axes and to one size per frame. Opening reads
//! names, text and picture headers only and checks all it can, so most mistakes show before any work is
//! done.

mod depth_bin;
mod folder_pictures;
mod frame_list;
mod layouts;
mod listing;
mod options;
mod packed;
mod pictures;
mod points;
mod poses;
mod reduce;
mod resample;
mod selection;
mod sizes;
#[cfg(test)]
pub(crate) mod test_room;
#[cfg(test)]
mod tests;
mod view;

pub use frame_list::FrameList;
pub use layouts::Layout;
pub use options::{ImportOptions, IntrinsicsImage};

use crate::{
    Error, Map, Result,
    geometry::Lens,
    photos::Photo,
    progress::Progress,
    reconstruct::{Reconstruction, Reconstructor},
    scene::{Frame, Scale},
};
use layouts::npz;
use listing::{ArchiveKind, DepthSource};
use points::PointsFile;
use rayon::prelude::*;
use selection::{Chosen, Selection};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};
use view::View;

/// A recording, opened but not decoded.
#[derive(Debug)]
pub struct Recording {
    /// The photos to reconstruct the scene from, in the order asked for.
    pub inputs: Vec<Photo>,
    /// The photos held out as test views; these may lack depth.
    pub held_out: Vec<Photo>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// The layout that the folder has.
    pub layout: Layout,
    /// What the units are.
    pub scale: Scale,
    /// Of the inputs, then the held out.
    views: Vec<View>,
    options: ImportOptions,
}

impl Recording {
    /// Opens the recording in `folder` (or, of ScanNet, a `.sens` file).
    ///
    /// Photos that are no files of their own, or that have to be undistorted, are written into
    /// `photos_folder` when they are read.
    ///
    /// # Errors
    /// When the folder has none of the layouts, a file that is needed is missing or damaged, what
    /// `options` ask for does not exist, or photo, depth, intrinsics and pose do not fit each other.
    pub fn open(folder: &Path, options: &ImportOptions, photos_folder: &Path) -> Result<Self> {
        if options
            .max_depth
            .is_some_and(|far| far <= options.min_depth)
        {
            return Err(Error::request(
                "--max-depth is not above --min-depth",
                "swap them or leave one out",
            ));
        }
        let layout = Layout::recognise(folder, options)?;
        let listing = layout.list(folder, options)?;
        let mut warnings = listing.warnings;
        let selection = Selection::choose(&listing.entries, folder, options)?;
        warnings.extend(selection.warnings);

        let usual_depth = selection
            .inputs
            .iter()
            .find_map(|chosen| chosen.entry.depth.as_ref());
        let usual_depth_size = usual_depth.map_or(Ok(None), DepthSource::size)?;
        let settle =
            |chosen: &Chosen<'_>| View::new(chosen, usual_depth_size, options, photos_folder);
        let chosen = selection.inputs.iter().chain(&selection.held_out);
        let views: Vec<View> = chosen.map(settle).collect::<Result<_>>()?;
        warnings.extend(mirror_warning(folder, &views)?);
        warnings.extend(as_stored_warning(&views));
        for view in &views {
            for assumption in &view.assumptions {
                if !warnings.contains(assumption) {
                    warnings.push(assumption.clone());
                }
            }
        }

        check_names(folder, &views)?;
        let mut photos: Vec<Photo> = views.iter().map(|view| view.photo.clone()).collect();
        let held_out = photos.split_off(selection.inputs.len());
        Ok(Self {
            inputs: photos,
            held_out,
            warnings,
            layout,
            scale: listing.scale,
            views,
            options: options.clone(),
        })
    }

    /// The number by which users name a photo.
    ///
    /// # Errors
    /// When the photo is not of this recording.
    pub fn number(&self, photo: &Photo) -> Result<u64> {
        Ok(self.view(photo)?.number)
    }

    fn view(&self, photo: &Photo) -> Result<&View> {
        let found = self.views.iter().find(|view| view.photo == *photo);
        found.ok_or_else(|| {
            Error::request(
                format!("the photo {} is not one that was opened", photo.name),
                "ask for the recording's inputs and held-out photos",
            )
        })
    }
}

impl Reconstructor for Recording {
    /// Looks the photos up among [`Recording::inputs`] and [`Recording::held_out`].
    ///
    /// The confidence is 1 everywhere: a depth camera gives none. An input without any known depth
    /// is refused, a held-out photo may be so.
    fn reconstruct(&self, photos: &[Photo], progress: &dyn Progress) -> Result<Reconstruction> {
        let views: Vec<&View> = photos
            .iter()
            .map(|photo| self.view(photo))
            .collect::<Result<_>>()?;
        progress.begin("reading photos and depth", views.len());
        let frames: Result<Vec<Frame>> = Shared::read(&views).and_then(|shared| {
            let read = |view: &&View| {
                let frame = view.frame(&shared, &self.options)?;
                self.check_depth(&frame, view)?;
                progress.advance(1);
                Ok(frame)
            };
            // All, so that the error is the first photo's and not the fastest thread's.
            let frames: Vec<Result<Frame>> = views.par_iter().map(read).collect();
            frames.into_iter().collect()
        });
        progress.end();
        Ok(frames?.into())
    }
}

impl Recording {
    fn check_depth(&self, frame: &Frame, view: &View) -> Result<()> {
        let empty = frame.depth.values().iter().all(|depth| *depth == 0.0);
        match &view.depth {
            Some(depth) if empty && self.inputs.contains(&view.photo) => Err(Error::file(
                depth.path(),
                format!(
                    "has no known depth for the photo {} in the range asked for",
                    view.photo.name
                ),
                "leave this frame out with --frames, or check --min-depth, --max-depth and \
                 --depth-scale",
            )),
            _ => Ok(()),
        }
    }
}

/// What several views have in common, read once.
#[derive(Default)]
struct Shared {
    /// Depth maps of an archive, by their place in it.
    archived: BTreeMap<usize, Map<f32>>,
    /// The recording's points.
    points: Vec<[f64; 3]>,
}

impl Shared {
    /// What these views need.
    fn read(views: &[&View]) -> Result<Self> {
        let mut archive = None;
        let mut wanted = BTreeSet::new();
        let mut points = None;
        for view in views {
            match &view.depth {
                Some(DepthSource::Archive {
                    path, kind, index, ..
                }) => {
                    archive = Some((path, kind));
                    wanted.insert(*index);
                }
                Some(DepthSource::Points(file)) => points = Some(file),
                _ => {}
            }
        }
        Ok(Self {
            archived: match archive {
                None => BTreeMap::new(),
                Some((path, ArchiveKind::Npz)) => npz::read_depths(path, &wanted)?,
                Some((path, ArchiveKind::DepthBin)) => depth_bin::read_depths(path, &wanted)?,
            },
            points: points.map_or(Ok(Vec::new()), PointsFile::load)?,
        })
    }
}

/// Names become folders of the scene.
fn check_names(folder: &Path, views: &[View]) -> Result<()> {
    let mut seen = BTreeSet::new();
    for View { photo, .. } in views {
        let usable = !photo.name.is_empty()
            && !photo.name.starts_with('.')
            && !photo.name.contains(['/', '\\', '\0']);
        if !usable || !seen.insert(&photo.name) {
            return Err(Error::file(
                folder,
                format!(
                    "has a photo whose name cannot be used, or two of them: '{}'",
                    photo.name
                ),
                "rename it",
            ));
        }
    }
    Ok(())
}

/// All views must have gone through the same mirror, or they are not in one world.
fn mirror_warning(folder: &Path, views: &[View]) -> Result<Option<String>> {
    let Some(first) = views.first() else {
        return Ok(None);
    };
    if views.iter().any(|view| view.mirror != first.mirror) {
        return Err(Error::file(
            folder,
            "some of the poses or focal lengths are mirrored and others are not",
            "write all of them with the same axes",
        ));
    }
    Ok(first.mirror.map(|[x, _]| {
        let axis = if x < 0.0 { "x" } else { "y" };
        format!(
            "the focal length along {axis} is negative, so the recording's world is left-handed; \
             its {axis} axis was negated (the world was mirrored) so that the scene is not"
        )
    }))
}

fn as_stored_warning(views: &[View]) -> Option<String> {
    let names: Vec<&str> = views
        .iter()
        .filter(|view| view.photo.as_stored)
        .map(|view| &*view.photo.name)
        .collect();
    let first = names.first()?;
    Some(format!(
        "{} photos ({first} the first) are used as stored, not turned as their EXIF data say, \
         because so they fit the depth",
        names.len()
    ))
}
