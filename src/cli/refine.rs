//! `--refine` and its settings, which several verbs have.

use anyhow::Result;
use clap::{ArgMatches, Args, Command, FromArgMatches, ValueEnum};
use serde_json::Value;
use std::path::PathBuf;
use tid3r::{
    Error,
    render::{
        Bare, Completer,
        fill::Fill,
        see3d::{See3d, See3dParams, See3dWeights},
    },
};
use tid3r_models::ComputeType;
use tid3r_weights_convert::Places;

/// How empty pixels are completed.
///
/// The long names of its arguments begin with `see3d-` where a verb has an argument of the shorter name
/// already.
#[derive(Debug)]
pub(super) struct Options(Arguments);

#[derive(Debug, Args)]
#[group(skip)]
struct Arguments {
    /// How empty pixels are completed
    #[arg(long, value_enum, value_name = "HOW", default_value_t = Refine::Fill, help_heading = "Rendering")]
    refine: Refine,
    /// Folder of See3D's weights, a folder in it for each network, instead of where `tid3r weights path`
    /// finds them; or `synthetic-tiny` for tiny made-up ones, with which everything runs in moments and
    /// pictures mean nothing
    #[arg(id = "see3d_weights", long = "see3d-weights", value_name = "FOLDER", help_heading = SEE3D)]
    weights: Option<PathBuf>,
    #[command(flatten, next_help_heading = SEE3D)]
    see3d: See3dParams,
}

const SEE3D: &str = "Completion by See3D";

/// What completes projections.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Refine {
    /// Nothing: the bare projection stays
    None,
    /// What the photos agree on, and smooth colour elsewhere
    Fill,
    /// See3D, a diffusion network that is guided by the photos
    See3d,
}

/// Arguments with shorter names, and what takes those names where it is there.
const SHORTER: [(&str, &str, &[&str]); 5] = [
    ("see3d_weights", "weights", &["weights", "weights-dir"]),
    ("see3d_size", "size", &["size"]),
    ("see3d_references", "references", &["references"]),
    ("see3d_seed", "seed", &["seed"]),
    ("see3d_memory", "max-memory", &["max-memory"]),
];

impl Args for Options {
    fn augment_args(command: Command) -> Command {
        let taken: Vec<String> = (command.get_arguments())
            .filter_map(|argument| argument.get_long().map(str::to_string))
            .collect();
        let mut command = Arguments::augment_args(command);
        for (id, short, others) in SHORTER {
            if !taken.iter().any(|name| others.contains(&&**name)) {
                command = command.mut_arg(id, |argument| argument.long(short));
            }
        }
        command
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Options {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self(Arguments::from_arg_matches(matches)?))
    }

    fn from_arg_matches_mut(matches: &mut ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self(Arguments::from_arg_matches_mut(matches)?))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.0.update_from_arg_matches(matches)
    }
}

impl Options {
    /// The same with networks that compute with this type.
    pub(super) fn in_type(mut self, dtype: ComputeType) -> Self {
        self.0.see3d.dtype = dtype;
        self
    }

    /// Whether networks complete projections.
    pub(super) fn has_networks(&self) -> bool {
        self.0.refine == Refine::See3d
    }

    /// What completes projections, with weights in `places` if it needs some and none are named.
    ///
    /// Settings of See3D without See3D are refused: whoever gives them believes that it is at work.
    pub(super) fn completer(&self, places: &Places) -> Result<Box<dyn Completer>> {
        let Arguments {
            refine,
            weights,
            see3d,
        } = &self.0;
        if *refine != Refine::See3d {
            let given = self.settings_of_see3d();
            if !given.is_empty() {
                let problem = format!(
                    "settings of See3D are given ({}), and it is not what completes the views",
                    given.join(", ")
                );
                return Err(Error::request(problem, "give --refine see3d, too").into());
            }
        }
        Ok(match refine {
            Refine::None => Box::new(Bare),
            Refine::Fill => Box::new(Fill),
            Refine::See3d => {
                let weights = match weights {
                    Some(name) if name.as_os_str() == "synthetic-tiny" => {
                        See3dWeights::synthetic_tiny(see3d)?
                    }
                    Some(folder) => See3dWeights::find(&places.clone().with_models(folder), see3d)?,
                    None => See3dWeights::find(places, see3d)?,
                };
                Box::new(See3d::new(weights, see3d))
            }
        })
    }

    /// Names of the settings of See3D that are not what they are by default.
    fn settings_of_see3d(&self) -> Vec<String> {
        let Arguments { weights, see3d, .. } = &self.0;
        let of = |params: &See3dParams| serde_json::to_value(params).unwrap_or_default();
        let (given, default) = (of(see3d), of(&See3dParams::default()));
        let settings = given.as_object().into_iter().flatten();
        let mut names: Vec<String> = settings
            .filter(|(name, value)| default.get(name).unwrap_or(&Value::Null) != *value)
            .map(|(name, _)| name.replace('_', "-"))
            .collect();
        names.extend(weights.as_ref().map(|_| "weights".to_string()));
        names.extend(see3d.max_memory.map(|_| "max-memory".to_string()));
        names
    }
}
