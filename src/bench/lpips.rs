//! LPIPS.

use super::{BenchParams, Load, Size, Source, Trial, failed, made_up};
use crate::Result;
use tid3r_models::lpips::{Config, Lpips, Memory, Work};

/// The distance of two pictures.
pub(super) fn distance(
    params: &BenchParams,
    config: &Config,
    source: &Source<'_>,
) -> Result<Vec<Trial>> {
    const SIZE: Size = Size {
        width: 640,
        height: 480,
    };
    let size = params.size.unwrap_or(SIZE);
    let (width, height) = size.in_steps_of(1)?;
    let network = Lpips::new(config, &source.weights()?).map_err(failed)?;
    let work = Work::new(config, (height, width)).total();
    let memory = Memory::new(config, (height, width), source.footprint()?).total();
    let pictures = [
        made_up(&[1, height, width, 3])?,
        made_up(&[1, height, width, 3])?,
    ];
    Ok(vec![Trial {
        load: Load::of_size(size),
        defined: work,
        computed: work,
        memory,
        run: Box::new(move || network.forward(&pictures[0], &pictures[1]).map(drop)),
    }])
}
