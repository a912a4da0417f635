use super::{ImportOptions, LayoutChoice, color_depth, listing::Listing, npz, seven_scenes};
use crate::{Error, Result};
use serde::Serialize;
use std::path::Path;

/// How a recording's folder is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// One flat folder of `frame-N.*` files (7-Scenes, 3DMatch); metres.
    SevenScenes,
    /// `rgb/` and `condition.npz`; the recording's own units.
    Npz,
    /// `color/`, `depth/` and a file of poses; metres.
    ColorDepth,
}

impl Layout {
    /// Whether lengths are in metres.
    pub fn is_metric(self) -> bool {
        self != Self::Npz
    }

    pub(super) fn recognise(folder: &Path, choice: LayoutChoice) -> Result<Self> {
        if !folder.is_dir() {
            let problem = if folder.exists() {
                "is not a folder"
            } else {
                "does not exist"
            };
            return Err(Error::file(
                folder,
                problem,
                "give the folder of an RGB-D recording",
            ));
        }
        // What cannot be listed cannot be recognised: say so rather than "no layout".
        super::listing::names(folder)?;
        match choice {
            LayoutChoice::SevenScenes => return Ok(Self::SevenScenes),
            LayoutChoice::Npz => return Ok(Self::Npz),
            LayoutChoice::ColorDepth => return Ok(Self::ColorDepth),
            LayoutChoice::Auto => {}
        }
        let candidates = [
            (
                Self::SevenScenes,
                "seven-scenes",
                seven_scenes::fits(folder)?,
            ),
            (Self::Npz, "npz", npz::fits(folder)),
            (Self::ColorDepth, "color-depth", color_depth::fits(folder)),
        ];
        let fitting: Vec<_> = candidates.iter().filter(|(.., fits)| *fits).collect();
        match *fitting {
            [(layout, ..)] => Ok(*layout),
            [] => Err(Error::file(
                folder,
                "holds no RGB-D recording that tid3r knows",
                "give a folder with frame-N.color.png, frame-N.depth.png and frame-N.pose.txt \
                 (seven-scenes), with rgb/ and condition.npz (npz), or with color/ or rgb/, depth/ \
                 and pose.txt (color-depth)",
            )),
            _ => Err(Error::file(
                folder,
                format!(
                    "fits several layouts: {}",
                    fitting
                        .iter()
                        .map(|(_, name, _)| *name)
                        .collect::<Vec<_>>()
                        .join(", ")
                ),
                "choose one with --layout",
            )),
        }
    }

    pub(super) fn list(self, folder: &Path, options: &ImportOptions) -> Result<Listing> {
        let without = |option, given: bool, layout| {
            if given {
                return Err(Error::request(
                    format!("{option} means nothing for the layout {layout}"),
                    "leave it out",
                ));
            }
            Ok(())
        };
        match self {
            Self::SevenScenes => {
                without("--poses", options.poses.is_some(), "seven-scenes")?;
                seven_scenes::list(folder, options)
            }
            Self::Npz => {
                without("--poses", options.poses.is_some(), "npz")?;
                without("--depth-scale", options.depth_scale.is_some(), "npz")?;
                npz::list(folder, options)
            }
            Self::ColorDepth => color_depth::list(folder, options),
        }
    }
}
