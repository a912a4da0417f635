//! SAM's own encoder.

use super::picture::network_input;
use crate::{case::Case, comparison::Comparison};
use anyhow::Result;
use candle_core::Tensor;
use tid3r_models::{
    Observer,
    mobilesamv2::vit::{Config, Vit},
};

/// Compares what a case expects of a network's stages.
struct Stages<'a, 'b> {
    comparison: &'a mut Comparison<'b>,
}

impl Observer for Stages<'_, '_> {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        let checked = self.comparison.check_sampled(name, &tensor()?);
        checked.map_err(candle_core::Error::wrap)
    }
}

/// The whole encoder.
pub(crate) fn network(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let network = Vit::new(&case.config::<Config>()?, &case.weights()?)?;
    let input = network_input(case)?;
    let mut stages = Stages { comparison };
    let output = network.forward_observed(&input, &mut stages)?;
    comparison.check_sampled("output", &output.permute((0, 3, 1, 2))?)
}
