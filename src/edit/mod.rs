//! Edits of the instance-labelled cloud: a list, applied whenever the scene is used.
//!
//! Nothing is ever destroyed: undoing drops the last entry of the list.
//!
//! ```
//! use tid3r::edit::{Edit, EditList, Placement, describe};
//!
//! let mut list = EditList::default();
//! list.push(Edit::Remove { instances: vec![3, 5] })?;
//! let placement = Placement { by: [0.5, 0.0, 0.0], turn_degrees: 90.0, ..Placement::default() };
//! list.push(Edit::Move { instance: 1, placement })?;
//! assert_eq!(describe(&list.edits()[1]), "move 1 by 0.5, 0, 0, turned 90°");
//!
//! list.undo();
//! assert_eq!(list.edits(), [Edit::Remove { instances: vec![3, 5] }]);
//! list.redo();
//! assert_eq!(list.edits().len(), 2);
//! // An instance cannot become part of itself.
//! assert!(list.push(Edit::Merge { instance: 1, others: vec![1], name: None }).is_err());
//! # Ok::<(), tid3r::Error>(())
//! ```

mod apply;
mod colour;
mod instance_list;
mod list;
mod motions;
mod placement;
mod split;
mod stage;

pub use apply::{Edited, apply};
pub use colour::{ColourChange, Hex};
pub use instance_list::InstanceList;
pub use list::{EditList, read_edits};
pub use motions::Motions;
pub use placement::Placement;
pub(crate) use placement::floor_box;
pub use split::{MOST_CLUSTERS, SplitBy};
pub use stage::{
    SplitRequest, edited, instances, instances_of, keep, restyle, split, write_overviews,
};

use serde::{Deserialize, Serialize};

/// One edit. Instances go by their ids.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "edit", rename_all = "snake_case")]
pub enum Edit {
    /// Calls an instance something.
    Rename {
        /// Which.
        instance: u32,
        /// What it is called from now on.
        name: String,
    },
    /// Makes instances one.
    Merge {
        /// Whose id and name stay.
        instance: u32,
        /// Those that become part of it, and are no more.
        others: Vec<u32>,
        /// What it is called from now on, if not what it was called before.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        name: Option<String>,
    },
    /// Makes parts of an instance instances of their own.
    Split {
        /// Which; one part keeps its id and name.
        instance: u32,
        /// What says which part a point belongs to.
        by: SplitBy,
        /// The ids of the other parts.
        parts: Vec<u32>,
    },
    /// Deletes the points of instances.
    Remove {
        /// Which.
        instances: Vec<u32>,
    },
    /// Deletes everything but the points of instances: points of no instance too.
    KeepOnly {
        /// Which stay.
        instances: Vec<u32>,
    },
    /// Moves, turns and scales an instance.
    Move {
        /// Which.
        instance: u32,
        /// Where to.
        placement: Placement,
    },
    /// Moves, turns and scales a copy of an instance, which becomes an instance of its own.
    Duplicate {
        /// Of which.
        instance: u32,
        /// The copy's id.
        copy: u32,
        /// Where the copy goes.
        placement: Placement,
    },
    /// Changes the colour of instances, in the cloud and in the photos.
    Recolour {
        /// Which.
        instances: Vec<u32>,
        /// How.
        change: ColourChange,
    },
    /// Takes all colours from a second set of photos of the same views.
    Restyle {
        /// The folder within the scene's that holds them, one PNG of a frame's size and name each.
        style: String,
    },
}

impl Edit {
    /// Whether the edit can be applied to any scene.
    ///
    /// # Errors
    /// What is wrong with it.
    fn check(&self) -> Result<(), String> {
        let new = self.new_instances();
        if let Some(id) = new.iter().find(|&&id| id == 0 || id == u32::MAX) {
            return Err(format!("no instance can have the id {id}"));
        }
        if (1..new.len()).any(|k| new[k] <= new[k - 1]) {
            return Err(format!("new ids have to ascend, unlike {new:?}"));
        }
        match self {
            Self::Merge {
                instance, others, ..
            } => {
                if others.is_empty() || others.contains(instance) {
                    return Err("only instances that differ can be merged".into());
                }
                Ok(())
            }
            Self::Split { by, .. } if new.is_empty() => Err(format!("no part is split off {by}")),
            Self::Split { by, .. } => by.check(),
            Self::Move { placement, .. } | Self::Duplicate { placement, .. } => placement.check(),
            Self::Restyle { style } => {
                let plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
                if style.is_empty() || !style.chars().all(plain) {
                    return Err(format!("'{style}' is not a style's folder"));
                }
                Ok(())
            }
            Self::Rename { .. }
            | Self::Remove { .. }
            | Self::KeepOnly { .. }
            | Self::Recolour { .. } => Ok(()),
        }
    }

    /// The instances that the edit is about, which there must be.
    fn named_instances(&self) -> Vec<u32> {
        match self {
            Self::Rename { instance, .. }
            | Self::Split { instance, .. }
            | Self::Move { instance, .. }
            | Self::Duplicate { instance, .. } => vec![*instance],
            Self::Merge {
                instance, others, ..
            } => std::iter::once(instance).chain(others).copied().collect(),
            Self::Remove { instances }
            | Self::KeepOnly { instances }
            | Self::Recolour { instances, .. } => instances.clone(),
            Self::Restyle { .. } => Vec::new(),
        }
    }

    /// The instances that there are from this edit on.
    fn new_instances(&self) -> &[u32] {
        match self {
            Self::Split { parts, .. } => parts,
            Self::Duplicate { copy, .. } => std::slice::from_ref(copy),
            _ => &[],
        }
    }
}

/// What an edit does, in a few words.
pub fn describe(edit: &Edit) -> String {
    let list = |ids: &[u32]| {
        let ids: Vec<String> = ids.iter().map(u32::to_string).collect();
        ids.join(", ")
    };
    match edit {
        Edit::Rename { instance, name } => format!("instance {instance} is called '{name}'"),
        Edit::Merge {
            instance,
            others,
            name,
        } => {
            let called = name.as_ref().map(|name| format!(", called '{name}'"));
            let called = called.unwrap_or_default();
            format!("merge {} into {instance}{called}", list(others))
        }
        Edit::Split {
            instance,
            by,
            parts,
        } => format!("split {instance} {by}: new are {}", list(parts)),
        Edit::Remove { instances } => format!("remove {}", list(instances)),
        Edit::KeepOnly { instances } => format!("keep only {}", list(instances)),
        Edit::Move {
            instance,
            placement,
        } => format!("move {instance} {placement}"),
        Edit::Duplicate {
            instance,
            copy,
            placement,
        } => format!("copy {instance} as {copy} {placement}"),
        Edit::Recolour { instances, change } => {
            let change = match change {
                ColourChange::Adjust {
                    hue_degrees,
                    saturation,
                    value,
                } => format!("hue {hue_degrees:+}°, saturation x{saturation}, value x{value}"),
                ColourChange::To { colour } => String::from(*colour),
            };
            format!("recolour {} ({change})", list(instances))
        }
        Edit::Restyle { style } => format!("restyle ({style})"),
    }
}
