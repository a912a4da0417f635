use crate::{
    parameters,
    photos::{FRAME_SIDE_LIMIT, KnownLens, PATCH, TRAINED_SIZE},
    reconstruct::{OrderChoice, RecoveryParams},
};
use serde::Serialize;
use std::str::FromStr;
use tid3r_models::ComputeType;

/// How MV-DUSt3R reconstructs photos.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize)]
pub struct MvDust3rParams {
    /// Long side of the pictures that the network sees; 224, which it was trained on, takes the middle
    /// square of each photo, others all that fits
    #[arg(long, value_name = "PX", default_value_t = TRAINED_SIZE,
          value_parser = clap::value_parser!(u32).range(i64::from(PATCH)..=i64::from(FRAME_SIDE_LIMIT)))]
    pub size: u32,
    /// Which photo is the reference, and in which order the network sees the others
    #[arg(long, value_enum, value_name = "HOW", default_value_t)]
    pub order: OrderChoice,
    /// Reference photos of MV-DUSt3R+ [default: 4, or all if there are fewer photos]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=64))]
    pub references: Option<u32>,
    /// Focal length of all photos, if it is known: in pixels of the photos, or `exif` for what the
    /// camera wrote into each; otherwise the network tells
    #[arg(long, value_name = "PX|exif", conflicts_with = "intrinsics")]
    pub focal: Option<FocalSource>,
    /// Intrinsics of all photos, if they are known, in pixels of the upright photos
    #[arg(long, value_name = "FX,FY,CX,CY", value_parser = KnownLens::parse_intrinsics)]
    pub intrinsics: Option<KnownLens>,
    /// How cameras are recovered.
    #[command(flatten)]
    pub recovery: RecoveryParams,
    /// Do not keep a Gaussian for each pixel
    #[arg(long)]
    pub no_gaussians: bool,
    /// Seed of the random draws
    #[arg(long, value_name = "N", default_value_t = 42)]
    pub seed: u64,
    /// What the network computes with.
    #[arg(skip)]
    #[serde(skip_serializing_if = "ComputeType::is_default")]
    pub dtype: ComputeType,
}

impl Default for MvDust3rParams {
    fn default() -> Self {
        Self {
            size: TRAINED_SIZE,
            order: OrderChoice::default(),
            references: None,
            focal: None,
            intrinsics: None,
            recovery: RecoveryParams::default(),
            no_gaussians: false,
            seed: 42,
            dtype: ComputeType::default(),
        }
    }
}

/// Where a known focal length comes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FocalSource {
    /// The user: pixels of the photo.
    Pixels(f64),
    /// What the camera wrote into the photo.
    Exif,
}

impl FromStr for FocalSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.trim() {
            "exif" => Ok(Self::Exif),
            number => parameters::positive(number)
                .map(Self::Pixels)
                .map_err(|_| format!("'{text}' is neither a number of pixels nor `exif`")),
        }
    }
}
