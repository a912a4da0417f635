//! LPIPS.

use crate::{
    case::{Case, device},
    comparison::Comparison,
    see3d::channels_last,
};
use anyhow::Result;
use candle_core::{Device, Tensor};
use tid3r_models::{
    Observer, Weights,
    lpips::{Config, Lpips},
};
use tid3r_weights_convert as weights;

/// Distances of pictures, what each layer contributes, and the features that the case has.
pub(crate) fn distances(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let config: Config = case.config()?;
    let network = weights::Config::Lpips(config.clone()).network();
    let seed = case.seed()?;
    let make = move |name: &str, shape: &[usize]| network.synthetic(name, shape, seed);
    let network = Lpips::new(&config, &Weights::from_fn(make, device()?))?;
    let picture = |name| channels_last(case.input(name)?);
    let (first, second) = (picture("first")?, picture("second")?);
    let found = network.forward_observed(&first, &second, &mut Features(comparison))?;
    let values = found.iter().map(|distance| distance.value);
    comparison.check("value", &Tensor::from_iter(values, &Device::Cpu)?);
    let layers: Vec<_> = found
        .iter()
        .map(|distance| distance.layers.to_vec())
        .collect();
    comparison.check("layers", &Tensor::new(layers, &Device::Cpu)?);
    Ok(())
}

struct Features<'a, 'b>(&'a mut Comparison<'b>);

impl Observer for Features<'_, '_> {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        self.0.check_if_expected(name, &tensor()?);
        Ok(())
    }
}
