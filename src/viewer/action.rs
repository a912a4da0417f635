//! What the page asks to be changed.

use crate::{
    Error, Result,
    edit::{self, ColourChange, Edit, EditList, InstanceList, Placement, SplitBy, SplitRequest},
    scene::Scene,
};
use serde::Deserialize;

/// A change of the list of edits.
#[derive(Debug, Deserialize)]
#[serde(tag = "action", rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Action {
    Rename {
        instance: u32,
        name: String,
    },
    Merge {
        instance: u32,
        others: Vec<u32>,
    },
    Split {
        instance: u32,
        by: Split,
    },
    Remove {
        instances: Vec<u32>,
    },
    KeepOnly {
        instances: Vec<u32>,
    },
    Move {
        instance: u32,
        placement: Placed,
    },
    Duplicate {
        instance: u32,
        placement: Placed,
    },
    Recolour {
        instances: Vec<u32>,
        change: ColourChange,
    },
    Undo,
    Redo,
    /// Undoes edits until so many are left.
    UndoTo {
        edits: usize,
    },
}

/// A [`SplitRequest`].
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Split {
    /// By gaps that are wide for this instance.
    Touching,
    /// By anything else.
    By(SplitBy),
}

/// A [`Placement`] of which parts may be left out.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Placed {
    by: [f64; 3],
    to: Option<[f64; 2]>,
    turn_degrees: f64,
    scale: Option<f64>,
}

impl From<Placed> for Placement {
    fn from(placed: Placed) -> Self {
        Self {
            by: placed.by,
            to: placed.to,
            turn_degrees: placed.turn_degrees,
            scale: placed.scale.unwrap_or(1.0),
        }
    }
}

impl Action {
    /// Makes the change in a list.
    ///
    /// # Errors
    /// When it is about an instance that there is not, or cannot be made.
    pub(super) fn change(self, scene: &Scene, list: &mut EditList) -> Result<()> {
        let edit = match self {
            Self::Undo => {
                let undone = list.undo().is_some();
                return some_if(undone, "undo", "edit something first");
            }
            Self::Redo => {
                let redone = list.redo().is_some();
                return some_if(redone, "do again", "undo something first");
            }
            Self::UndoTo { edits } => {
                let undone = list.edits().len() > edits;
                while list.edits().len() > edits {
                    list.undo();
                }
                return some_if(undone, "undo", "choose an earlier edit");
            }
            Self::Rename { instance, name } => Edit::Rename {
                instance,
                name: name.trim().to_string(),
            },
            Self::Merge { instance, others } => Edit::Merge {
                instance,
                others,
                name: None,
            },
            Self::Split { instance, by } => {
                let request = match by {
                    Split::Touching => SplitRequest::Components(None),
                    Split::By(by) => SplitRequest::By(by),
                };
                edit::split(scene, list.edits(), instance, &request)?
            }
            Self::Remove { instances } => Edit::Remove {
                instances: some(instances)?,
            },
            Self::KeepOnly { instances } => Edit::KeepOnly {
                instances: some(instances)?,
            },
            Self::Move {
                instance,
                placement,
            } => Edit::Move {
                instance,
                placement: placement.into(),
            },
            Self::Duplicate {
                instance,
                placement,
            } => Edit::Duplicate {
                instance,
                copy: InstanceList::load(scene, list.edits())?.unused_id(),
                placement: placement.into(),
            },
            Self::Recolour { instances, change } => Edit::Recolour {
                instances: some(instances)?,
                change,
            },
        };
        list.push_checked(scene, edit)
    }
}

fn some_if(done: bool, what: &str, remedy: &str) -> Result<()> {
    let nothing = || Error::request(format!("there is nothing to {what}"), remedy);
    done.then_some(()).ok_or_else(nothing)
}

fn some(instances: Vec<u32>) -> Result<Vec<u32>> {
    if instances.is_empty() {
        return Err(Error::request("no instance is named", "choose one first"));
    }
    Ok(instances)
}
