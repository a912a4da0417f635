//! Making a scene of what was dropped on the page.

use super::{
    super::{
        session::{Options, Session},
        start::Start,
    },
    Work,
};
use crate::{
    Error, Result,
    edit::{self, EditList},
    machine::check_type,
    photos::{PhotoSources, VideoParams},
    progress::{Part, Progress},
    reconstruct::{
        self, CleanParams, FromPhotos, MvDust3rParams, MvDust3rReconstructor, NewScene,
        PlacedPhoto, Placement,
    },
    scene::{Scene, Stage, WriteLock},
    segment::{
        DescribedSegmenter, GraphParams, MaskParams, Segmentation, UnifyParams,
        mobilesamv2::{MobileSamParams, MobileSamWeights},
    },
};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, OnceLock};
use tid3r_models::ComputeType;

/// The job's id: those of renderings are higher.
pub(in crate::viewer) const MAKING: u32 = 0;

/// How the scene is to be made.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::viewer) struct MakeRequest {
    segmenter: SegmenterName,
    /// What networks compute with.
    #[serde(default)]
    dtype: ComputeType,
}

/// What makes masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
enum SegmenterName {
    Mobilesamv2,
    Graph,
}

/// What the page can offer: networks, and why they cannot be used.
#[derive(Debug, Serialize)]
pub(in crate::viewer) struct Means {
    reconstructor: Mean,
    segmenters: [Mean; 2],
    /// What networks can compute with.
    dtypes: Vec<ComputeType>,
}

#[derive(Debug, Serialize)]
struct Mean {
    id: &'static str,
    title: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
}

impl Means {
    /// Those that are here now.
    pub(in crate::viewer) fn of(options: &Options) -> Self {
        let places = options.places();
        let words = |error: Error| error.to_string();
        let reconstructor = MvDust3rReconstructor::find_weights(&places).map_err(words);
        let masks = MobileSamWeights::find(&places, None).map_err(words);
        Self {
            reconstructor: Mean {
                id: "mvdust3r",
                title: match &reconstructor {
                    Ok(found) => found.network.title.into(),
                    Err(_) => "MV-DUSt3R".into(),
                },
                problem: reconstructor.err(),
            },
            segmenters: [
                Mean {
                    id: "mobilesamv2",
                    title: "MobileSAMv2, a network".into(),
                    problem: masks.err(),
                },
                Mean {
                    id: "graph",
                    title: "By colour and depth".into(),
                    problem: None,
                },
            ],
            dtypes: (ComputeType::ALL.into_iter())
                .filter(|dtype| check_type(*dtype).is_ok())
                .collect(),
        }
    }
}

/// Reconstructing, cleaning, segmenting.
const PARTS: usize = 3;

impl MakeRequest {
    /// The work that makes the scene of all that has arrived, and opens it as `session`. What an earlier attempt has
    /// finished is not done again.
    ///
    /// # Errors
    /// When there are no photos, or weights are missing or damaged.
    pub(in crate::viewer) fn work(
        self,
        start: &Arc<Start>,
        session: &Arc<OnceLock<Arc<Session>>>,
        options: &Options,
    ) -> Result<Work> {
        let paths = start.uploads.paths()?;
        let places = options.places();
        let params = MvDust3rParams {
            dtype: self.dtype,
            ..MvDust3rParams::default()
        };
        let weights = MvDust3rReconstructor::find_weights(&places)?;
        let reconstructor = MvDust3rReconstructor::new(weights, params, None)?;
        let masks = match self.segmenter {
            SegmenterName::Graph => None,
            SegmenterName::Mobilesamv2 => Some(MobileSamWeights::find(&places, None)?),
        };
        let lock = start.write_lock()?;
        let (start, session) = (Arc::clone(start), Arc::clone(session));
        Ok(Box::new(move |progress| {
            let part = |number| match progress.is_cancelled() {
                true => Err(Error::Cancelled),
                false => Ok(Part {
                    number,
                    of: PARTS,
                    progress,
                }),
            };
            let make = || {
                let sources = PhotoSources::find(&paths)?;
                let mut scene = reconstructed(&sources, &reconstructor, &start, &lock, &part(1)?)?;
                reconstruct::clean(&mut scene, &CleanParams::default(), false, &lock, &part(2)?)?;
                self.segment(&mut scene, masks, &lock, &part(3)?)?;
                Session::open(&start.folder)
            };
            let made = make().map_err(|error| start.uploads.in_words(error))?;
            drop(lock);
            start.end();
            // There is one job that does so.
            let _ = session.set(Arc::new(made));
            Ok(())
        }))
    }

    fn segment(
        &self,
        scene: &mut Scene,
        masks: Option<MobileSamWeights>,
        lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<()> {
        let DescribedSegmenter {
            segmenter,
            description,
        } = match masks {
            Some(weights) => {
                let params = MobileSamParams {
                    dtype: self.dtype,
                    ..MobileSamParams::default()
                };
                DescribedSegmenter::mobilesamv2(&weights, params, scene)?
            }
            None => DescribedSegmenter::graph(GraphParams::default()),
        };
        let segmentation = Segmentation {
            segmenter: &*segmenter,
            description,
            masks: MaskParams::default(),
            unify: Some(UnifyParams::default()),
        };
        segmentation.run(scene, false, lock, progress)?;
        let list = EditList::load(scene).or_else(|_| EditList::cleared(scene))?;
        edit::write_overviews(scene, list.edits(), lock)
    }
}

/// The scene of these photos, instead of one that an earlier attempt made of others.
fn reconstructed(
    sources: &PhotoSources,
    reconstructor: &MvDust3rReconstructor,
    start: &Start,
    lock: &WriteLock,
    progress: &dyn Progress,
) -> Result<Scene> {
    for warning in &sources.warnings {
        progress.note(warning);
    }
    let photos = FromPhotos {
        sources,
        videos: &VideoParams::default(),
        reconstructor,
    };
    let is_other = NewScene::in_place(&start.folder, &photos.parameters(), false).is_err();
    let scene = photos.make(&start.folder, is_other, lock, progress)?;
    for words in left_out(&scene)? {
        progress.note(&words);
    }
    Ok(scene)
}

/// Which photos have no place in a scene.
fn left_out(scene: &Scene) -> Result<Vec<String>> {
    let report = &scene.require(Stage::Reconstruct)?.report["photos"];
    let photos: Vec<PlacedPhoto> = Deserialize::deserialize(report).unwrap_or_default();
    let words = |photo: PlacedPhoto| match photo.outcome {
        Placement::LeftOut { reason } => Some(format!("{} is left out: {reason}", photo.name)),
        Placement::Placed { .. } => None,
    };
    Ok(photos.into_iter().filter_map(words).collect())
}
