//! From the (edited) cloud to pictures: projection, reference masks, completion.

mod completer;
mod contact_sheet;
pub mod fill;
mod path;
mod projection;
mod record;
mod references;
pub mod see3d;
mod stage;
mod top_down;

pub use completer::{
    Bare, Completed, Completer, Completion, Follower, Keeps, Kept, Step, View, Views,
};
pub use contact_sheet::contact_sheet;
pub use path::{between, orbit, path_cameras};
pub use projection::{Projection, SplatParams, project};
pub use record::{scene_recipe, unedited_recipe};
pub use references::{Reference, ReferenceParams, reference_masks};
pub use stage::{EditedScene, Rendering, Shown, Story, Target, ViewFiles, Written};
pub use top_down::top_down;
