//! What an observer hears of layers.

use candle_core::{Result, Tensor};

use super::Work;
use crate::Observer;

/// Shows layers to an observer as they are done.
pub(super) struct Watch<'a> {
    pub(super) observer: &'a mut dyn Observer,
    pub(super) work: Work,
}

impl Watch<'_> {
    /// Layer `layer` of the network is done, with the result `y` (batch, height, width, channels).
    pub(super) fn done(&mut self, layer: usize, y: &Tensor) -> Result<()> {
        let name = format!("layer{layer}");
        self.observer.stage(&name, &|| y.permute((0, 3, 1, 2)))?;
        self.observer.advance(self.work.layers[layer].computed());
        Ok(())
    }

    /// The head is done.
    pub(super) fn head_done(&mut self) {
        self.observer
            .advance(self.work.layers[Work::HEAD].computed());
    }
}
