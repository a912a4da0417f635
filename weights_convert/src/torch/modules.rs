//! A network that was saved as the objects it consists of, not as a state dict.
//!
//! What PyTorch calls a module is, in a pickle, an object of whatever class with a dictionary of
//! attributes, among them `_parameters`, `_buffers` and `_modules`: dictionaries of tensors and of
//! further modules. The names of the state dict are the paths through `_modules`. Classes are not
//! looked at: training code moves its classes about, and the graph is the same.

use super::found::{Tensors, count, joined};
use crate::error::excerpt;
use crate::pickle::{Id, Node, Pickle};

/// How deep modules may lie in each other. Those of the networks that are known lie 7 deep.
const DEEPEST: usize = 32;
/// The most entries of modules' dictionaries that are looked at, counted again for each module that
/// shares them: fifty times as many as the largest known network has.
const MOST_ENTRIES: usize = 1 << 20;

/// A module.
#[derive(Clone, Copy)]
pub(super) struct Module {
    /// The dictionary of its attributes.
    attributes: Id,
}

impl Module {
    /// The module at `id`, if that is one.
    pub(super) fn at(pickle: &Pickle<'_>, id: Id) -> Option<Self> {
        let attributes = pickle.state(id)?;
        pickle.entries(pickle.entry(attributes, "_modules")?)?;
        Some(Self { attributes })
    }

    /// How many names of classes it has, if it is a detector.
    pub(super) fn classes(self, pickle: &Pickle<'_>) -> Option<usize> {
        count(pickle, pickle.entry(self.attributes, "names")?)
    }

    /// Adds the parameters and buffers of this module and of all in it.
    ///
    /// # Errors
    ///
    /// What is wrong, as part of a message.
    pub(super) fn tensors<'a>(
        self,
        pickle: &Pickle<'a>,
        tensors: &mut Tensors<'a>,
    ) -> Result<(), String> {
        let mut walk = Walk {
            pickle,
            tensors,
            left: MOST_ENTRIES,
        };
        walk.enter(self, "", 0)
    }
}

/// A walk along all paths. A module may lie on many, even within itself.
struct Walk<'w, 'a> {
    pickle: &'w Pickle<'a>,
    tensors: &'w mut Tensors<'a>,
    /// Entries that may still be looked at.
    left: usize,
}

impl Walk<'_, '_> {
    fn enter(&mut self, module: Module, path: &str, depth: usize) -> Result<(), String> {
        if depth > DEEPEST {
            let path = excerpt(path);
            return Err(format!("its modules are nested too deep: `{path}`"));
        }
        let attributes = self.pickle.entries(module.attributes);
        self.look_at(attributes.map_or(0, |entries| entries.len()))?;
        for kind in ["_parameters", "_buffers"] {
            for (key, value) in self.held(module, kind, path)? {
                self.tensors.add(self.pickle, path, key, value)?;
            }
        }
        for (key, value) in self.held(module, "_modules", path)? {
            let path = joined(self.pickle, path, key)?;
            let inner = Module::at(self.pickle, value).ok_or_else(|| {
                let what = self.pickle.describe(value);
                format!("module `{}`: {what} is no module", excerpt(&path))
            })?;
            self.enter(inner, &path, depth + 1)?;
        }
        Ok(())
    }

    /// The entries of the module's dictionary called `kind`, without those that are empty.
    fn held(&mut self, module: Module, kind: &str, path: &str) -> Result<Vec<(Id, Id)>, String> {
        let held = self.pickle.entry(module.attributes, kind);
        let entries = held.and_then(|id| self.pickle.entries(id));
        let entries = entries.ok_or_else(|| {
            let path = excerpt(path);
            format!("module `{path}` has no dictionary `{kind}`")
        })?;
        self.look_at(entries.len())?;
        let there = |(_, value): &&(Id, Id)| !matches!(self.pickle.get(*value), Node::None);
        Ok(entries.iter().filter(there).copied().collect())
    }

    fn look_at(&mut self, entries: usize) -> Result<(), String> {
        let left = self.left.checked_sub(entries);
        self.left = left.ok_or("its modules are too many, or within each other many times")?;
        Ok(())
    }
}
