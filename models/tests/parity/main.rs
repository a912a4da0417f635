//! Networks and their layers against the original code. How a comparison works is told in
//! [`harness`]; each network has its files beside it.

// Helpers are outside of what Clippy takes for tests; the reports are read with `--nocapture`.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

mod harness;
mod mvdust3r_encoder;
mod mvdust3r_layers;
