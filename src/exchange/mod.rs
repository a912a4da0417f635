//! What other programs write and read: recordings in, point clouds out.

pub mod ply;
pub mod recording;
