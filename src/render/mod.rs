//! From the (edited) cloud to pictures: projection, reference masks, completion.

mod contact_sheet;
pub mod fill;
mod path;
mod projection;
mod record;
mod references;
mod stage;
mod top_down;

pub use contact_sheet::contact_sheet;
pub use path::{PathFile, between, orbit};
pub use projection::{Projection, SplatParams, project};
pub use record::{RenderRecord, render_recipe};
pub use references::{Reference, ReferenceParams, reference_masks};
pub use stage::{EditedScene, Rendering, View, ViewFiles};
pub use top_down::top_down;

use crate::Result;
use image::RgbImage;

/// Turns a sparse projection into a whole picture: the paper's I~_k = M(I^_k, M_k, {I_i}).
pub trait Completer: Sync {
    /// The completed picture, of the projection's size. Pixels of `references` that their masks
    /// exclude must not have any influence.
    ///
    /// # Errors
    /// When the picture cannot be made.
    fn complete(&self, projection: &Projection, references: &[Reference]) -> Result<RgbImage>;
}

/// Completes nothing: the bare projection, black where no point landed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bare;

impl Completer for Bare {
    fn complete(&self, projection: &Projection, _references: &[Reference]) -> Result<RgbImage> {
        Ok(projection.colour.clone())
    }
}
