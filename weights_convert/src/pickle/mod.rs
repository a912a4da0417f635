//! A reader of pickles that executes nothing.
//!
//! A pickle is a program for a stack machine that builds objects, and the original machine calls
//! whatever function the program names. This one has no functions to call: a global is its name, a
//! call is a node that says what would have been called with what, and so the result of reading is
//! data whatever the file says. Whoever wants something of it looks for the few shapes that it
//! knows, by name.
//!
//! The result is an arena: nodes refer to others by index. So a pickle that refers to itself is no
//! cycle of owners, one that is nested a million deep is dropped without recursion, and one that
//! names the same list a billion times over ("billion laughs") costs four bytes for each time that
//! the file itself spells out. Memory is bounded by the number of instructions, which is limited;
//! no length that the file claims is believed before as many bytes are there.

mod machine;

use std::borrow::Cow;
use std::fmt;

use crate::error::excerpt;

/// The largest pickle that is read, in bytes. That of a training checkpoint of MV-DUSt3R+, the
/// optimiser's bookkeeping included, has less than one megabyte.
pub(crate) const MOST_BYTES: u64 = 16 << 20;

/// What a pickle holds; texts are borrowed from its bytes.
#[derive(Debug)]
pub(crate) struct Pickle<'a> {
    nodes: Vec<Node<'a>>,
    root: Id,
}

/// A node of a [`Pickle`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Id(u32);

/// A value. Its parts are other nodes, possibly itself.
#[derive(Debug)]
#[allow(
    dead_code,
    reason = "a pickle has more kinds of values than a checkpoint is read for"
)]
pub(crate) enum Node<'a> {
    None,
    Bool(bool),
    Int(i64),
    /// An integer that an `i64` cannot hold: little-endian, two's complement.
    LargeInt(&'a [u8]),
    Float(f64),
    Text(&'a str),
    Bytes(&'a [u8]),
    Tuple(Vec<Id>),
    List(Vec<Id>),
    Set(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    /// A class or function, by name only.
    Global {
        module: &'a str,
        name: &'a str,
    },
    /// What calling a global, or anything else, would have made.
    Object(Box<Object>),
    /// A reference to something outside the pickle: in checkpoints, a storage of numbers.
    Persistent(Id),
}

/// A call that was not made, and what would have happened to its result.
#[derive(Debug)]
pub(crate) struct Object {
    /// What would have been called: for honest files a [`Node::Global`].
    pub(crate) callable: Id,
    /// With what: for honest files a [`Node::Tuple`].
    pub(crate) arguments: Id,
    /// Entries that were set on the result, as on a dictionary.
    pub(crate) items: Vec<(Id, Id)>,
    /// Values that were appended to the result, as to a list.
    pub(crate) elements: Vec<Id>,
    /// What was handed to the result as its state.
    pub(crate) state: Option<Id>,
}

/// Why some bytes are no pickle that is read here.
#[derive(Debug)]
pub(crate) struct PickleError {
    /// Of the instruction that cannot be followed, in bytes from the start of the pickle.
    position: usize,
    problem: String,
}

impl fmt::Display for PickleError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { position, problem } = self;
        write!(f, "its pickle cannot be read at byte {position}: {problem}")
    }
}

impl<'a> Pickle<'a> {
    /// Reads a pickle of protocol 2, 3, 4 or 5.
    ///
    /// # Errors
    ///
    /// If it is cut short, has an instruction that is not known, uses the stack wrongly, or is
    /// larger than any checkpoint's.
    pub(crate) fn read(bytes: &'a [u8]) -> Result<Self, PickleError> {
        Ok(Self::read_first(bytes)?.0)
    }

    /// Reads the pickle that `bytes` begin with, and says how many of them it has.
    ///
    /// # Errors
    ///
    /// As [`Self::read`].
    pub(crate) fn read_first(bytes: &'a [u8]) -> Result<(Self, usize), PickleError> {
        machine::run(bytes)
    }

    /// All nodes.
    pub(crate) fn ids(&self) -> impl Iterator<Item = Id> {
        (0..self.nodes.len() as u32).map(Id)
    }

    /// The whole.
    pub(crate) fn root(&self) -> Id {
        self.root
    }

    /// The node `id`.
    pub(crate) fn get(&self, id: Id) -> &Node<'a> {
        // Every `Id` is made with its node, and nodes are never taken away.
        &self.nodes[id.0 as usize]
    }

    /// The text at `id`, if it is one.
    pub(crate) fn text(&self, id: Id) -> Option<&'a str> {
        match self.get(id) {
            Node::Text(text) => Some(text),
            _ => None,
        }
    }

    /// The entries of a dictionary, ordered or not; of keys that occur twice, the last counts.
    pub(crate) fn entries(&self, id: Id) -> Option<Cow<'_, [(Id, Id)]>> {
        match self.get(id) {
            Node::Dict(items) => Some(items.into()),
            Node::Object(object) if self.is_global(object.callable, ORDERED_DICT) => {
                match self.listed_entries(object.arguments) {
                    Some(items) if object.items.is_empty() => Some(items.into()),
                    _ => Some((&object.items).into()),
                }
            }
            _ => None,
        }
    }

    /// The entries that an ordered dictionary is made from: Python 2 hands over a list of lists of key and
    /// value.
    fn listed_entries(&self, arguments: Id) -> Option<Vec<(Id, Id)>> {
        let Node::Tuple(arguments) = self.get(arguments) else {
            return None;
        };
        let &[list] = &arguments[..] else {
            return None;
        };
        let Node::List(pairs) = self.get(list) else {
            return None;
        };
        let entry = |&pair: &Id| match self.get(pair) {
            Node::List(parts) | Node::Tuple(parts) => match parts[..] {
                [key, value] => Some((key, value)),
                _ => None,
            },
            _ => None,
        };
        pairs.iter().map(entry).collect()
    }

    /// The value of a dictionary under a key.
    pub(crate) fn entry(&self, dictionary: Id, key: &str) -> Option<Id> {
        let entries = self.entries(dictionary)?;
        let found = entries
            .iter()
            .rev()
            .find(|(k, _)| self.text(*k) == Some(key));
        found.map(|&(_, value)| value)
    }

    /// What a call would have been of, and with what, if it is a call of a global with a tuple.
    pub(crate) fn call(&self, id: Id) -> Option<(&'a str, &'a str, &[Id])> {
        let Node::Object(object) = self.get(id) else {
            return None;
        };
        match (self.get(object.callable), self.get(object.arguments)) {
            (Node::Global { module, name }, Node::Tuple(arguments)) => {
                Some((module, name, arguments))
            }
            _ => None,
        }
    }

    /// The state of an object.
    pub(crate) fn state(&self, id: Id) -> Option<Id> {
        match self.get(id) {
            Node::Object(object) => object.state,
            _ => None,
        }
    }

    /// What `id` is, for a message.
    pub(crate) fn describe(&self, id: Id) -> String {
        match self.get(id) {
            Node::None => "nothing".to_owned(),
            Node::Bool(_) => "a truth value".to_owned(),
            Node::Int(_) | Node::LargeInt(_) | Node::Float(_) => "a number".to_owned(),
            Node::Text(_) | Node::Bytes(_) => "text".to_owned(),
            Node::Tuple(_) => "a tuple".to_owned(),
            Node::List(_) => "a list".to_owned(),
            Node::Set(_) => "a set".to_owned(),
            Node::Dict(_) => "a dictionary".to_owned(),
            Node::Global { module, name } => format!("the name {}", dotted(module, name)),
            Node::Persistent(_) => "a storage".to_owned(),
            Node::Object(object) => match self.get(object.callable) {
                Node::Global { module, name } => format!("an object of {}", dotted(module, name)),
                _ => "an object of no known kind".to_owned(),
            },
        }
    }

    fn is_global(&self, id: Id, wanted: (&str, &str)) -> bool {
        matches!(self.get(id), Node::Global { module, name } if (*module, *name) == wanted)
    }
}

/// A dictionary that remembers its order.
const ORDERED_DICT: (&str, &str) = ("collections", "OrderedDict");

/// A name for a message.
fn dotted(module: &str, name: &str) -> String {
    format!("`{}.{}`", excerpt(module), excerpt(name))
}

#[cfg(test)]
mod tests;
