//! The whole method on a procedural room, compared with the truth about it.
//!
//! [`room`] builds and photographs a furnished room; [`disturb`] makes errors like those of imperfect
//! networks. Everything in between is the method itself, as the other verbs run it.
//!
//! ```
//! use tid3r::demo::room::Room;
//!
//! let room = Room::furnish(42);
//! let chair = room.objects().iter().find(|object| object.name.starts_with("chair"));
//! let chair = chair.expect("there is a chair in this room");
//! let without = room.without(chair.id);
//! assert_eq!(without.objects().len(), room.objects().len() - 1);
//!
//! // A walk around the room, and views in between to compare with.
//! let (photos, held_out) = room.cameras(12, 4);
//! assert_eq!((photos.len(), held_out.len()), (12, 4));
//! // Eye heights, in metres.
//! assert!(photos.iter().all(|camera| (1.38..1.62).contains(&camera.centre().z)));
//! ```

pub mod disturb;
mod free_place;
mod page;
mod report;
pub mod room;
mod run;
mod stage_set;

pub use report::{DemoReport, DepthFigures, EditedViewFigures, InstanceFigures, ViewFigures};
pub use run::{DemoParams, run};
