//! What completes projections, and in which steps.

use super::{Projection, Reference, SplatParams, project};
use crate::{
    Result,
    geometry::Camera,
    machine::{counted, readable_seconds},
    progress::Progress,
    scene::Cloud,
};
use image::RgbImage;
use serde_json::{Value, json};
use std::time::Instant;

/// Turns sparse projections into whole pictures: the paper's I~_k = M(I^_k, M_k, {I_i}).
///
/// Pixels of references that their masks exclude must not have any influence.
pub trait Completer: Sync {
    /// What it is called, for people.
    fn title(&self) -> String;

    /// All that pictures depend on besides the views themselves.
    fn description(&self) -> Value;

    /// Divides views into steps, and makes ready to take them. Costs next to nothing: there may be nothing
    /// left to do.
    ///
    /// `plan` is what [`Completion::plan`] said when the same views were begun before; it must be kept to.
    ///
    /// # Errors
    /// When the views cannot be completed.
    fn begin<'a>(
        &'a self,
        views: &'a Views<'a>,
        plan: Option<&Value>,
    ) -> Result<Box<dyn Completion + 'a>>;
}

/// A rendered picture with what it was made from.
#[derive(Clone, Debug)]
pub struct View {
    /// The completed picture.
    pub picture: RgbImage,
    /// The projection that was completed.
    pub projection: Projection,
}

/// Views that are to be completed.
pub struct Views<'a> {
    /// The edited cloud.
    pub cloud: &'a Cloud,
    /// How points become pixels.
    pub splats: &'a SplatParams,
    /// The photos, masked.
    pub references: &'a [Reference],
    /// Their names.
    pub photos: Vec<&'a str>,
    /// Each view's name and camera.
    pub cameras: &'a [(String, Camera)],
}

impl Views<'_> {
    /// A view before it is completed.
    pub fn projection(&self, view: usize) -> Projection {
        project(self.cloud, &self.cameras[view].1, self.splats)
    }
}

/// Views on their way to being completed.
pub trait Completion {
    /// The steps in their order. Results of each are on disk before the next begins.
    fn steps(&self) -> &[Step];

    /// What was decided by what the machine can do, to be decided in the same way when a rendering is
    /// taken up again; `Null` if nothing was.
    fn plan(&self) -> Value {
        Value::Null
    }

    /// What taking all steps needs, in words; `None` if that cannot be told.
    ///
    /// # Errors
    /// When the machine cannot take them.
    fn estimate(&self) -> Result<Option<String>> {
        Ok(None)
    }

    /// Told which steps will be taken before the first of them is.
    ///
    /// # Errors
    /// When the machine cannot take them.
    fn prepare(&mut self, steps: &[usize], progress: &dyn Progress) -> Result<()> {
        let _ = (steps, progress);
        Ok(())
    }

    /// Takes a step: one result for each of its views. `kept` has what earlier steps keep; an error that `follower`
    /// gives ends the step.
    ///
    /// # Errors
    /// When a picture cannot be made; those of `follower`.
    fn take(
        &mut self,
        step: usize,
        kept: &dyn Kept,
        follower: &mut dyn Follower,
    ) -> Result<Vec<Completed>>;
}

/// Who follows a step.
pub trait Follower {
    /// This share of the step is done.
    ///
    /// # Errors
    /// When the step is to end.
    fn reached(&mut self, share: f64) -> Result<()>;

    /// How a view looks by now; see [`Progress::preview`].
    fn preview(&mut self, name: &str, draw: &dyn Fn() -> Option<RgbImage>);
}

/// Some views that are completed together.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// The views, by number.
    pub views: Vec<usize>,
    /// Whether this gives the views their pictures; else only what later steps need.
    pub finishes: bool,
    /// What of the result later steps need.
    pub keeps: Option<Keeps>,
    /// Earlier steps whose results it needs.
    pub after: Vec<usize>,
    /// What its result depends on besides what its views show.
    pub description: Value,
    /// How much there is to do, in units of progress.
    pub work: usize,
}

/// What later steps need of a step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Keeps {
    /// What it is called.
    pub name: &'static str,
    /// Of which views it is needed.
    pub views: Vec<usize>,
}

/// The result of a step for one view.
#[derive(Clone, Debug)]
pub struct Completed {
    /// The view, if the step finishes it; its picture has the projection's size.
    pub view: Option<View>,
    /// What later steps need.
    pub kept: Option<RgbImage>,
    /// How this picture came about, for its file.
    pub details: Value,
}

/// What steps have left for later ones.
pub trait Kept {
    /// What was kept of a view under a name.
    ///
    /// # Errors
    /// When it cannot be read.
    fn picture(&self, view: usize, name: &str) -> Result<RgbImage>;
}

/// Completes each view by itself, with a function.
pub(super) struct OneByOne<'a, F> {
    views: &'a Views<'a>,
    steps: Vec<Step>,
    complete: F,
}

impl<'a, F: Fn(&Projection, &[Reference]) -> RgbImage> OneByOne<'a, F> {
    pub(super) fn new(views: &'a Views<'a>, complete: F) -> Self {
        let step = |view| Step {
            views: vec![view],
            finishes: true,
            keeps: None,
            after: Vec::new(),
            description: Value::Null,
            work: 1,
        };
        Self {
            views,
            steps: (0..views.cameras.len()).map(step).collect(),
            complete,
        }
    }
}

impl<F: Fn(&Projection, &[Reference]) -> RgbImage> Completion for OneByOne<'_, F> {
    fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// By trying: the first view is projected, and completed in small. The work goes with the pixels.
    fn estimate(&self) -> Result<Option<String>> {
        const SMALL: f64 = 96.0;
        let Views {
            cloud,
            splats,
            references,
            cameras,
            ..
        } = self.views;
        let Some((_, camera)) = cameras.first() else {
            return Ok(None);
        };
        let start = Instant::now();
        project(cloud, camera, splats);
        let to_project = start.elapsed().as_secs_f64();
        let [width, height] = [camera.intrinsics.width, camera.intrinsics.height];
        let scale = (SMALL / f64::from(width.max(height))).min(1.0);
        let [w, h] = [width, height].map(|side| ((f64::from(side) * scale) as u32).max(1));
        let small = Camera {
            intrinsics: camera.intrinsics.resized(w, h),
            ..*camera
        };
        let projection = project(cloud, &small, splats);
        let start = Instant::now();
        (self.complete)(&projection, references);
        let pixels = f64::from(width) * f64::from(height) / (f64::from(w) * f64::from(h));
        let to_complete = start.elapsed().as_secs_f64() * pixels;
        let seconds = cameras.len() as f64 * (to_project + to_complete);
        Ok(Some(format!(
            "{} at {width}x{height}: about {}",
            counted(cameras.len(), "view"),
            readable_seconds(seconds.max(1.0))
        )))
    }

    fn take(&mut self, step: usize, _: &dyn Kept, _: &mut dyn Follower) -> Result<Vec<Completed>> {
        let complete = |&view: &usize| {
            let projection = self.views.projection(view);
            let picture = (self.complete)(&projection, self.views.references);
            Completed {
                view: Some(View {
                    picture,
                    projection,
                }),
                kept: None,
                details: Value::Null,
            }
        };
        Ok(self.steps[step].views.iter().map(complete).collect())
    }
}

/// Completes nothing: the bare projection, black where no point landed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bare;

impl Completer for Bare {
    fn title(&self) -> String {
        "nothing".into()
    }

    fn description(&self) -> Value {
        json!("none")
    }

    fn begin<'a>(
        &'a self,
        views: &'a Views<'a>,
        _: Option<&Value>,
    ) -> Result<Box<dyn Completion + 'a>> {
        let complete = |projection: &Projection, _: &[Reference]| projection.colour.clone();
        Ok(Box::new(OneByOne::new(views, complete)))
    }
}
