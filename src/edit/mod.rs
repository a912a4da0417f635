//! Edits of the instance-labelled cloud: a list, applied whenever the scene is used.
//!
//! Nothing is ever destroyed: undoing drops the last entry of the list.

mod apply;
mod colour;
mod list;
mod placement;
mod stage;

pub use apply::{Edited, apply};
pub use colour::{ColourChange, Hex};
pub use list::EditList;
pub use placement::Placement;
pub(crate) use placement::floor_box;
pub use stage::{InstanceList, edited, restyle, write_overviews};

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
        match self {
            Self::Move { placement, .. } => placement.check(),
            Self::Duplicate {
                copy, placement, ..
            } => match *copy {
                0 | u32::MAX => Err(format!("no copy can have the id {copy}")),
                _ => placement.check(),
            },
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
}

/// What an edit does, in a few words.
pub fn describe(edit: &Edit) -> String {
    let list = |ids: &[u32]| {
        let ids: Vec<String> = ids.iter().map(u32::to_string).collect();
        ids.join(", ")
    };
    match edit {
        Edit::Rename { instance, name } => format!("instance {instance} is called '{name}'"),
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
