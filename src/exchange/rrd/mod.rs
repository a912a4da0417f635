//! Recordings of Rerun (`.rrd`), which its viewer opens.
//!
//! A file is a stream: a header; a message that names the recording; a message for each entity, with its
//! components as an Arrow table of one row; a footer that says where they are. All is *static*, which in Rerun
//! means of no time. Rerun's own crates, which bring hundreds more, have no part in this; the layout is that
//! of version 0.28, which later versions read.

mod arrays;
mod columns;
mod ids;
mod manifest;
mod protobuf;
mod stream;
#[cfg(test)]
mod tests;

use crate::{
    Map, Result,
    geometry::{Intrinsics, Pose},
    scene::files,
};
use std::path::Path;

/// What a file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Rrd {
    /// What tells the recording from others: a viewer takes two of one id for one.
    pub id: String,
    /// What the recording is called.
    pub name: String,
    /// Whatever is shown.
    pub entities: Vec<Entity>,
}

/// A node of the tree that Rerun shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Entity {
    /// The names on the way to it from the root, any texts. Each path is there once.
    pub path: Vec<String>,
    /// What is there.
    pub contents: Vec<Archetype>,
}

/// What can be at an entity.
#[derive(Clone, Debug, PartialEq)]
pub enum Archetype {
    /// The axes of the entity and all below it are right-handed, with z up.
    ZUp,
    /// What classes mean, for all below.
    Classes(Vec<Class>),
    /// From the entity's frame to its parent's.
    Transform(Pose),
    /// Points of one class.
    Points {
        /// Where they are.
        positions: Vec<[f32; 3]>,
        /// Their colours, sRGB.
        colours: Vec<[u8; 3]>,
        /// Their size, in units of the world.
        radii: Vec<f32>,
        /// Their class.
        class: u16,
    },
    /// A lens, whose camera has OpenCV's axes.
    Pinhole(Intrinsics),
    /// A picture as a file.
    Picture {
        /// The bytes of the file.
        file: Vec<u8>,
        /// What they are: `image/png`, `image/jpeg`.
        media_type: &'static str,
    },
    /// Depth along z in units of the world, 0 where it is unknown.
    Depth(Map<f32>),
}

/// What a class is.
#[derive(Clone, Debug, PartialEq)]
pub struct Class {
    /// The number that points have.
    pub id: u16,
    /// What it is called.
    pub label: String,
    /// Its colour, sRGB.
    pub colour: [u8; 3],
}

/// Writes a file. The same contents give the same bytes.
///
/// # Errors
/// When writing fails.
pub fn write_rrd(path: &Path, rrd: &Rrd) -> Result<()> {
    files::write_atomically(path, |out| stream::write(out, rrd))
}

/// The application that recordings say they are of.
const APPLICATION: &str = "tid3r";
