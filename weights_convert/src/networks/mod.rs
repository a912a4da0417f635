//! The networks whose weights tid3r knows: where they come from, what tensors they have, and how
//! their published checkpoints are read.
//!
//! A new network is an entry of [`Network::all`], a variant of [`Config`] and a module that finds
//! out from a checkpoint what configuration it is of.

mod constructor;
mod lpips;
mod mobilesamv2;
mod mvdust3r;
mod plan;
pub mod see3d;

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize, Serializer};
use tid3r_models::lpips as perceptual;
use tid3r_models::mobilesamv2::{decoder, detector, efficient_vit, tiny_vit, vit};
use tid3r_models::mvdust3r as dust3r;
use tid3r_models::see3d::{clip, unet, vae};

use crate::error::first_line;
use crate::synth::{self, Adjustment};
use crate::{Error, Result};

pub(crate) use plan::{Hints, Plan, differences};

/// A network that tid3r can run.
#[derive(Debug, Serialize)]
pub struct Network {
    /// What it is called on the command line and as a folder.
    pub name: &'static str,
    /// What its authors call it.
    pub title: &'static str,
    /// Where its weights are published.
    pub source: Source,
    /// Checkpoint files there; the first is the one to take.
    pub files: &'static [&'static str],
    /// The folder there that holds every network of a method, each in a folder of its own: they are
    /// converted together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folder: Option<&'static str>,
    /// A checkpoint that completes it, where no file has all tensors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beside: Option<Beside>,
    /// What it is needed for.
    pub purpose: &'static str,
    /// Where its code is published.
    pub upstream: &'static str,
    /// The licence of its weights.
    pub licence: &'static str,
    /// How many numbers it has learned.
    pub parameters: u64,
    #[serde(skip)]
    released: fn() -> Config,
    #[serde(skip)]
    tiny: fn() -> Config,
    /// What is done to synthetic weights so that the network does something.
    #[serde(skip)]
    pub(crate) adjustments: &'static [Adjustment],
}

impl PartialEq for Network {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

/// A checkpoint that completes another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Beside {
    /// Its name.
    pub file: &'static str,
    /// The page that leads to it.
    pub source: &'static str,
}

/// Where weights are published; in JSON and in messages, its address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// A model repository on Hugging Face, of which this machine may have a copy.
    HuggingFace(&'static str),
    /// A page that leads to them.
    Page(&'static str),
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::HuggingFace(repository) => write!(f, "https://huggingface.co/{repository}"),
            Self::Page(address) => f.write_str(address),
        }
    }
}

impl Serialize for Source {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

static NETWORKS: [Network; 15] = [
    mvdust3r::MV_DUST3R,
    mvdust3r::MV_DUST3R_PLUS,
    mobilesamv2::DETECTOR,
    mobilesamv2::EFFICIENT_VIT,
    mobilesamv2::TINY_VIT,
    mobilesamv2::VIT,
    mobilesamv2::DECODER,
    see3d::SPARSE,
    see3d::SINGLE,
    see3d::SUPER_RESOLUTION,
    see3d::VAE,
    see3d::IMAGE_ENCODER,
    see3d::TEXT_ENCODER,
    lpips::ALEX,
    lpips::VGG,
];

impl Network {
    /// Every network, in the order in which they are listed.
    pub fn all() -> &'static [Self] {
        &NETWORKS
    }

    /// The network called `name`.
    ///
    /// # Errors
    ///
    /// If there is none; the message lists those that there are.
    pub fn named(name: &str) -> Result<&'static Self> {
        let found = Self::all().iter().find(|network| network.name == name);
        found.ok_or_else(|| {
            let names: Vec<_> = Self::all().iter().map(|network| network.name).collect();
            Error::request(
                format!("there is no network called `{name}`"),
                format!("the networks are {}", names.join(", ")),
            )
        })
    }

    /// The network called `name`, or all whose names begin with it and a dash: `see3d` is the six of
    /// See3D.
    ///
    /// # Errors
    ///
    /// If there is none.
    pub fn all_named(name: &str) -> Result<Vec<&'static Self>> {
        let exact = Self::named(name);
        let in_group = |network: &&Self| {
            (network.name.strip_prefix(name)).is_some_and(|rest| rest.starts_with('-'))
        };
        let group: Vec<_> = Self::all().iter().filter(in_group).collect();
        match exact {
            Err(_) if !group.is_empty() => Ok(group),
            exact => Ok(vec![exact?]),
        }
    }

    /// Where its own folder is within that of its method.
    pub(crate) fn place(&self) -> Option<&'static Path> {
        let file = Path::new(self.files.first()?);
        file.strip_prefix(self.folder?).ok()?.parent()
    }

    /// Size of its weights as f32, in bytes.
    pub fn bytes(&self) -> u64 {
        4 * self.parameters
    }

    /// The synthetic tensor called `name`, row-major: as [`synth::tensor`], but that some have other
    /// values, without which a deep network's result is the same whatever it sees.
    ///
    /// # Panics
    ///
    /// If the number of elements overflows a `usize`.
    pub fn synthetic(&self, name: &str, shape: &[usize], seed: u64) -> Vec<f32> {
        synth::adjusted(name, shape, seed, self.adjustments)
    }

    /// The configuration of the published weights.
    pub fn released(&self) -> Config {
        (self.released)()
    }

    /// A configuration with all parts of the published one, but so small that it runs in a moment:
    /// for tests of what is around the network.
    pub fn tiny(&self) -> Config {
        (self.tiny)()
    }
}

/// The configuration of a network; in JSON, with the architecture under `model`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model")]
#[non_exhaustive]
#[expect(
    clippy::large_enum_variant,
    reason = "there are a few at a time, and they are looked into rather than moved"
)]
pub enum Config {
    /// MV-DUSt3R or MV-DUSt3R+.
    #[serde(rename = "mvdust3r")]
    MvDust3r(dust3r::Config),
    /// The detector of MobileSAMv2.
    #[serde(rename = "mobilesamv2-detector")]
    Detector(detector::Config),
    /// An image encoder for MobileSAMv2's decoder: EfficientViT-SAM.
    #[serde(rename = "mobilesamv2-efficientvit-l2")]
    EfficientVit(efficient_vit::Config),
    /// An image encoder for MobileSAMv2's decoder: that of MobileSAM.
    #[serde(rename = "mobilesamv2-tiny-vit")]
    TinyVit(tiny_vit::Config),
    /// An image encoder for MobileSAMv2's decoder: that of SAM.
    #[serde(rename = "mobilesamv2-sam-vit-h")]
    Vit(vit::Config),
    /// The prompt encoder and mask decoder of MobileSAMv2.
    #[serde(rename = "mobilesamv2-decoder")]
    Decoder(decoder::Config),
    /// One of See3D's three UNets.
    #[serde(rename = "see3d-unet")]
    Unet(see3d::UnetConfig),
    /// The VAE of See3D.
    #[serde(rename = "see3d-vae")]
    Vae(vae::Config),
    /// The image encoder of See3D.
    #[serde(rename = "see3d-image-encoder")]
    ImageEncoder(see3d::ImageEncoderConfig),
    /// The text encoder of See3D.
    #[serde(rename = "see3d-text-encoder")]
    TextEncoder(see3d::TextEncoderConfig),
    /// LPIPS on either classifier.
    #[serde(rename = "lpips")]
    Lpips(perceptual::Config),
}

impl Config {
    /// Names and shapes of the tensors of the network: exactly those that it uses.
    ///
    /// A published checkpoint has some more, without effect: counters of batches, a token for
    /// masked training, a classifier. They are left out of converted files.
    ///
    /// # Errors
    ///
    /// If no network has this configuration.
    pub fn tensors(&self) -> Result<BTreeMap<String, Vec<usize>>, String> {
        let tensors = match self {
            Self::MvDust3r(config) => return mvdust3r::tensors(config),
            Self::Detector(config) => detector::Detector::tensors(config),
            Self::EfficientVit(config) => efficient_vit::EfficientVit::tensors(config),
            Self::TinyVit(config) => tiny_vit::TinyVit::tensors(config),
            Self::Vit(config) => vit::Vit::tensors(config),
            Self::Decoder(config) => decoder::Decoder::tensors(config),
            Self::Unet(config) => {
                let checked = config.scheduler.check();
                checked.and_then(|()| unet::Unet::tensors(&config.unet))
            }
            Self::Vae(config) => vae::Vae::tensors(config),
            Self::ImageEncoder(config) => clip::VisionEncoder::tensors(&config.vision),
            Self::TextEncoder(config) => clip::TextEncoder::tensors(&config.text),
            Self::Lpips(config) => perceptual::Lpips::tensors(config),
        };
        tensors.map_err(|e| first_line(&e))
    }

    /// Which network it is of.
    pub fn network(&self) -> &'static Network {
        match self {
            Self::MvDust3r(config) if config.m_ref_flag => &mvdust3r::MV_DUST3R_PLUS,
            Self::MvDust3r(_) => &mvdust3r::MV_DUST3R,
            Self::Detector(_) => &mobilesamv2::DETECTOR,
            Self::EfficientVit(_) => &mobilesamv2::EFFICIENT_VIT,
            Self::TinyVit(_) => &mobilesamv2::TINY_VIT,
            Self::Vit(_) => &mobilesamv2::VIT,
            Self::Decoder(_) => &mobilesamv2::DECODER,
            Self::Unet(config) => match config.variant {
                see3d::Variant::Sparse => &see3d::SPARSE,
                see3d::Variant::Single => &see3d::SINGLE,
                see3d::Variant::SuperResolution => &see3d::SUPER_RESOLUTION,
            },
            Self::Vae(_) => &see3d::VAE,
            Self::ImageEncoder(_) => &see3d::IMAGE_ENCODER,
            Self::TextEncoder(_) => &see3d::TEXT_ENCODER,
            Self::Lpips(config) => match config.net {
                perceptual::Net::Alex => &lpips::ALEX,
                perceptual::Net::Vgg => &lpips::VGG,
            },
        }
    }
}
