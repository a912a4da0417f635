//! From a scene to files for other programs: what goes into each format of [`crate::exchange`].
//!
//! Clouds are edited ones; photos and their cameras are as they were photographed, lenses those of the
//! photos in their original size. PLY, splats, COLMAP and `cameras.json` are in the scene's frame, GLB,
//! recordings of Rerun and `transforms.json` upright in the floor's.
//!
//! One instance for a program that reads the format of the file's name:
//!
//! ```
//! use std::path::Path;
//! use tid3r::{
//!     Error, Result,
//!     export::{ExportParams, Format, export},
//!     scene::Scene,
//! };
//!
//! fn export_chair(scene: &Path, output: &Path) -> Result<String> {
//!     let unknown = || Error::request("the name says no format", "end it in .ply or .glb");
//!     let format = Format::of(output).ok_or_else(unknown)?;
//!     let only = vec!["chair".to_string()];
//!     let params = ExportParams { only, no_photos: false, depth: false, max_points: 100_000 };
//!     export(&Scene::open(scene)?, format, output, &params)
//! }
//!
//! assert_eq!(Format::of(Path::new("chair.glb")), Some(Format::Glb));
//! let error = export_chair(Path::new("room"), Path::new("chair.obj")).unwrap_err();
//! assert_eq!(error.to_string(), "the name says no format; end it in .ply or .glb");
//! ```

mod cameras;
mod clouds;
mod colmap;
mod contents;
mod depth;
mod format;
mod photos;
mod rrd;
mod splats;
mod transforms;

pub use format::Format;

use crate::{Error, Result, exchange::cameras::CameraFile, scene::Scene};
use contents::Contents;
use std::{fs, path::Path};

/// What of a scene is exported, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportParams {
    /// Only the points of these instances, by id or name; all points if empty.
    pub only: Vec<String>,
    /// Without the photos.
    pub no_photos: bool,
    /// With depth maps, in `transforms.json` and recordings of Rerun.
    pub depth: bool,
    /// How many points a COLMAP model gets at most.
    pub max_points: usize,
}

/// Writes `scene` to `output`, a file or a folder as the format has it, and says what that is.
///
/// # Errors
/// When the scene lacks what the format is of, `only` names what there is not, a parameter means nothing for
/// the format, a folder to be written holds other things, or a file cannot be read or written.
pub fn export(
    scene: &Scene,
    format: Format,
    output: &Path,
    params: &ExportParams,
) -> Result<String> {
    let without_use = [
        ("--only", !params.only.is_empty() && !format.is_of_points()),
        ("--depth", params.depth && !format.can_have_depth()),
        (
            "--no-photos",
            params.no_photos && !format.comes_with_photos(),
        ),
    ];
    if let Some((option, _)) = without_use.iter().find(|(_, given)| *given) {
        let problem = format!("{option} means nothing for the format {format}");
        return Err(Error::request(problem, format!("leave out {option}")));
    }
    if format.is_folder() {
        refuse_full_folder(output)?;
    }
    let contents = || Contents::load(scene, &params.only);
    match format {
        Format::Ply => clouds::write_ply(scene, &contents()?, output),
        Format::Instances => clouds::write_instances(scene, &contents()?, output),
        Format::Glb => clouds::write_glb(scene, &contents()?, output),
        Format::Rrd => rrd::write(scene, output, params),
        Format::Html => crate::viewer::offline::write(scene, output),
        Format::Splats => splats::write(scene, &contents()?, output),
        Format::Colmap | Format::ColmapText => {
            colmap::write(scene, &contents()?, format, output, params)
        }
        Format::Transforms => transforms::write(scene, &contents()?, output, params),
        Format::Cameras => {
            let file: CameraFile = cameras::file(scene);
            file.write(output)?;
            Ok(cameras::count(file.views.len()))
        }
        Format::Depth => depth::write(scene, output),
    }
}

/// A folder is written anew: what an earlier export left there would be taken for this one's.
fn refuse_full_folder(folder: &Path) -> Result<()> {
    let problem = match fs::read_dir(folder).map(|mut entries| entries.next().is_some()) {
        Ok(false) => return Ok(()),
        Ok(true) => "is a folder with things in it",
        Err(_) if folder.exists() => "is a file where a folder is to be written",
        Err(_) => return Ok(()),
    };
    Err(Error::file(folder, problem, "give a new or empty folder"))
}
