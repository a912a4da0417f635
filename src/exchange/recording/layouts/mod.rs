//! The layouts of recordings, one file each: what `fits`, and a `list` of what is there.

mod cameras;
mod colmap;
mod color_depth;
mod nerfstudio;
pub(super) mod npz;
mod posed;
mod replica;
mod scannet;
mod scannetpp_dslr;
mod scannetpp_iphone;
mod sens;
mod seven_scenes;
mod tum;

use crate::{
    Error, Result,
    exchange::recording::{ImportOptions, folder_pictures::names, listing::Listing},
    photos,
};
use clap::ValueEnum;
use serde::Serialize;
use std::path::Path;

/// How a recording is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// frame-N.color.png, frame-N.depth.png, frame-N.pose.txt (7-Scenes, 3DMatch)
    SevenScenes,
    /// rgb/ and condition.npz
    Npz,
    /// color/ (or rgb/), depth/ and a file of poses
    ColorDepth,
    /// ScanNet's scene.sens, or a folder with one
    Sens,
    /// ScanNet's extracted frames: color/, depth/, pose/, intrinsic/
    Scannet,
    /// ScanNet++ by iPhone: rgb/, depth/ or depth.bin, pose_intrinsic_imu.json
    ScannetppIphone,
    /// ScanNet++ by DSLR: resized_undistorted_images/ or resized_images/, nerfstudio/, colmap/
    ScannetppDslr,
    /// TUM RGB-D: rgb.txt, depth.txt, groundtruth.txt
    Tum,
    /// Replica as in NICE-SLAM: results/, traj.txt, cam_params.json
    Replica,
    /// nerfstudio's transforms.json, with depth or points
    Nerfstudio,
    /// A COLMAP model (sparse/0) and images/
    Colmap,
    /// Photos alone, their cameras given by --cameras
    Cameras,
}

impl Layout {
    /// What users call it.
    fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_string())
    }

    /// What the recording has to hold.
    fn contents(self) -> &'static str {
        match self {
            Self::SevenScenes => "frame-N.color.png, frame-N.depth.png and frame-N.pose.txt",
            Self::Npz => "rgb/ and condition.npz",
            Self::ColorDepth => "color/ or rgb/, depth/ and pose.txt",
            Self::Sens => "a .sens file",
            Self::Scannet => "color/, depth/, pose/ and intrinsic/",
            Self::ScannetppIphone => "rgb/, depth.bin and pose_intrinsic_imu.json",
            Self::Tum => "rgb.txt, depth.txt and groundtruth.txt",
            Self::Replica => "results/ and traj.txt",
            Self::ScannetppDslr => "resized_images/, nerfstudio/ and colmap/",
            Self::Nerfstudio => "transforms.json",
            Self::Colmap => "sparse/0 and images/",
            Self::Cameras => "photos, and --cameras",
        }
    }

    fn fits(self, folder: &Path) -> Result<bool> {
        Ok(match self {
            Self::SevenScenes => seven_scenes::fits(folder)?,
            Self::Npz => npz::fits(folder),
            Self::ColorDepth => color_depth::fits(folder),
            Self::Sens => sens::fits(folder)?,
            Self::Scannet => scannet::fits(folder),
            Self::ScannetppIphone => scannetpp_iphone::fits(folder),
            Self::Tum => tum::fits(folder),
            Self::Replica => replica::fits(folder),
            Self::ScannetppDslr => scannetpp_dslr::fits(folder),
            Self::Nerfstudio => nerfstudio::fits(folder),
            Self::Colmap => colmap::fits(folder),
            // Recognised by the option.
            Self::Cameras => false,
        })
    }

    /// Whether recordings of this layout have the folders of [`Layout::ColorDepth`] as well.
    fn refines_color_depth(self) -> bool {
        matches!(
            self,
            Self::Scannet | Self::ScannetppIphone | Self::Tum | Self::Nerfstudio
        )
    }

    /// The layout of what is at `path`, or the one that `options` ask for.
    pub(in crate::exchange::recording) fn recognise(
        path: &Path,
        options: &ImportOptions,
    ) -> Result<Self> {
        let choice = match &options.cameras {
            Some(_) => options.layout.or(Some(Self::Cameras)),
            None => options.layout,
        };
        let is_sens = path.is_file() && path.extension().is_some_and(|ending| ending == "sens");
        if is_sens && choice.is_none_or(|choice| choice == Self::Sens) {
            return Ok(Self::Sens);
        }
        if !path.is_dir() {
            if photos::is_archive(path) {
                return Err(Error::file(
                    path,
                    "is a ZIP file, which recordings are not read from",
                    "unpack it, and give the folder; photos without cameras or depth are for `tid3r reconstruct`",
                ));
            }
            let problem = match path.exists() {
                true => "is not a folder",
                false => "does not exist",
            };
            return Err(Error::file(
                path,
                problem,
                "give the folder of a recording, or a .sens file (for a file of cameras, the photos' folder and \
                 --cameras)",
            ));
        }
        // What cannot be listed cannot be recognised: say so rather than "no layout".
        names(path)?;
        if let Some(choice) = choice {
            return Ok(choice);
        }
        let mut fitting = Vec::new();
        for &layout in Self::value_variants() {
            if layout.fits(path)? {
                fitting.push(layout);
            }
        }
        if fitting.iter().any(|layout| layout.refines_color_depth()) {
            fitting.retain(|&layout| layout != Self::ColorDepth);
        }
        match *fitting {
            [layout] => Ok(layout),
            [] => {
                let known = Self::value_variants().iter();
                let known =
                    known.map(|layout| format!("{} ({})", layout.contents(), layout.name()));
                Err(Error::file(
                    path,
                    "holds no recording that tid3r knows",
                    format!(
                        "give a folder with {}",
                        known.collect::<Vec<_>>().join("; with ")
                    ),
                ))
            }
            _ => {
                let fitting: Vec<String> = fitting.iter().map(|layout| layout.name()).collect();
                Err(Error::file(
                    path,
                    format!("fits several layouts: {}", fitting.join(", ")),
                    "choose one with --layout",
                ))
            }
        }
    }

    /// What the recording at `folder` holds.
    pub(in crate::exchange::recording) fn list(
        self,
        folder: &Path,
        options: &ImportOptions,
    ) -> Result<Listing> {
        let without = |option: &str, given: bool| {
            if given {
                return Err(Error::request(
                    format!("{option} means nothing for the layout {}", self.name()),
                    "leave it out",
                ));
            }
            Ok(())
        };
        if !matches!(self, Self::ColorDepth | Self::Tum) {
            without("--poses", options.poses.is_some())?;
        }
        if self == Self::Npz {
            without("--depth-scale", options.depth_scale.is_some())?;
        }
        let posed = [
            Self::ScannetppDslr,
            Self::Nerfstudio,
            Self::Colmap,
            Self::Cameras,
        ];
        if !posed.contains(&self) {
            without("--points", options.points.is_some())?;
        }
        if self != Self::Cameras {
            without("--cameras", options.cameras.is_some())?;
        }
        match self {
            Self::SevenScenes => seven_scenes::list(folder, options),
            Self::Npz => npz::list(folder, options),
            Self::ColorDepth => color_depth::list(folder, options),
            Self::Sens => sens::list(folder, options),
            Self::Scannet => scannet::list(folder, options),
            Self::ScannetppIphone => scannetpp_iphone::list(folder, options),
            Self::Tum => tum::list(folder, options),
            Self::Replica => replica::list(folder, options),
            Self::ScannetppDslr => scannetpp_dslr::list(folder, options),
            Self::Nerfstudio => nerfstudio::list(folder, options),
            Self::Colmap => colmap::list(folder, options),
            Self::Cameras => match &options.cameras {
                Some(cameras) => cameras::list(folder, cameras, options),
                None => Err(Error::request(
                    "the layout cameras needs --cameras",
                    "give cameras.json, transforms.json or the folder of a COLMAP model",
                )),
            },
        }
    }
}
