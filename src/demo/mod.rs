//! The whole method on a procedural room, compared with the truth about it.
//!
//! [`room`] builds and photographs a furnished room; [`disturb`] makes errors like those of imperfect
//! networks. Everything in between is the method itself, as the other verbs run it.

pub mod disturb;
mod free_place;
mod page;
mod report;
pub mod room;
mod run;
mod stage_set;

pub use report::{DemoReport, DepthFigures, EditedViewFigures, InstanceFigures, ViewFigures};
pub use run::{DemoParams, run};
