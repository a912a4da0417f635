use clap::ValueEnum;
use std::{fmt, path::Path};

/// What a scene can be exported as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// One binary PLY: position, colour, instance id and confidence of each point (any .ply)
    Ply,
    /// A folder of such PLYs, ID-NAME.ply for each instance, 0-none.ply for what is in none
    Instances,
    /// Gaussian splats as PLY, for splat viewers (any .splats.ply); needs a scene made by MV-DUSt3R
    Splats,
    /// Points, a node for each instance, and cameras (any .glb); y is up
    Glb,
    /// A recording of Rerun with an entity for each instance and each camera, and photos (any .rrd); z is up.
    /// Needs a tid3r built with `--features rerun`
    Rrd,
    /// One page to look at the scene with any browser, without tid3r and offline (any .html)
    Html,
    /// A folder with images/ and a binary COLMAP model in sparse/0/
    Colmap,
    /// The same with a model as text
    ColmapText,
    /// nerfstudio's transforms.json, with photos in images/ and the cloud in points.ply beside it; z is up
    Transforms,
    /// cameras.json, as `tid3r render --path` reads it: lenses of the original photos, and poses
    Cameras,
    /// A folder with depth and confidence of each photo, as PNG of 16 bits and as .npz, and depth.json
    Depth,
}

impl Format {
    /// The format that a name says; `None` if it says none.
    pub fn of(output: &Path) -> Option<Self> {
        let name = output.file_name()?.to_string_lossy().to_lowercase();
        let endings = [
            (".splats.ply", Self::Splats),
            (".ply", Self::Ply),
            (".glb", Self::Glb),
            (".rrd", Self::Rrd),
            (".html", Self::Html),
            ("transforms.json", Self::Transforms),
            ("cameras.json", Self::Cameras),
        ];
        let found = endings.iter().find(|(ending, _)| name.ends_with(ending));
        found.map(|&(_, format)| format)
    }

    /// Whether it is written into a folder of its own.
    pub(super) fn is_folder(self) -> bool {
        matches!(
            self,
            Self::Instances | Self::Colmap | Self::ColmapText | Self::Depth
        )
    }

    /// Whether photos come with it.
    pub(super) fn comes_with_photos(self) -> bool {
        matches!(
            self,
            Self::Rrd | Self::Colmap | Self::ColmapText | Self::Transforms
        )
    }

    /// Whether it can have depth maps beside other things.
    pub(super) fn can_have_depth(self) -> bool {
        matches!(self, Self::Transforms | Self::Rrd)
    }

    /// Whether it can be of some instances only.
    pub(super) fn is_of_points(self) -> bool {
        !matches!(self, Self::Html | Self::Cameras | Self::Depth)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.to_possible_value();
        f.write_str(value.as_ref().map_or("", |value| value.get_name()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_what_they_are_of() {
        for (name, format) in [
            ("room.ply", Some(Format::Ply)),
            ("a/room.PLY", Some(Format::Ply)),
            ("room.splats.ply", Some(Format::Splats)),
            ("room.glb", Some(Format::Glb)),
            ("room.rrd", Some(Format::Rrd)),
            ("room.html", Some(Format::Html)),
            ("data/transforms.json", Some(Format::Transforms)),
            ("room_cameras.json", Some(Format::Cameras)),
            ("room.json", None),
            ("room.obj", None),
            ("room", None),
            ("..", None),
        ] {
            assert_eq!(Format::of(Path::new(name)), format, "{name}");
        }
    }
}
