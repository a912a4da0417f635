use super::{FrameList, Layout, Lens};
use crate::parameters;
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::path::PathBuf;

/// How to read an RGB-D recording.
#[derive(Clone, Debug, PartialEq, Args, Serialize)]
pub struct ImportOptions {
    /// How the recording's folder is laid out; if not given, it is found out.
    #[arg(long, value_enum)]
    pub layout: Option<Layout>,

    /// Lens of all photos, in pixels; replaces what the recording says, distortion included.
    #[arg(long, value_name = "FX,FY,CX,CY", allow_hyphen_values = true)]
    pub intrinsics: Option<Lens>,

    /// The image that the intrinsics refer to, where photos and depth differ in size; if not given,
    /// the one whose centre is nearer to the principal point.
    #[arg(long, value_enum, value_name = "IMAGE")]
    pub intrinsics_for: Option<IntrinsicsImage>,

    /// Depth values per metre, where the recording's own or the layout's usual number is not right;
    /// color-depth needs it, npz has none.
    #[arg(long, value_name = "UNITS", value_parser = parameters::positive)]
    pub depth_scale: Option<f64>,

    /// File of camera poses: for color-depth one line `tx ty tz qx qy qz qw` per photo (if not given,
    /// pose.txt, poses.txt or trajectory.txt in the folder), for tum lines that begin with the time (if not
    /// given, groundtruth.txt).
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,

    /// The cameras of the photos in a folder that holds nothing else: cameras.json, transforms.json, or the
    /// folder of a COLMAP model.
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,

    /// Points in the cameras' world that give the photos depth: a PLY file, or the folder of a COLMAP model
    /// (nerfstudio, colmap, scannetpp-dslr, and with --cameras).
    #[arg(long, value_name = "FILE")]
    pub points: Option<PathBuf>,

    /// Photos to use, by the numbers in their names, as in 3,10,20-100:10 (20 to 100 in tens); the
    /// first may serve as the reference view.
    #[arg(long, value_name = "LIST")]
    pub frames: Option<FrameList>,

    /// Photos to hold out as test views, by number.
    #[arg(long, value_name = "LIST")]
    pub test_frames: Option<FrameList>,

    /// Without --frames, use at most this many photos, evenly spaced.
    #[arg(long, value_name = "N", default_value_t = ImportOptions::default().max_frames,
          value_parser = clap::value_parser!(u32).range(1..))]
    pub max_frames: u32,

    /// Longer side of the frames, at most; depth is never enlarged.
    #[arg(long, value_name = "PX", default_value_t = ImportOptions::default().max_size,
          value_parser = clap::value_parser!(u32).range(1..))]
    pub max_size: u32,

    /// Nearer depth is taken for unknown (metres, or the recording's units).
    #[arg(long, value_name = "DEPTH", default_value_t = ImportOptions::default().min_depth,
          value_parser = parameters::not_negative)]
    pub min_depth: f64,

    /// Farther depth is taken for unknown.
    #[arg(long, value_name = "DEPTH", value_parser = parameters::positive)]
    pub max_depth: Option<f64>,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            layout: None,
            intrinsics: None,
            intrinsics_for: None,
            depth_scale: None,
            poses: None,
            cameras: None,
            points: None,
            frames: None,
            test_frames: None,
            max_frames: 20,
            max_size: 640,
            min_depth: 0.0,
            max_depth: None,
        }
    }
}

/// The image that intrinsics refer to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum IntrinsicsImage {
    /// The photos.
    Photo,
    /// The depth images.
    Depth,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        options: ImportOptions,
    }

    fn parse(arguments: &str) -> Result<ImportOptions, clap::Error> {
        let words = std::iter::once("import").chain(arguments.split_whitespace());
        Command::try_parse_from(words).map(|command| command.options)
    }

    #[test]
    fn no_arguments_are_the_defaults() {
        assert_eq!(parse("").unwrap(), ImportOptions::default());
    }

    #[test]
    fn arguments_reach_their_fields() {
        let options = parse(
            "--layout color-depth --intrinsics -518,519,325.5,253.5 --intrinsics-for depth \
             --depth-scale 1000 --frames 0-20:10 --test-frames 5 --max-depth 4",
        )
        .unwrap();
        assert_eq!(options.layout, Some(Layout::ColorDepth));
        assert_eq!(options.intrinsics.unwrap().fx, -518.0);
        assert_eq!(options.intrinsics_for, Some(IntrinsicsImage::Depth));
        assert_eq!(options.depth_scale, Some(1000.0));
        assert_eq!(options.max_depth, Some(4.0));
        let json = serde_json::to_value(&options).unwrap();
        assert_eq!(json["frames"], "0-20:10");
        assert_eq!(json["layout"], "color-depth");
        assert_eq!(json["intrinsics"], "-518,519,325.5,253.5");
    }

    #[test]
    fn bad_syntax_is_wrong_usage() {
        for arguments in [
            "--layout kitti",
            "--intrinsics 1,2,3",
            "--intrinsics-for both",
            "--frames 9-3",
            "--test-frames x",
            "--max-frames 0",
            "--max-size 0",
            "--depth-scale 0",
            "--depth-scale nan",
            "--max-depth 0",
            "--min-depth inf",
        ] {
            assert_eq!(parse(arguments).unwrap_err().exit_code(), 2, "{arguments}");
        }
    }
}
