//! Reconstruction by MV-DUSt3R or MV-DUSt3R+ (Tang et al. 2024).

mod estimate;
mod params;
mod sight;
#[cfg(test)]
mod tests;

pub use estimate::RunEstimate;
pub use params::{FocalSource, MvDust3rParams};

use crate::{
    Error, Map, Result,
    error::network_problem,
    geometry::Intrinsics,
    photos::Photo,
    progress::Progress,
    reconstruct::{
        FocalOrigin, PlacedPhoto, Placement, Pointmap, Reconstruction, Reconstructor,
        RecoveredCamera, RecoveredView, Recovery, RecoveryError, recover_cameras, view_order,
    },
    scene::{Frame, Gaussians},
    weights::{damaged, open},
};
use candle_core::Tensor;
use sight::Sight;
use tid3r_models::{
    ComputeType, Weights,
    mvdust3r::{Config, MvDust3r, Observer, Options, ViewOutput},
};
use tid3r_weights_convert::{self as convert, Found, Network, Places};

/// Reconstructs photos with MV-DUSt3R or MV-DUSt3R+.
///
/// Views are ordered, the network sees them all at once, and cameras are recovered from the points
/// that it gives each pixel. The scene's frame is that of the reference photo's camera, as far as the
/// network is right about it; units are the network's.
pub struct MvDust3rReconstructor {
    config: Config,
    weights: Weights,
    found: Found,
    params: MvDust3rParams,
    /// Bytes that a run may take; `None` for whatever there is.
    max_memory: Option<u64>,
}

impl MvDust3rReconstructor {
    /// The networks that reconstruct, by name, the better one first.
    pub const NETWORKS: [&str; 2] = ["mvdust3r-plus", "mvdust3r"];

    /// The weights of the better one that is in `places`.
    ///
    /// # Errors
    /// When there are none: the message says what to get from where.
    pub fn find_weights(places: &Places) -> Result<Found> {
        let found = |name: &&str| places.find(Network::named(name).ok()?, None).ok();
        match Self::NETWORKS.iter().find_map(found) {
            Some(found) => Ok(found),
            None => Ok(places.find(Network::named(Self::NETWORKS[0])?, None)?),
        }
    }

    /// With the weights that were found. They are mapped, not read.
    ///
    /// # Errors
    /// When the weights are not MV-DUSt3R's, or their file is damaged or lacks a tensor.
    pub fn new(found: Found, params: MvDust3rParams, max_memory: Option<u64>) -> Result<Self> {
        let convert::Config::MvDust3r(config) = found.file.config.clone() else {
            return Err(Error::file(
                &found.folder,
                "holds the weights of a network that does not reconstruct",
                "give those of mvdust3r or mvdust3r-plus",
            ));
        };
        let weights = open(&found, params.dtype)?;
        let this = Self {
            config,
            weights,
            found,
            params,
            max_memory,
        };
        // Whatever is wrong with the weights is told before any photo is looked at, and before they are rounded.
        this.network(this.config.references(), ComputeType::F32)?;
        let unused = this.weights.unused();
        if let Some(name) = unused.first() {
            let problem = format!(
                "holds {} tensors that the network does not have, {name} the first",
                unused.len()
            );
            return Err(damaged(&this.found, &problem));
        }
        Ok(this)
    }

    /// What a scene is made from, for `scene.json`.
    pub fn description(&self) -> serde_json::Value {
        serde_json::json!({
            "network": self.found.network.name,
            "weights_sha256": self.found.file.weights_sha256,
            "weights_source": self.found.file.provenance.source,
            "parameters": self.params,
        })
    }

    /// What so many pictures of `size` (height, width) take on this machine.
    ///
    /// # Errors
    /// As [`RunEstimate::new`].
    pub fn estimate(&self, views: usize, size: (usize, usize)) -> Result<RunEstimate> {
        let config = self.config_for(self.references(views));
        let dtype = self.params.dtype;
        let weights = self.weights.footprint();
        let gaussians = !self.params.no_gaussians;
        RunEstimate::new(&config, views, size, gaussians, weights, dtype)
    }

    fn config_for(&self, references: usize) -> Config {
        Config {
            n_ref: Some(references),
            ..self.config.clone()
        }
    }

    /// The network with so many reference views, which its weights know nothing of, computing with this type.
    fn network(&self, references: usize, compute_type: ComputeType) -> Result<MvDust3r> {
        let config = self.config_for(references);
        MvDust3r::new(&config, &self.weights.clone().in_type(compute_type))
            .map_err(|error| damaged(&self.found, &network_problem(&error)))
    }

    /// Reference views for so many views.
    fn references(&self, views: usize) -> usize {
        if !self.config.m_ref_flag {
            return 1;
        }
        let wanted = self.params.references.map(|n| n as usize);
        let wanted = wanted.unwrap_or(self.config.references());
        wanted.clamp(2, views.max(2))
    }

    /// What the network says of views that see `sights`, all of one size.
    fn look(&self, sights: &[&Sight], progress: &dyn Progress) -> Result<Vec<ViewOutput>> {
        let views = sights.len();
        let size = sights[0].size();
        let estimate = self.estimate(views, size)?;
        let rows = estimate.rows_within(self.max_memory)?;
        progress.note(&estimate.to_string());
        let network = self.network(self.references(views), self.params.dtype)?;
        let options = Options {
            gaussians: !self.params.no_gaussians && self.config.gs,
            rows,
            ..Options::default()
        };
        let failed = |error: candle_core::Error| {
            Error::request(
                format!(
                    "the network cannot run on these photos: {}",
                    network_problem(&error)
                ),
                "report this as a defect",
            )
        };
        let images = Sight::tensor(sights).map_err(failed)?;
        let mut watch = Watch::begin(estimate.work(), progress);
        let outputs = network.forward(&images, &options, &mut watch);
        progress.end();
        if progress.is_cancelled() {
            return Err(Error::Cancelled);
        }
        let mut paths = outputs.map_err(failed)?;
        Ok(paths.swap_remove(0))
    }

    /// What is known of the lens of each photo, for its frame.
    fn known_lenses(&self, sights: &[Sight]) -> Result<Vec<Option<Intrinsics>>> {
        let mut unknown = Vec::new();
        let mut known = Vec::new();
        for sight in sights {
            let lens = sight.known_lens(&self.params)?;
            if lens.is_none() {
                unknown.push(sight.photo.name.as_str());
            }
            known.push(lens);
        }
        if self.params.focal == Some(FocalSource::Exif) && !unknown.is_empty() {
            tracing::warn!(
                "{} photos say nothing of their lens ({} the first), so the network tells their focal \
                 length",
                unknown.len(),
                unknown[0]
            );
        }
        Ok(known)
    }

    /// Cameras from pointmaps; with a usual focal length where the network's points fit none.
    fn recover(
        &self,
        pointmaps: &[Pointmap],
        known: &[Option<Intrinsics>],
        progress: &dyn Progress,
    ) -> Result<(Recovery, FocalOrigin)> {
        let MvDust3rParams { recovery, seed, .. } = &self.params;
        let recovered = recover_cameras(pointmaps, known, recovery, *seed, progress)?;
        let lacks_focal = |view: &RecoveredView| match &view.outcome {
            Err(RecoveryError::Focal(reason)) => Some(reason.to_string()),
            _ => None,
        };
        let Some(reason) = recovered.views.iter().find_map(lacks_focal) else {
            return Ok((recovered, FocalOrigin::Recovered));
        };
        tracing::warn!(
            "there is no focal length to be had from the reference photo ({reason}), so that of a usual \
             lens is assumed; give it with --focal if you know it"
        );
        let assumed: Vec<_> = pointmaps
            .iter()
            .zip(known)
            .map(|(pointmap, lens)| lens.or_else(|| Some(usual_lens(&pointmap.points))))
            .collect();
        let recovered = recover_cameras(pointmaps, &assumed, recovery, *seed, progress)?;
        Ok((recovered, FocalOrigin::Assumed))
    }
}

/// The main camera of a telephone, about 53 degrees wide.
fn usual_lens(points: &Map<[f32; 3]>) -> Intrinsics {
    let (width, height) = (points.width(), points.height());
    let focal = f64::from(width.max(height));
    Intrinsics {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
    }
}

impl Reconstructor for MvDust3rReconstructor {
    fn reconstruct(&self, photos: &[Photo], progress: &dyn Progress) -> Result<Reconstruction> {
        let sights = Sight::of_photos(photos, self.params.size, progress)?;
        let Some(first) = sights.first() else {
            return Err(Error::request("there are no photos", "give at least one"));
        };
        let known = self.known_lenses(&sights)?;
        let pictures: Vec<_> = sights.iter().map(|sight| sight.picture.clone()).collect();
        let mut order = view_order(self.params.order, &pictures, self.references(photos.len()));
        drop(pictures);
        let views = order.len();
        if views == 1 {
            tracing::warn!(
                "{} is the only photo, and is shown to the network twice: depth from one photo is a \
                 guess",
                first.photo.name
            );
            order.push(order[0]);
        }
        let ordered: Vec<&Sight> = order.iter().map(|&photo| &sights[photo]).collect();
        let mut outputs = self.look(&ordered, progress)?;
        outputs.truncate(views);
        let pointmaps = outputs.iter().map(pointmap).collect::<Result<Vec<_>>>()?;
        let known: Vec<_> = order[..views].iter().map(|&photo| known[photo]).collect();
        let (recovered, origin) = self.recover(&pointmaps, &known, progress)?;
        let origin = |view: usize| match known[view] {
            Some(_) => FocalOrigin::Known,
            None => origin,
        };
        let outcomes = recovered.views.into_iter().map(|view| view.outcome);
        let cameras = choose(outcomes.map(|outcome| outcome.map_err(|e| e.to_string())))?;
        let mut views: Vec<_> = cameras
            .into_iter()
            .zip(pointmaps)
            .zip(outputs)
            .enumerate()
            .collect();
        views.sort_by_key(|(view, _)| order[*view]);
        let mut reconstruction = Reconstruction::default();
        for (view, ((camera, pointmap), output)) in views {
            let sight = &sights[order[view]];
            let outcome = match &camera {
                Ok(camera) => sight.placement(camera, origin(view)),
                Err(reason) => Placement::LeftOut {
                    reason: reason.clone(),
                },
            };
            reconstruction.photos.push(PlacedPhoto {
                name: sight.photo.name.clone(),
                view,
                outcome,
            });
            let Ok(camera) = camera else { continue };
            reconstruction.frames.push(Frame {
                photo: sight.photo.clone(),
                transform: sight.frame.transform(),
                camera: camera.camera,
                colour: sight.picture.clone(),
                depth: camera.depth,
                confidence: pointmap.confidence,
            });
            if let Some(gaussians) = &output.gaussians {
                reconstruction.gaussians.push(gaussians_of(gaussians)?);
            }
        }
        warn(&reconstruction.photos);
        Ok(reconstruction)
    }
}

/// Which cameras the scene is made with.
///
/// Doubtful ones would spoil a scene of good ones, and are left out of it. Where most are doubtful there
/// is no telling which are right: all stay, and say so.
///
/// # Errors
/// When no view has a camera.
fn choose(
    cameras: impl Iterator<Item = Result<RecoveredCamera, String>>,
) -> Result<Vec<Result<RecoveredCamera, String>>> {
    let cameras: Vec<_> = cameras.collect();
    let good = cameras
        .iter()
        .flatten()
        .filter(|camera| !camera.is_doubtful())
        .count();
    if let Some(Err(reason)) = cameras.first()
        && cameras.iter().all(Result::is_err)
    {
        return Err(Error::request(
            format!("no photo can be given a camera: {reason}"),
            "give photos that overlap more, or the focal length with --focal",
        ));
    }
    let is_scene = 2 * good > cameras.len();
    let judge = |camera: Result<RecoveredCamera, String>| match camera {
        Ok(camera) if is_scene && camera.is_doubtful() => {
            let share = 100.0 * camera.fit.inlier_share;
            Err(format!(
                "only {share:.0} % of its points agree with any camera"
            ))
        }
        other => other,
    };
    Ok(cameras.into_iter().map(judge).collect())
}

fn warn(photos: &[PlacedPhoto]) {
    let mut doubtful = Vec::new();
    for photo in photos {
        match &photo.outcome {
            Placement::LeftOut { reason } => {
                tracing::warn!("{} is left out of the scene: {reason}", photo.name);
            }
            Placement::Placed { doubtful: true, .. } => doubtful.push(&*photo.name),
            Placement::Placed { .. } => {}
        }
    }
    if !doubtful.is_empty() {
        tracing::warn!(
            "the cameras of {} of {} photos are doubtful, hardly any of their points agree with them: {}",
            doubtful.len(),
            photos.len(),
            doubtful.join(", ")
        );
    }
}

/// Shows the network's progress, in thousandths of the work.
struct Watch<'a> {
    progress: &'a dyn Progress,
    total: f64,
    done: f64,
    shown: usize,
}

impl<'a> Watch<'a> {
    const STEPS: usize = 1000;

    fn begin(work: f64, progress: &'a dyn Progress) -> Self {
        progress.begin("looking at the photos", Self::STEPS);
        Self {
            progress,
            total: work,
            done: 0.0,
            shown: 0,
        }
    }
}

impl Observer for Watch<'_> {
    fn stage(
        &mut self,
        _: &str,
        _: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        match self.progress.is_cancelled() {
            true => Err(candle_core::Error::Msg("stopped".into())),
            false => Ok(()),
        }
    }

    fn advance(&mut self, multiply_adds: f64) {
        self.done += multiply_adds;
        let share = (self.done / self.total).clamp(0.0, 1.0);
        let reached = (share * Self::STEPS as f64) as usize;
        self.progress.advance(reached - self.shown);
        self.shown = reached;
    }
}

/// A map of the only item of a batch: `x` is (1, height, width).
fn map(x: &Tensor) -> Result<Map<f32>> {
    let values = || -> candle_core::Result<_> {
        let (_, height, width) = x.dims3()?;
        Ok((width, height, x.flatten_all()?.to_vec1::<f32>()?))
    };
    let (width, height, values) = values().map_err(|error| unexpected(&network_problem(&error)))?;
    Map::new(width as u32, height as u32, values).ok_or_else(|| unexpected(&"its size is wrong"))
}

/// The maps of all channels of the only item of a batch: `x` is (1, height, width, channels).
fn maps(x: &Tensor) -> Result<Vec<Map<f32>>> {
    let channels = x
        .dim(3)
        .map_err(|error| unexpected(&network_problem(&error)))?;
    let channel = |c| {
        map(&x
            .narrow(3, c, 1)
            .and_then(|x| x.squeeze(3))
            .map_err(|e| unexpected(&network_problem(&e)))?)
    };
    (0..channels).map(channel).collect()
}

fn unexpected(problem: &dyn std::fmt::Display) -> Error {
    Error::request(
        format!("the network's output cannot be used: {problem}"),
        "report this as a defect",
    )
}

fn pointmap(output: &ViewOutput) -> Result<Pointmap> {
    let coordinates = maps(&output.points)?;
    let [x, y, z] = &coordinates[..] else {
        return Err(unexpected(&"points have three coordinates"));
    };
    Ok(Pointmap {
        points: Map::from_fn(x.width(), x.height(), |u, v| {
            [x[(u, v)], y[(u, v)], z[(u, v)]]
        }),
        confidence: map(&output.confidence)?,
    })
}

fn gaussians_of(output: &tid3r_models::mvdust3r::Gaussians) -> Result<Gaussians> {
    let wrong = |_| unexpected(&"a Gaussian has one opacity, three extents and a quaternion");
    let [opacity] = maps(&output.opacity)?.try_into().map_err(wrong)?;
    Ok(Gaussians {
        opacity,
        scale: maps(&output.scale)?.try_into().map_err(wrong)?,
        rotation: maps(&output.rotation)?.try_into().map_err(wrong)?,
        colour: maps(&output.rgb)?,
    })
}
