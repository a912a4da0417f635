//! Where in a checkpoint's pickle the weights are.

use super::modules;
use super::tensor::{View, view};
use crate::error::excerpt;
use crate::pickle::{Id, Node, Pickle};

/// The most tensors that are read: those of the largest network known are 2000, with an optimiser's
/// bookkeeping some more.
const MOST_TENSORS: usize = 1 << 16;
/// The longest name of a tensor, in bytes. A pickle can name the same long text any number of times.
const LONGEST_NAME: usize = 1 << 10;

/// The weights of a checkpoint, and what is saved beside them.
#[derive(Debug, Default)]
pub(super) struct Found<'a> {
    /// Names and tensors, as they come; of a name that occurs twice, the last counts.
    pub(super) tensors: Tensors<'a>,
    /// The call that makes the network, as the training script has it in `args.model`.
    pub(super) constructor: Option<&'a str>,
    /// How many names of classes a detector has.
    pub(super) classes: Option<usize>,
}

/// A growing list of tensors, within bounds.
#[derive(Debug, Default)]
pub(super) struct Tensors<'a>(pub(super) Vec<(String, View<'a>)>);

impl<'a> Tensors<'a> {
    /// Adds the tensor at `id` under `prefix` and `key`.
    pub(super) fn add(
        &mut self,
        pickle: &Pickle<'a>,
        prefix: &str,
        key: Id,
        id: Id,
    ) -> Result<(), String> {
        let name = joined(pickle, prefix, key)?;
        if self.0.len() == MOST_TENSORS {
            return Err(format!("it has more than {MOST_TENSORS} tensors"));
        }
        let view = view(pickle, id)
            .map_err(|problem| format!("tensor `{}`: {problem}", excerpt(&name)))?;
        self.0.push((name, view));
        Ok(())
    }
}

/// `prefix` and the text at `key`, with a dot between.
pub(super) fn joined(pickle: &Pickle<'_>, prefix: &str, key: Id) -> Result<String, String> {
    let Some(name) = pickle.text(key) else {
        return Err(format!("{} names a tensor", pickle.describe(key)));
    };
    if prefix.len() + name.len() > LONGEST_NAME {
        let name = excerpt(name);
        return Err(format!("a name is too long for a tensor's: `{name}`"));
    }
    Ok(match prefix {
        "" => name.to_owned(),
        _ => format!("{prefix}.{name}"),
    })
}

/// Finds the weights. They are, whichever is there first,
///
/// - the module objects under `ema` or `model`, or those that are the whole: of a checkpoint in which
///   a training script has saved its network and not the network's state;
/// - the state dict under `model` or `state_dict`, or else the whole: a dictionary of tensors, or of
///   such dictionaries, whose names are put before those of their tensors.
///
/// Nothing else of the file is looked at but `args.model` and a network's names of classes; an
/// optimiser's tensors are not.
///
/// # Errors
///
/// What is wrong, as part of a message.
pub(super) fn find<'a>(pickle: &Pickle<'a>) -> Result<Found<'a>, String> {
    let root = pickle.root();
    let mut found = Found {
        constructor: constructor(pickle),
        ..Found::default()
    };
    let network = ["ema", "model"]
        .iter()
        .filter_map(|key| pickle.entry(root, key))
        .chain([root])
        .find_map(|id| modules::Module::at(pickle, id));
    if let Some(network) = network {
        network.tensors(pickle, &mut found.tensors)?;
        found.classes = network.classes(pickle);
        if found.tensors.0.is_empty() {
            return Err("its network has no tensors".to_owned());
        }
        return Ok(found);
    }
    let Some(entries) = pickle.entries(root) else {
        let what = pickle.describe(root);
        return Err(format!("it holds {what} and no dictionary of tensors"));
    };
    let named = ["model", "state_dict"].iter().find_map(|key| {
        let value = pickle.entry(root, key)?;
        pickle.entries(value)
    });
    for &(key, value) in named.unwrap_or(entries).iter() {
        match pickle.entries(value) {
            None => found.tensors.add(pickle, "", key, value)?,
            Some(inner) => {
                let prefix = joined(pickle, "", key)?;
                for &(key, value) in inner.iter() {
                    found.tensors.add(pickle, &prefix, key, value)?;
                }
            }
        }
    }
    if found.tensors.0.is_empty() {
        return Err("its dictionary of tensors is empty".to_owned());
    }
    Ok(found)
}

/// `args.model`, where `args` is a namespace or a dictionary.
fn constructor<'a>(pickle: &Pickle<'a>) -> Option<&'a str> {
    let args = pickle.entry(pickle.root(), "args")?;
    let attributes = pickle.state(args).unwrap_or(args);
    let model = pickle.entry(attributes, "model")?;
    pickle.text(model)
}

/// How many entries the dictionary or list at `id` has.
pub(super) fn count(pickle: &Pickle<'_>, id: Id) -> Option<usize> {
    match pickle.get(id) {
        Node::List(list) => Some(list.len()),
        _ => Some(pickle.entries(id)?.len()),
    }
}
