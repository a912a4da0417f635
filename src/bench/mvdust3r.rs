//! MV-DUSt3R and MV-DUSt3R+.

use super::{BenchParams, Load, Size, Source, Trial, failed, made_up};
use crate::{Error, Result};
use std::rc::Rc;
use tid3r_models::mvdust3r::{Config, Memory, MvDust3r, Options, Paths, Unobserved, Work};

/// A trial for each number of photos.
pub(super) fn trials(
    params: &BenchParams,
    config: &Config,
    source: &Source<'_>,
) -> Result<Vec<Trial>> {
    const VIEWS: [u32; 3] = [2, 4, 8];
    const SIDE: usize = 224;
    let config = Config {
        gs: config.gs && (params.gaussians || source.found.is_some()),
        ..config.clone()
    };
    let size = params.size.unwrap_or(Size::square(SIDE));
    let (width, height) = size.in_steps_of(config.patch_size as u32)?;
    let network = MvDust3r::new(&config, &source.weights()?).map_err(failed)?;
    let network = Rc::new(network);
    let options = Options {
        paths: match params.all_paths {
            true => Paths::All,
            false => Paths::First,
        },
        gaussians: params.gaussians,
        ..Options::default()
    };
    let footprint = source.footprint()?;
    let least = config.references().max(2);
    let is_enough = |views: &u32| *views as usize >= least;
    let views: Vec<u32> = match params.views.is_empty() {
        true => VIEWS.into_iter().filter(is_enough).collect(),
        false => params.views.clone(),
    };
    if !views.iter().all(is_enough) {
        return Err(Error::request(
            format!("the network sees at least {least} photos at once"),
            format!("give numbers of --views from {least} on"),
        ));
    }
    let trial = |&views: &u32| {
        let shape = [views as usize, 1, 3, height, width];
        let images = made_up(&shape)?;
        let work = Work::new(
            &config,
            views as usize,
            (height, width),
            options.paths,
            options.gaussians,
        );
        let network = Rc::clone(&network);
        let memory = Memory::new(
            &config,
            views as usize,
            (height, width),
            &options,
            footprint,
        );
        Ok(Trial {
            memory: memory.map_err(failed)?.total(),
            load: Load {
                views: Some(views),
                ..Load::of_size(size)
            },
            defined: work.total(),
            computed: work.computed(),
            run: Box::new(move || {
                network
                    .forward(&images, &options, &mut Unobserved)
                    .map(drop)
            }),
        })
    };
    views.iter().map(trial).collect()
}
