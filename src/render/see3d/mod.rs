//! Completion by See3D.
mod choice;
mod clip_picture;
mod grouping;
mod noise;
mod params;
mod picture;

use super::*;
use crate::Result;
pub use clip_picture::{ClipFrame, Resized, quantised};
pub use grouping::{Group, main_groups, super_resolution_groups};
pub use params::{Quality, See3dParams};
pub use picture::*;
use serde_json::Value;
pub struct See3d;
pub struct See3dWeights;
impl See3dWeights {
    pub fn synthetic_tiny(_: &See3dParams) -> Result<Self> {
        Ok(Self)
    }
    pub fn find(_: &tid3r_weights_convert::Places, _: &See3dParams) -> Result<Self> {
        Ok(Self)
    }
}
impl See3d {
    pub fn new(_: See3dWeights, _: See3dParams) -> Self {
        Self
    }
}
impl Completer for See3d {
    fn title(&self) -> String {
        "See3D".into()
    }
    fn description(&self) -> Value {
        Value::Null
    }
    fn begin<'a>(
        &'a self,
        views: &'a Views<'a>,
        p: Option<&Value>,
    ) -> Result<Box<dyn Completion + 'a>> {
        Bare.begin(views, p)
    }
}
