//! The program `tid3r`, driven as a user drives it: arguments in; exit code, output and files out.

#![expect(
    clippy::unwrap_used,
    reason = "a test that cannot go on says where it stopped"
)]

mod bench;
mod broken;
mod damaged_scene;
mod demo;
mod doctor;
mod documented;
mod dtype;
mod edit;
mod evaluate;
mod export;
mod export_formats;
mod import;
mod instances;
mod killed;
mod lists;
mod place;
mod reconstruct;
mod recording;
mod render;
mod run;
mod see3d;
mod segment;
mod stages;
mod usage;
mod video;
mod view;
mod weights;
mod zipped;

use place::Place;
