use super::{shown, target::Target};
use crate::cli::terminal::Terminal;
use anyhow::Result;
use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser},
};
use std::{collections::BTreeSet, path::Path};
use tid3r_weights_convert::{self as weights, Network, Places, Written};

/// Make weights from a seed, with the names and shapes of the real ones.
///
/// A network runs on them as on real ones, for tests and measurements; what it says is noise. The same
/// seed gives the same file everywhere.
#[derive(Debug, Args)]
pub(super) struct Synthesize {
    /// The network, or the method whose networks are all made, each in a folder of its name: see3d, mobilesamv2
    #[arg(value_name = "NETWORK", value_parser = names_and_groups())]
    network: Networks,
    #[command(flatten)]
    target: Target,
    /// A network with all its parts, but of a few megabytes at most
    #[arg(long)]
    tiny: bool,
    /// Where the numbers come from
    #[arg(long, value_name = "N", default_value_t = 42)]
    seed: u64,
}

/// One network or several, as they are named.
#[derive(Clone, Debug)]
struct Networks(Vec<&'static Network>);

fn names_and_groups() -> impl TypedValueParser<Value = Networks> {
    let names = Network::all().iter().map(|network| network.name);
    let groups = names
        .clone()
        .filter_map(|name| Some(name.split_once('-')?.0))
        .filter(|name| Network::all_named(name).is_ok_and(|networks| networks.len() > 1));
    let groups: BTreeSet<_> = groups.collect();
    PossibleValuesParser::new(names.chain(groups))
        .try_map(|name| Network::all_named(&name).map(Networks))
}

impl Synthesize {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let places = Places::of_environment();
        match self.network.0[..] {
            [network] => {
                let folder = self.target.folder(|| Ok(network), &places)?;
                self.target.report(&self.make(network, &folder, terminal)?)
            }
            ref networks => {
                let models = self.target.models(&places)?;
                let make = |network: &&'static Network| {
                    self.make(network, &models.join(network.name), terminal)
                };
                let written: Vec<_> = networks.iter().map(make).collect::<Result<_>>()?;
                self.target.report_all(&written)
            }
        }
    }

    fn make(
        &self,
        network: &'static Network,
        folder: &Path,
        terminal: &Terminal,
    ) -> Result<Written> {
        let config = if self.tiny {
            network.tiny()
        } else {
            network.released()
        };
        let Target { dtype, force, .. } = self.target;
        let progress = &mut shown(terminal);
        Ok(weights::synthesize(
            config, self.seed, dtype, folder, force, progress,
        )?)
    }
}
