use crate::parameters;
use serde::{Deserialize, Serialize};
use tid3r_models::ComputeType;

/// How See3D completes views.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
pub struct See3dParams {
    /// Side of the square pictures that the network sees, a multiple of 64; it was trained on 512
    /// [default: 512, or 64 with synthetic-tiny weights]
    #[arg(id = "see3d_size", long = "see3d-size", value_name = "PX", value_parser = size)]
    pub size: Option<u32>,
    /// Photos that guide each group of views, those that show most of it; one takes See3D's network for a
    /// single photo. Time grows with the square of photos and views together
    #[arg(id = "see3d_references", long = "see3d-references", value_name = "N", default_value_t = 4,
          value_parser = clap::value_parser!(u32).range(1..=64))]
    pub references: u32,
    /// Views that are completed together, at the most [default: 8, or what fits into memory]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub group: Option<u32>,
    /// Which sampler
    #[arg(long, value_enum, value_name = "HOW", default_value_t)]
    pub quality: Quality,
    /// Steps of the sampler; See3D's own takes some more, 53 for 50 [default: 50, or 15 with --quality fast, or 5
    /// with synthetic-tiny weights]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=500))]
    pub steps: Option<u32>,
    /// How far results are pushed from what comes without the photos
    #[arg(long, value_name = "FACTOR", default_value_t = 2.0, value_parser = parameters::not_negative)]
    pub guidance: f64,
    /// Seed of the noise that pictures are made from
    #[arg(
        id = "see3d_seed",
        long = "see3d-seed",
        value_name = "N",
        default_value_t = 42
    )]
    pub seed: u64,
    /// Complete the completed views once more, at twice the size
    #[arg(long)]
    pub super_resolution: bool,
    /// Memory that completion may take, as in 8GB; less is slower, and may mean smaller groups
    /// [default: what is available]
    #[arg(id = "see3d_memory", long = "see3d-memory", value_name = "AMOUNT", value_parser = parameters::memory)]
    #[serde(skip)]
    pub max_memory: Option<u64>,
    /// What the networks compute with.
    #[arg(skip)]
    #[serde(default, skip_serializing_if = "ComputeType::is_default")]
    pub dtype: ComputeType,
}

impl Default for See3dParams {
    fn default() -> Self {
        Self {
            size: None,
            references: 4,
            group: None,
            quality: Quality::default(),
            steps: None,
            guidance: 2.0,
            seed: 42,
            super_resolution: false,
            max_memory: None,
            dtype: ComputeType::default(),
        }
    }
}

/// How much care the sampler takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// See3D's own sampler
    #[default]
    Exact,
    /// A better solver that needs fewer steps
    Fast,
}

/// A side of the network's pictures.
fn size(text: &str) -> Result<u32, String> {
    let side: Option<u32> = text.trim().parse().ok();
    let fits = |side: &u32| side.is_multiple_of(64) && (64..=2048).contains(side);
    side.filter(fits)
        .ok_or_else(|| "a multiple of 64 from 64 to 2048 is wanted".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct Command {
        #[command(flatten)]
        params: See3dParams,
    }

    #[test]
    fn what_the_command_line_takes_for_granted_is_the_default() {
        let parsed = Command::parse_from(["command"]).params;
        assert_eq!(parsed, See3dParams::default());
        for side in ["100", "0", "-64", "4096", "big"] {
            let arguments = ["command", "--see3d-size", side];
            assert!(Command::try_parse_from(arguments).is_err(), "{side}");
        }
        let large = Command::parse_from(["command", "--see3d-size", "576"]);
        assert_eq!(large.params.size, Some(576));
    }
}
