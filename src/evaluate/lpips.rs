//! How different two pictures look: LPIPS 0.1, by networks whose weights have to be there.

use super::image::check_same_size;
use crate::{
    Error, Result,
    error::network_problem,
    machine::{PROGRAM_BYTES, network_memory, readable_bytes},
    weights::{are_missing, damaged, network},
};
use candle_core::{Device, Tensor};
use image::RgbImage;
use serde::Serialize;
use tid3r_models::{
    ComputeType, Footprint,
    lpips::{Lpips, Memory},
};
use tid3r_weights_convert::{Config, Found, Network, Places};

/// The classifier on which LPIPS is computed. The figures of one say nothing of the other's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backbone {
    /// AlexNet, the authors' choice for judging pictures.
    Alex,
    /// VGG16.
    Vgg,
}

impl Backbone {
    /// Both, in the order in which they are shown.
    pub const ALL: [Self; 2] = [Self::Alex, Self::Vgg];

    /// The name of the network with its weights.
    pub fn network(self) -> &'static str {
        match self {
            Self::Alex => "lpips-alex",
            Self::Vgg => "lpips-vgg",
        }
    }
}

/// Distances of a picture from its truth, 0 if they are equal; or their means over pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PerceptualDistances {
    /// On AlexNet, if that was asked for.
    #[serde(rename = "lpips_alex", skip_serializing_if = "Option::is_none")]
    pub alex: Option<f64>,
    /// On VGG16, if that was asked for.
    #[serde(rename = "lpips_vgg", skip_serializing_if = "Option::is_none")]
    pub vgg: Option<f64>,
}

/// Networks that tell how different pictures look: both, one or none.
#[derive(Debug, Default)]
pub struct Perceptual {
    alex: Option<Loaded>,
    vgg: Option<Loaded>,
}

#[derive(Debug)]
struct Loaded {
    found: Found,
    network: Lpips,
}

impl Perceptual {
    /// No network, and so no distances.
    pub fn none() -> Self {
        Self::default()
    }

    /// These networks, with weights in `places`.
    ///
    /// # Errors
    /// When weights are missing or damaged.
    pub fn find(places: &Places, backbones: &[Backbone]) -> Result<Self> {
        let find = |backbone: Backbone| -> Result<Option<Loaded>> {
            let wanted = backbones.contains(&backbone);
            wanted.then(|| Loaded::find(places, backbone)).transpose()
        };
        Ok(Self {
            alex: find(Backbone::Alex)?,
            vgg: find(Backbone::Vgg)?,
        })
    }

    /// The networks of which weights are in `places`.
    ///
    /// # Errors
    /// When weights are there and damaged.
    pub fn find_those_there(places: &Places) -> Result<Self> {
        let find = |backbone: Backbone| match Loaded::find(places, backbone) {
            Err(error) if are_missing(&error) => Ok(None),
            found => found.map(Some),
        };
        Ok(Self {
            alex: find(Backbone::Alex)?,
            vgg: find(Backbone::Vgg)?,
        })
    }

    /// What the networks are, so that results with other ones can be told apart.
    pub fn description(&self) -> serde_json::Value {
        let loaded = [&self.alex, &self.vgg].into_iter().flatten();
        let described = loaded.map(|loaded| {
            let found = &loaded.found;
            serde_json::json!([found.network.name, found.file.weights_sha256])
        });
        described.collect()
    }

    /// The distances of `picture` from `truth`.
    ///
    /// # Errors
    /// When sizes differ, or a side is too short for a network (31 pixels for AlexNet, 16 for VGG16).
    pub fn distances(&self, picture: &RgbImage, truth: &RgbImage) -> Result<PerceptualDistances> {
        check_same_size(picture, truth)?;
        let of = |loaded: &Option<Loaded>| -> Result<Option<f64>> {
            let distance = loaded
                .as_ref()
                .map(|loaded| loaded.distance(picture, truth));
            distance.transpose()
        };
        Ok(PerceptualDistances {
            alex: of(&self.alex)?,
            vgg: of(&self.vgg)?,
        })
    }
}

impl Loaded {
    fn find(places: &Places, backbone: Backbone) -> Result<Self> {
        let found = places.find(Network::named(backbone.network())?, None)?;
        let network = network(&found, ComputeType::F32, |config, weights| match config {
            Config::Lpips(config) => Some(Lpips::new(config, weights)),
            _ => None,
        })?;
        Ok(Self { found, network })
    }

    fn distance(&self, picture: &RgbImage, truth: &RgbImage) -> Result<f64> {
        let least = self.network.config().net.least_side();
        let (width, height) = truth.dimensions();
        if (width.min(height) as usize) < least {
            return Err(Error::request(
                format!(
                    "a picture of {width}x{height} pixels is too small for {}",
                    self.found.network.title
                ),
                format!("give pictures of at least {least}x{least} pixels, or --lpips none"),
            ));
        }
        let size = (height as usize, width as usize);
        let memory = Memory::new(self.network.config(), size, Footprint::default());
        let needed = memory.total() as u64 + PROGRAM_BYTES;
        if let Some(available) = network_memory().filter(|&available| available < needed) {
            return Err(Error::request(
                format!(
                    "{} takes {} of memory to compare pictures of {width}x{height} pixels, and there may be {}",
                    self.found.network.title,
                    readable_bytes(needed),
                    readable_bytes(available)
                ),
                "render smaller pictures, give --lpips none or alex, or allow for more memory",
            ));
        }
        let distances = [picture, truth].map(tensor);
        let distances = match distances {
            [Ok(picture), Ok(truth)] => self.network.forward(&picture, &truth),
            [Err(error), _] | [_, Err(error)] => Err(error),
        };
        let distances =
            distances.map_err(|error| damaged(&self.found, &network_problem(&error)))?;
        Ok(distances.iter().map(|distance| distance.value).sum())
    }
}

/// (1, height, width, 3), from -1 to 1.
fn tensor(picture: &RgbImage) -> candle_core::Result<Tensor> {
    let values = picture.as_raw().iter();
    let values = values.map(|&value| f32::from(value) / 127.5 - 1.0);
    let shape = (1, picture.height() as usize, picture.width() as usize, 3);
    Tensor::from_iter(values, &Device::Cpu)?.reshape(shape)
}

impl PerceptualDistances {
    /// The means over pictures.
    pub(super) fn mean(of: &[Self]) -> Self {
        let mean = |one: fn(&Self) -> Option<f64>| {
            let all: Option<Vec<f64>> = of.iter().map(one).collect();
            all.filter(|all| !all.is_empty())
                .map(|all| all.iter().sum::<f64>() / all.len() as f64)
        };
        Self {
            alex: mean(|distances| distances.alex),
            vgg: mean(|distances| distances.vgg),
        }
    }
}
