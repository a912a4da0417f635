use super::{EncoderChoice, Networks};
use crate::{
    Error, Result,
    weights::{are_missing, footprint, joined, network},
};
use serde_json::{Value, json};
use tid3r_models::{
    ComputeType, Footprint,
    mobilesamv2::{
        ImageEncoder, decoder::Decoder, detector::Detector, efficient_vit::EfficientVit,
        tiny_vit::TinyVit, vit::Vit,
    },
};
use tid3r_weights_convert::{Config, Found, Network, Places};

const DETECTOR: &str = "mobilesamv2-detector";
const DECODER: &str = "mobilesamv2-decoder";

/// The weights of the three networks.
#[derive(Clone, Debug)]
pub struct MobileSamWeights {
    pub(super) detector: Found,
    pub(super) encoder: Found,
    pub(super) decoder: Found,
}

impl MobileSamWeights {
    /// Those that are in `places`; of encoders the one that is asked for, else the first of
    /// [`EncoderChoice::ALL`] whose weights are there.
    ///
    /// # Errors
    /// When some are missing: the message says which, and what to get from where.
    pub fn find(places: &Places, encoder: Option<EncoderChoice>) -> Result<Self> {
        let find = |name: &str| -> Result<Found> { Ok(places.find(Network::named(name)?, None)?) };
        let encoder = match encoder {
            Some(choice) => find(choice.network()),
            None => {
                let mut found = EncoderChoice::ALL.into_iter().map(|e| find(e.network()));
                let first = find(EncoderChoice::default().network());
                found.find(Result::is_ok).unwrap_or(first)
            }
        };
        match (find(DETECTOR), encoder, find(DECODER)) {
            (Ok(detector), Ok(encoder), Ok(decoder)) => Ok(Self {
                detector,
                encoder,
                decoder,
            }),
            (detector, encoder, decoder) => {
                let problems = [detector, encoder, decoder]
                    .into_iter()
                    .filter_map(Result::err);
                Err(joined("MobileSAMv2's three", problems.collect()))
            }
        }
    }

    /// Those of detector, encoder and decoder.
    pub(crate) fn all(&self) -> [&Found; 3] {
        [&self.detector, &self.encoder, &self.decoder]
    }

    /// As [`Self::find`], but the inner error says which weights are merely missing.
    ///
    /// # Errors
    /// When weights are there and damaged.
    pub fn find_if_there(
        places: &Places,
        encoder: Option<EncoderChoice>,
    ) -> Result<Result<Self, Error>> {
        match Self::find(places, encoder) {
            Err(error) if !are_missing(&error) => Err(error),
            found => Ok(found),
        }
    }

    /// The networks, which compute with this type.
    ///
    /// # Errors
    /// When weights are damaged, lack a tensor, or have one too many.
    pub(super) fn networks(&self, compute_type: ComputeType) -> Result<Networks> {
        Ok(Networks {
            detector: network(
                &self.detector,
                compute_type,
                |config, weights| match config {
                    Config::Detector(config) => Some(Detector::new(config, weights)),
                    _ => None,
                },
            )?,
            encoder: network(
                &self.encoder,
                compute_type,
                |config, weights| match config {
                    Config::EfficientVit(config) => {
                        Some(EfficientVit::new(config, weights).map(ImageEncoder::EfficientVit))
                    }
                    Config::TinyVit(config) => {
                        Some(TinyVit::new(config, weights).map(ImageEncoder::TinyVit))
                    }
                    Config::Vit(config) => Some(Vit::new(config, weights).map(ImageEncoder::Vit)),
                    _ => None,
                },
            )?,
            decoder: network(
                &self.decoder,
                compute_type,
                |config, weights| match config {
                    Config::Decoder(config) => Some(Decoder::new(config, weights)),
                    _ => None,
                },
            )?,
        })
    }

    /// What the weights of encoder and decoder take in memory when they compute with this type.
    pub(super) fn footprints(&self, compute_type: ComputeType) -> Result<[Footprint; 2]> {
        let of = |found| footprint(found, compute_type);
        Ok([of(&self.encoder)?, of(&self.decoder)?])
    }

    /// What masks depend on, for `scene.json`.
    pub(super) fn description(&self) -> Value {
        let of_network = |found: &Found| {
            json!({
                "network": found.network.name,
                "weights_sha256": found.file.weights_sha256,
                "weights_source": found.file.provenance.source,
            })
        };
        json!({
            "detector": of_network(&self.detector),
            "encoder": of_network(&self.encoder),
            "decoder": of_network(&self.decoder),
        })
    }
}
