use super::{
    ClipFrame, PIXELS_PER_LATENT, See3dParams,
    stage::{PRECISION, Stage},
};
use crate::{
    Error, Result,
    weights::{self, are_missing, damaged, network, part},
};
use serde_json::{Value, json};
use tempfile::TempDir;
use tid3r_models::{
    ComputeType, Footprint,
    see3d::{
        clip::{TextEncoder, VisionEncoder},
        denoise::Conditions,
        unet::Unet,
        vae::{self, Decoder, Encoder, Tiling},
    },
};
use tid3r_weights_convert::{
    Config, Found, Network, Places, Precision,
    see3d::{ImageEncoderConfig, TextEncoderConfig, UnetConfig},
    synthesize,
};

const SPARSE: &str = "see3d-sparse";
const SINGLE: &str = "see3d-single";
const SUPER_RESOLUTION: &str = "see3d-super-resolution";
const VAE: &str = "see3d-vae";
const IMAGE_ENCODER: &str = "see3d-image-encoder";
const TEXT_ENCODER: &str = "see3d-text-encoder";

/// The weights of See3D's networks.
#[derive(Debug)]
pub struct See3dWeights {
    sparse: Option<Found>,
    single: Option<Found>,
    super_resolution: Option<Found>,
    vae: Found,
    image_encoder: Found,
    text_encoder: Found,
    /// What the networks compute with.
    compute_type: ComputeType,
    /// The folder of made-up ones, which goes when they do.
    _made_up: Option<TempDir>,
}

impl See3dWeights {
    /// Those that are in `places`, as far as they are needed: for a single photo the network that was
    /// trained for that, or else the one for several.
    ///
    /// # Errors
    /// When some are missing: the message says which, and what to get from where. When they are damaged, or
    /// do not fit each other.
    pub fn find(places: &Places, params: &See3dParams) -> Result<Self> {
        let find = |name: &str| -> Result<Found> { Ok(places.find(Network::named(name)?, None)?) };
        let mut errors = Vec::new();
        let mut need = |name: &'static str| {
            let found = find(name);
            found.map_err(|error| errors.push((name, error))).ok()
        };
        let (mut sparse, mut single) = (None, find(SINGLE).ok());
        if params.references > 1 {
            sparse = need(SPARSE);
        } else if single.is_none() {
            sparse = find(SPARSE).ok();
            if sparse.is_none() {
                single = need(SINGLE);
            }
        }
        let super_resolution = match params.super_resolution {
            true => need(SUPER_RESOLUTION),
            false => None,
        };
        let parts = [VAE, IMAGE_ENCODER, TEXT_ENCODER].map(&mut need);
        let [Some(vae), Some(image_encoder), Some(text_encoder)] = parts else {
            return Err(lacking(errors));
        };
        if !errors.is_empty() {
            return Err(lacking(errors));
        }
        let found = Self {
            sparse,
            single,
            super_resolution,
            vae,
            image_encoder,
            text_encoder,
            compute_type: params.dtype,
            _made_up: None,
        };
        found.check()?;
        Ok(found)
    }

    /// Tiny made-up ones, with which everything runs in moments and nothing means anything.
    ///
    /// # Errors
    /// When there is no room for them.
    pub fn synthetic_tiny(params: &See3dParams) -> Result<Self> {
        const SEED: u64 = 42;
        let folder = tempfile::tempdir().map_err(Error::io("create", &std::env::temp_dir()))?;
        let main = if params.references > 1 {
            SPARSE
        } else {
            SINGLE
        };
        let super_resolution = params.super_resolution.then_some(SUPER_RESOLUTION);
        let networks = [main, VAE, IMAGE_ENCODER, TEXT_ENCODER];
        for name in networks.into_iter().chain(super_resolution) {
            let (config, folder) = (Network::named(name)?.tiny(), folder.path().join(name));
            synthesize(config, SEED, Precision::F32, &folder, false, &mut |_| ())?;
        }
        let places = Places::of_environment().with_models(folder.path());
        Ok(Self {
            _made_up: Some(folder),
            ..Self::find(&places, params)?
        })
    }

    /// Whether they were made from a seed: pictures mean nothing then.
    pub(super) fn are_made_up(&self) -> bool {
        let made_up = |found: &Found| found.file.provenance.seed.is_some();
        let unets = [&self.sparse, &self.single, &self.super_resolution];
        let mut all = unets.into_iter().flatten().chain([&self.vae]);
        all.any(made_up)
    }

    /// What pictures depend on whatever the views.
    pub(super) fn description(&self) -> Value {
        json!({
            "vae": identity(&self.vae),
            "image_encoder": identity(&self.image_encoder),
            "text_encoder": identity(&self.text_encoder),
        })
    }

    /// Whether they are made up, and of a network so small that it runs in moments.
    pub(super) fn are_tiny(&self) -> bool {
        let released = |found: &Found| found.file.config == found.network.released();
        let mut unets = [&self.sparse, &self.single].into_iter().flatten();
        self.are_made_up() && !unets.any(released)
    }

    /// The network that denoises frames with so many photos among them.
    fn unet_of(&self, stage: Stage, photos: usize) -> Result<&Found> {
        let found = match stage {
            Stage::Main if photos == 1 => self.single.as_ref().or(self.sparse.as_ref()),
            Stage::Main => self.sparse.as_ref().or(self.single.as_ref()),
            Stage::SuperResolution => self.super_resolution.as_ref(),
        };
        found.ok_or_else(|| {
            Error::request(
                "a network of See3D is wanted whose weights were not looked for",
                "report this as a defect",
            )
        })
    }

    /// What pictures depend on that were denoised with so many photos.
    pub(super) fn unet_description(&self, stage: Stage, photos: usize) -> Result<Value> {
        Ok(identity(self.unet_of(stage, photos)?))
    }

    /// Says so if one photo guides a network that was trained for several.
    pub(super) fn notice(&self, photos: usize) -> Option<String> {
        let falls_back = photos == 1 && self.single.is_none();
        falls_back.then(|| {
            format!(
                "one photo guides the views, and See3D's network for one ({SINGLE}) is not here: that for \
                 several does it"
            )
        })
    }

    pub(super) fn unet_config(&self, stage: Stage, photos: usize) -> Result<&UnetConfig> {
        let found = self.unet_of(stage, photos)?;
        match &found.file.config {
            Config::Unet(config) => Ok(config),
            _ => Err(other_network(found)),
        }
    }

    pub(super) fn vae_config(&self) -> Result<&vae::Config> {
        match &self.vae.file.config {
            Config::Vae(config) => Ok(config),
            _ => Err(other_network(&self.vae)),
        }
    }

    pub(super) fn image_encoder_config(&self) -> Result<&ImageEncoderConfig> {
        match &self.image_encoder.file.config {
            Config::ImageEncoder(config) => Ok(config),
            _ => Err(other_network(&self.image_encoder)),
        }
    }

    pub(super) fn text_encoder_config(&self) -> Result<&TextEncoderConfig> {
        match &self.text_encoder.file.config {
            Config::TextEncoder(config) => Ok(config),
            _ => Err(other_network(&self.text_encoder)),
        }
    }

    /// What the network's weights take that denoises frames with so many photos among them.
    pub(super) fn unet_footprint(&self, stage: Stage, photos: usize) -> Result<Footprint> {
        weights::footprint(self.unet_of(stage, photos)?, self.compute_type)
    }

    pub(super) fn vae_footprint(&self) -> Result<Footprint> {
        weights::footprint(&self.vae, self.compute_type)
    }

    pub(super) fn image_encoder_footprint(&self) -> Result<Footprint> {
        weights::footprint(&self.image_encoder, self.compute_type)
    }

    pub(super) fn text_encoder_footprint(&self) -> Result<Footprint> {
        weights::footprint(&self.text_encoder, self.compute_type)
    }

    pub(super) fn unet(&self, stage: Stage, photos: usize) -> Result<Unet> {
        let found = self.unet_of(stage, photos)?;
        network(found, self.compute_type, |config, weights| match config {
            Config::Unet(config) => Some(Unet::with_precision(&config.unet, PRECISION, weights)),
            _ => None,
        })
    }

    pub(super) fn encoder(&self, tiling: Tiling) -> Result<Encoder> {
        let weights = weights::open(&self.vae, self.compute_type)?;
        let encoder = part(&self.vae, &weights, |config, weights| match config {
            Config::Vae(config) => Some(Encoder::new(config, weights)),
            _ => None,
        })?;
        Ok(encoder.with_tiling(tiling))
    }

    pub(super) fn decoder(&self, tiling: Tiling) -> Result<Decoder> {
        let weights = weights::open(&self.vae, self.compute_type)?;
        let decoder = part(&self.vae, &weights, |config, weights| match config {
            Config::Vae(config) => Some(Decoder::new(config, weights)),
            _ => None,
        })?;
        Ok(decoder.with_tiling(tiling))
    }

    pub(super) fn image_encoder(&self) -> Result<VisionEncoder> {
        network(
            &self.image_encoder,
            self.compute_type,
            |config, weights| match config {
                Config::ImageEncoder(config) => Some(VisionEncoder::new(&config.vision, weights)),
                _ => None,
            },
        )
    }

    pub(super) fn text_encoder(&self) -> Result<TextEncoder> {
        network(
            &self.text_encoder,
            self.compute_type,
            |config, weights| match config {
                Config::TextEncoder(config) => Some(TextEncoder::new(&config.text, weights)),
                _ => None,
            },
        )
    }

    /// How the image encoder wants pictures.
    pub(super) fn clip_frame(&self) -> Result<ClipFrame> {
        let of = &self.image_encoder_config()?.preprocessor;
        Ok(ClipFrame {
            shortest_edge: of.shortest_edge as u32,
            crop: of.crop.map(|side| side as u32),
            mean: of.mean,
            std: of.std,
        })
    }

    /// Whether the networks understand each other.
    fn check(&self) -> Result<()> {
        let vae = self.vae_config()?;
        if vae.latent_channels != Conditions::CHANNELS || vae.scale() != PIXELS_PER_LATENT as usize
        {
            let problem = "they make no latents of 4 channels for 8x8 pixels";
            return Err(damaged(&self.vae, &problem));
        }
        let image = self.image_encoder_config()?.vision.projection_dim;
        let text = self.text_encoder_config()?.text.hidden_size;
        for unet in [&self.sparse, &self.single, &self.super_resolution] {
            let Some(found) = unet else { continue };
            let Config::Unet(config) = &found.file.config else {
                return Err(other_network(found));
            };
            let wanted = config.unet.context_dim;
            if image != wanted || text != wanted {
                let problem = format!(
                    "the network listens to {wanted} channels, and the image encoder in {} has {image}, the \
                     text encoder in {} {text}",
                    self.image_encoder.folder.display(),
                    self.text_encoder.folder.display(),
                );
                return Err(damaged(found, &problem));
            }
        }
        Ok(())
    }
}

/// The first error about weights that are damaged; else one that names all that are missing. They are
/// published together, so what is to be done about one is to be done about all.
fn lacking(mut errors: Vec<(&'static str, Error)>) -> Error {
    if let Some(damaged) = errors.iter().position(|(_, error)| !are_missing(error)) {
        return errors.swap_remove(damaged).1;
    }
    let names: Vec<&str> = errors.iter().map(|(name, _)| *name).collect();
    let names = names.join(", ");
    match errors.into_iter().next() {
        Some((_, Error::Weights(tid3r_weights_convert::Error::Request { problem, remedy }))) => {
            Error::request(format!("weights are missing ({names}): {problem}"), remedy)
        }
        Some((_, error)) => error,
        None => Error::request(
            "weights of See3D are wanted and none is named",
            "report this as a defect",
        ),
    }
}

fn other_network(found: &Found) -> Error {
    damaged(found, &format!("they are of {}", found.network.title))
}

fn identity(found: &Found) -> Value {
    json!({
        "network": found.network.name,
        "weights_sha256": found.file.weights_sha256,
        "weights_source": found.file.provenance.source,
    })
}
