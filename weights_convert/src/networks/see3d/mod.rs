//! The networks of See3D, a multi-view latent diffusion network that completes pictures.
//!
//! They are published as a pipeline of the library `diffusers`: a folder with a folder for each
//! network, in which a `config.json` says what the shapes of the tensors do not. What a network is of no
//! use without, such as the steps of the scheduler, is in other folders of the pipeline (`beside`).

mod beside;
mod config;
mod registry;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use tid3r_models::see3d::clip::{TextConfig, TextEncoder, VisionConfig};
use tid3r_models::see3d::{schedule, unet};

use super::plan::{Hints, Plan, differences, listed, unfit};
use super::{Config, Network};
use crate::error::{excerpt, first_line};
use crate::{Checkpoint, Error, Result};

use beside::Beside;
pub use config::{ImageEncoderConfig, Preprocessor, TextEncoderConfig, UnetConfig, Variant};
pub(super) use registry::{IMAGE_ENCODER, SINGLE, SPARSE, SUPER_RESOLUTION, TEXT_ENCODER, VAE};

/// What a checkpoint can be of.
#[derive(Clone, Copy)]
enum Kind {
    Unet,
    Vae,
    ImageEncoder,
    TextEncoder,
}

/// The image encoder comes first: the file of a whole CLIP has a text encoder, too, but not that of See3D.
const KINDS: [Kind; 4] = [Kind::Unet, Kind::Vae, Kind::ImageEncoder, Kind::TextEncoder];

impl Kind {
    /// Tensors by whose names it is known.
    fn marks(self) -> &'static [&'static str] {
        match self {
            Self::Unet => &[
                "time_embed.0.weight",
                "input_blocks.0.0.weight",
                "middle_block.1.transformer_blocks.0.attn1.to_q.weight",
            ],
            Self::Vae => &["encoder.conv_in.weight", "decoder.conv_in.weight"],
            Self::ImageEncoder => &[
                "vision_model.pre_layrnorm.weight",
                "visual_projection.weight",
            ],
            Self::TextEncoder => &[
                "text_model.embeddings.token_embedding.weight",
                "text_model.final_layer_norm.weight",
            ],
        }
    }

    fn is_of(self, config: &Config) -> bool {
        matches!(
            (self, config),
            (Self::Unet, Config::Unet(_))
                | (Self::Vae, Config::Vae(_))
                | (Self::ImageEncoder, Config::ImageEncoder(_))
                | (Self::TextEncoder, Config::TextEncoder(_))
        )
    }

    /// The configuration, from the files beside the checkpoint.
    fn configuration(
        self,
        checkpoint: &Checkpoint,
        hints: &Hints<'_>,
        notes: &mut Vec<String>,
    ) -> Result<Config> {
        let path = checkpoint.path();
        let file = Beside::config(path)?;
        let configured = match self {
            Self::Unet => Config::Unet(UnetConfig {
                variant: variant(path, hints)?,
                unet: unet(checkpoint, &file)?,
                scheduler: scheduler(path, notes)?,
            }),
            Self::Vae => Config::Vae(file.parse()?),
            Self::ImageEncoder => image_encoder(checkpoint, &file, notes)?,
            Self::TextEncoder => text_encoder(path, &file, notes)?,
        };
        match configured.tensors() {
            Ok(_) => Ok(configured),
            Err(problem) => Err(file.refuse(&problem)),
        }
    }
}

/// What becomes of a checkpoint of one of these networks; `None` if it is of something else.
pub(super) fn plan(checkpoint: &Checkpoint, hints: &Hints<'_>) -> Result<Option<Plan>> {
    let mut shapes = checkpoint.shapes();
    let marked = |kind: &&Kind| kind.marks().iter().all(|mark| shapes.contains_key(mark));
    let Some(kind) = KINDS.iter().find(marked).copied() else {
        return Ok(None);
    };
    shapes.retain(|name, _| !is_idle(name));
    let mut notes = Vec::new();
    let config = match hints.config.filter(|config| kind.is_of(config)) {
        Some(config) => config.clone(),
        None => kind.configuration(checkpoint, hints, &mut notes)?,
    };
    let refuse = |problem: &str| unfit(checkpoint.path(), config.network(), problem);
    let wanted = config.tensors().map_err(|problem| refuse(&problem))?;
    notes.extend(leave_out_others(&wanted, &mut shapes));
    let found = renamed(&shapes).map_err(|problem| refuse(&problem))?;
    let by_name = found.iter();
    let by_name = by_name.map(|(name, (shape, _))| (name.as_str(), shape.as_slice()));
    let problems = differences(&wanted, &by_name.collect());
    if !problems.is_empty() {
        return Err(refuse(&problems.join("; ")));
    }
    Ok(Some(Plan {
        config,
        tensors: found,
        notes,
    }))
}

/// Whether a tensor is in checkpoints without having an effect.
fn is_idle(name: &str) -> bool {
    name.ends_with(".position_ids")
}

/// Leaves out tensors of modules that the network has not, and says so: an embedding of cameras that is
/// never given any, the other half of a whole CLIP.
///
/// A tensor within a module that the network has stays, and will be refused if it is not wanted: the
/// network would compute something else with it.
fn leave_out_others(
    wanted: &BTreeMap<String, Vec<usize>>,
    found: &mut BTreeMap<&str, &[usize]>,
) -> Option<String> {
    let module = |name: &str| name.split('.').next().unwrap_or(name).to_owned();
    let modules: BTreeSet<_> = wanted.keys().map(|name| module(name)).collect();
    let mut others: BTreeMap<String, usize> = BTreeMap::new();
    found.retain(|name, _| {
        let module = module(name);
        let stays = modules.contains(&module);
        if !stays {
            *others.entry(module).or_default() += 1;
        }
        stays
    });
    let others: Vec<_> = others
        .iter()
        .map(|(module, count)| match count {
            1 => format!("`{}`", excerpt(module)),
            _ => format!("`{}` ({count})", excerpt(module)),
        })
        .collect();
    (!others.is_empty()).then(|| {
        format!(
            "tensors that the network has no use for are left out: {}",
            listed(&others)
        )
    })
}

/// The tensors under their names here, each with its shape here and its name in the checkpoint.
///
/// Older files of VAEs call the layers of an attention otherwise, and have them as convolutions of one
/// pixel.
fn renamed(
    found: &BTreeMap<&str, &[usize]>,
) -> Result<BTreeMap<String, (Vec<usize>, String)>, String> {
    let mut tensors = BTreeMap::new();
    for (&original, &shape) in found {
        let mut name = original.to_owned();
        let mut shape = shape.to_vec();
        if let [before @ .., layer, leaf] = &original.split('.').collect::<Vec<_>>()[..]
            && before.contains(&"attentions")
        {
            let now = match *layer {
                "query" => Some("to_q"),
                "key" => Some("to_k"),
                "value" => Some("to_v"),
                "proj_attn" => Some("to_out.0"),
                _ => None,
            };
            if let Some(now) = now {
                name = format!("{}.{now}.{leaf}", before.join("."));
            }
            if let [outputs, inputs, 1, 1] = shape[..] {
                shape = vec![outputs, inputs];
            }
        }
        if let Some((_, other)) = tensors.insert(name, (shape, original.to_owned())) {
            let (original, other) = (excerpt(original), excerpt(&other));
            return Err(format!("`{original}` and `{other}` are the same tensor"));
        }
    }
    Ok(tensors)
}

/// The UNet's own configuration.
fn unet(checkpoint: &Checkpoint, file: &Beside) -> Result<unet::Config> {
    let shapes = checkpoint.shapes().into_iter();
    let shapes = shapes.map(|(name, shape)| (name.to_owned(), shape.to_vec()));
    unet::Config::from_file(file.object(), &shapes.collect())
        .map_err(|e| file.refuse(&first_line(&e)))
}

/// Which of the three UNets it is, which nothing says but the folder that it is in.
fn variant(checkpoint: &Path, hints: &Hints<'_>) -> Result<Variant> {
    const VARIANTS: [(Variant, Network); 3] = [
        (Variant::Sparse, SPARSE),
        (Variant::Single, SINGLE),
        (Variant::SuperResolution, SUPER_RESOLUTION),
    ];
    if let Some(wanted) = hints.network {
        let found = VARIANTS.iter().find(|(_, network)| network == wanted);
        return found.map(|(variant, _)| *variant).ok_or_else(|| {
            Error::file(
                checkpoint,
                format!("a UNet of See3D, not weights of {}", wanted.title),
                "give the checkpoint of that network, or the name of this one",
            )
        });
    }
    let path = std::path::absolute(checkpoint).map_err(Error::io("find", checkpoint))?;
    let mut folders = path.ancestors().skip(1).take(2).filter_map(Path::file_name);
    let named = folders.find_map(|folder| {
        let mut variants = VARIANTS.iter().map(|(variant, _)| *variant);
        variants.find(|variant| folder == variant.folder())
    });
    named.ok_or_else(|| {
        let names = VARIANTS.map(|(_, network)| network.name);
        Error::file(
            checkpoint,
            "a UNet of See3D, of which there are three, and its folder (sparse, single or SR) does not say \
             which",
            format!("say it: --network {}", names.join(" or ")),
        )
    })
}

/// The scheduler's settings, from the folder of the pipeline.
fn scheduler(checkpoint: &Path, notes: &mut Vec<String>) -> Result<schedule::Config> {
    let Some(file) = Beside::named("scheduler/scheduler_config.json", checkpoint)? else {
        notes.push(
            "no scheduler/scheduler_config.json is in its folder or above: the settings of Stable \
             Diffusion 2.1 are assumed (v-prediction)"
                .to_owned(),
        );
        return Ok(schedule::Config::released());
    };
    let config: schedule::Config = file.parse()?;
    config.check().map_err(|e| file.refuse(&first_line(&e)))?;
    notes.extend(config.warning());
    Ok(config)
}

fn image_encoder(
    checkpoint: &Checkpoint,
    file: &Beside,
    notes: &mut Vec<String>,
) -> Result<Config> {
    let path = checkpoint.path();
    let mut vision =
        VisionConfig::from_json(&file.value()).map_err(|e| file.refuse(&first_line(&e)))?;
    // Files of whole models say that of something else.
    if let Some([width, ..]) = checkpoint.shapes().get("visual_projection.weight") {
        vision.projection_dim = *width;
    }
    let side = vision.image_size;
    let preprocessor = match beside::preprocessor(path)? {
        Some(preprocessor) if preprocessor.crop == [side; 2] => preprocessor,
        Some(preprocessor) => {
            let crop = preprocessor.crop;
            return Err(file.refuse(&format!(
                "image_size is {side}, but preprocessor_config.json cuts pictures to {crop:?}"
            )));
        }
        None => {
            notes.push(format!(
                "no preprocessor_config.json is beside it: the colours of CLIP at {side} pixels are assumed"
            ));
            Preprocessor::of_side(side)
        }
    };
    Ok(Config::ImageEncoder(ImageEncoderConfig {
        vision,
        preprocessor,
    }))
}

fn text_encoder(checkpoint: &Path, file: &Beside, notes: &mut Vec<String>) -> Result<Config> {
    let text = TextConfig::from_json(&file.value()).map_err(|e| file.refuse(&first_line(&e)))?;
    // Before anything is made of its sizes.
    TextEncoder::tensors(&text).map_err(|e| file.refuse(&first_line(&e)))?;
    let empty_prompt = match beside::empty_prompt(checkpoint)? {
        Some(tokens) => tokens,
        None => {
            notes.push(
                "no tokenizer is beside its folder: the empty text of Stable Diffusion 2.1 is assumed"
                    .to_owned(),
            );
            TextEncoderConfig::usual_empty_prompt(&text)
        }
    };
    let (most, positions) = (text.vocab_size, text.max_position_embeddings);
    if empty_prompt.len() != positions || empty_prompt.iter().any(|&id| id as usize >= most) {
        return Err(file.refuse(&format!(
            "the tokenizer makes {} tokens of the empty text, up to number {}, where the network knows {most} and \
             takes {positions}",
            empty_prompt.len(),
            empty_prompt.iter().max().copied().unwrap_or(0),
        )));
    }
    Ok(Config::TextEncoder(TextEncoderConfig {
        text,
        empty_prompt,
    }))
}
