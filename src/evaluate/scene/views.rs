//! Rendered views of a scene against true pictures.

use super::{TestAlignment, TestRefinement};
use crate::{
    Result,
    evaluate::{image::ImageReport, lpips::Perceptual},
    progress::Progress,
};
use image::RgbImage;
use serde::Serialize;

/// Rendered views against photos.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViewsReport {
    /// Mean over the views, completed.
    pub completed: ImageReport,
    /// Mean over the views, as projected, with black holes: the paper's "cloud" rows.
    pub projected: ImageReport,
    /// Each view, completed.
    pub views: Vec<(String, ImageReport)>,
    /// How the test cameras were brought into the scene's frame, where they are the truth's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alignment: Option<TestAlignment>,
    /// What refining them gained, where they were refined.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinement: Option<TestRefinement>,
}

/// A rendered view and what it should look like.
#[derive(Clone, Copy, Debug)]
pub struct ComparedView<'a> {
    /// The view's name.
    pub name: &'a str,
    /// The completed picture.
    pub completed: &'a RgbImage,
    /// Black where no point landed.
    pub projected: &'a RgbImage,
    /// The true picture.
    pub truth: &'a RgbImage,
}

impl ViewsReport {
    /// Compares views with true pictures; `None` without any.
    ///
    /// # Errors
    /// When a picture has not its view's size, or is too small for a metric.
    pub fn new(
        views: &[ComparedView<'_>],
        perceptual: &Perceptual,
        progress: &dyn Progress,
    ) -> Result<Option<Self>> {
        progress.begin("comparing views", views.len());
        let (mut completed, mut projected) = (Vec::new(), Vec::new());
        for view in views {
            completed.push(ImageReport::of(view.completed, view.truth, perceptual)?);
            projected.push(ImageReport::of(view.projected, view.truth, perceptual)?);
            progress.advance(1);
        }
        progress.end();
        let means = ImageReport::mean(&completed).zip(ImageReport::mean(&projected));
        let names = views.iter().map(|view| view.name.to_string());
        Ok(means.map(|(mean_completed, mean_projected)| Self {
            completed: mean_completed,
            projected: mean_projected,
            views: names.zip(completed).collect(),
            alignment: None,
            refinement: None,
        }))
    }
}
