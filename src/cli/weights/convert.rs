use super::{names, shown, target::Target};
use crate::cli::terminal::Terminal;
use anyhow::{Result, bail};
use clap::Args;
use std::path::PathBuf;
use tid3r_weights_convert::{self as weights, ConvertOptions, Network, Places, Repository};

/// Convert a published checkpoint (.pth, .pt, .bin, .safetensors) to the form that tid3r reads.
///
/// Writes model.safetensors and config.json, with the source's hash and licence. The checkpoint is
/// read as data: nothing in it is executed. It must have exactly the tensors of the network, which is
/// found out from them; memory use is small whatever its size. A checkpoint in several files is given by
/// its index (.index.json) or by the folder that they are in. A .safetensors file of tid3r's is read too, for
/// example to convert to another precision.
///
/// The networks of See3D are published in one folder, MVD_weights. Given that folder, each of them is
/// converted to a folder of its name in FOLDER; those that have been converted before are kept, so that the
/// same command goes on where it was stopped. A part of it alone, such as MVD_weights/vae, is converted to
/// FOLDER itself.
///
/// LPIPS is published in two files: `convert alexnet-owt-7be5be79.pth --with alex.pth`, or `convert
/// vgg16-397923af.pth --with vgg.pth`.
#[derive(Debug, Args)]
pub(super) struct Convert {
    /// The checkpoint, its folder, that of all of See3D, or a network's name for what is in the local cache
    /// of Hugging Face
    #[arg(value_name = "CHECKPOINT")]
    source: PathBuf,
    /// A checkpoint with the tensors that the first one lacks: the heads of LPIPS, which complete
    /// torchvision's AlexNet or VGG16
    #[arg(long, value_name = "CHECKPOINT")]
    with: Vec<PathBuf>,
    #[command(flatten)]
    target: Target,
    /// Which network it is of, if neither its tensors nor its folder say (the UNets of See3D)
    #[arg(long, value_name = "NETWORK", value_parser = names())]
    network: Option<String>,
    /// Attention heads of encoder and decoder, for a checkpoint that does not say them
    #[arg(long, value_name = "ENCODER,DECODER", value_parser = heads)]
    heads: Option<(usize, usize)>,
}

fn heads(text: &str) -> Result<(usize, usize), String> {
    let parsed = (text.split_once(',')).and_then(|(encoder, decoder)| {
        let count = |text: &str| text.trim().parse().ok().filter(|&count| count > 0);
        Some((count(encoder)?, count(decoder)?))
    });
    parsed.ok_or_else(|| "expected two numbers, as in 16,12".to_string())
}

impl Convert {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let places = Places::of_environment();
        let source = self.source(&places)?;
        let options = ConvertOptions {
            precision: self.target.dtype,
            replace: self.target.force,
            heads: self.heads,
            network: self.network.as_deref().map(Network::named).transpose()?,
            with: &self.with,
        };
        if let Some(repository) = Repository::at(&source) {
            return self.convert_all(&repository, &options, &places, terminal);
        }
        let folder = self
            .target
            .folder(|| weights::network_of(&source, &options), &places)?;
        let written = weights::convert(&source, &folder, &options, &mut shown(terminal))?;
        self.target.report(&written)
    }

    /// What is given, or in the local cache of Hugging Face if a name is.
    fn source(&self, places: &Places) -> Result<PathBuf> {
        let networks = match self.source.to_str() {
            Some(name) if !self.source.exists() => Network::all_named(name).unwrap_or_default(),
            _ => Vec::new(),
        };
        match networks[..] {
            [] => Ok(self.source.clone()),
            [network] => match places.published(network) {
                Some(file) => Ok(file),
                None => bail!(
                    "{} is not in the local cache of Hugging Face; get it from {} and give the file",
                    network.files[0],
                    network.source
                ),
            },
            [first, ..] => {
                let found = |network: &&Network| places.repository_with(network);
                match networks.iter().find_map(found) {
                    Some(repository) => Ok(repository.root().to_path_buf()),
                    None => bail!(
                        "{} is not in the local cache of Hugging Face; get it from {} and give the folder",
                        first.folder.unwrap_or(first.files[0]),
                        first.source
                    ),
                }
            }
        }
    }

    /// Converts every network in a folder in which several are published.
    fn convert_all(
        &self,
        repository: &Repository,
        options: &ConvertOptions<'_>,
        places: &Places,
        terminal: &Terminal,
    ) -> Result<()> {
        if let Some(other) = self.with.first() {
            bail!(
                "several networks are in {}, and {} completes none of them; leave --with out",
                repository.root().display(),
                other.display()
            );
        }
        if self.network.is_some() {
            bail!(
                "several networks are in {}; give the folder of one of them with --network, or no \
                 --network",
                repository.root().display()
            );
        }
        let models = self.target.models(places)?;
        let written = repository.convert(&models, options, &mut shown(terminal))?;
        for (network, folder) in repository.missing() {
            tracing::warn!(
                "{} is not there, so there is no {}: it is for {}",
                folder.display(),
                network.name,
                network.purpose
            );
        }
        self.target.report_all(&written)
    }
}
