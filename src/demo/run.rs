use super::{
    free_place::free_place,
    page,
    report::{DemoReport, DepthFigures, EditedViewFigures, InstanceFigures, ViewFigures},
    stage_set::StageSet,
};
use crate::{
    Error, Map, Result,
    edit::{self, ColourChange, Edit, EditList, Hex, Placement},
    evaluate::{
        depth::Alignment,
        image::psnr,
        lpips::Perceptual,
        scene::{ComparedView, DepthComparison, InstanceComparison, ViewsReport},
    },
    geometry::{Camera, Point},
    progress::Progress,
    reconstruct::{self, CleanParams, NewScene},
    render::{Completer, EditedScene, ReferenceParams, Rendering, SplatParams, View},
    scene::{Role, Scale, Scene, Stage, WriteLock},
    segment::{self, Instances, LabelImages, MaskParams, Segmentation, UnifyParams},
};
use serde::Serialize;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Instant,
};

/// What the demo shows.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize)]
pub struct DemoParams {
    /// Which room, and which errors
    #[arg(long, default_value_t = 42)]
    pub seed: u64,
    /// Width of the photos; less is faster
    #[arg(long, value_name = "PX", default_value_t = 640,
          value_parser = clap::value_parser!(u32).range(64..=4096))]
    pub width: u32,
}

/// Builds a room, photographs it, lets imperfect networks see the photos, runs the method, and
/// measures against the truth; writes everything, and a page that shows it, into `folder`. `completer`
/// completes the views.
///
/// # Errors
/// When the folder cannot be written to, or holds something else; those of the completer.
pub fn run(
    params: &DemoParams,
    completer: &dyn Completer,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<DemoReport> {
    let start = Instant::now();
    let lock = WriteLock::acquire(folder)?;
    let scene_folder = folder.join("scene");
    let scene_lock = WriteLock::acquire(&scene_folder)?;
    let set = StageSet::photograph(params.seed, params.width, progress)?;
    set.write(folder)?;
    set.write_masks(&folder.join("masks"))?;
    let mut scene = NewScene {
        reconstructor: &set,
        inputs: &StageSet::photos(&set.inputs, &folder.join("photos")),
        held_out: &StageSet::photos(&set.held_out, &folder.join("test_photos")),
        scale: Scale::Metric,
        parameters: serde_json::json!({ "demo": params }),
    }
    .create(&scene_folder, true, &scene_lock, progress)?;
    reconstruct::clean(
        &mut scene,
        &CleanParams::default(),
        false,
        &scene_lock,
        progress,
    )?;
    let images = LabelImages::open(&folder.join("masks"))?;
    let names = set.inputs.iter().map(|shot| &*shot.name);
    let content = images.content_hash(names)?;
    Segmentation {
        segmenter: &images,
        description: serde_json::json!({ "content": content }),
        masks: MaskParams::default(),
        unify: Some(UnifyParams::default()),
    }
    .run(&mut scene, false, &scene_lock, progress)?;
    EditList::cleared(&scene)?.save(&scene, &scene_lock)?;
    let show = Show {
        set: &set,
        scene: &scene,
        lock: &scene_lock,
        folder,
        completer,
    };
    let report = DemoReport {
        depth: show.depth()?,
        instances: show.instances()?,
        views: show.views(progress)?,
        edited_views: show.removal(progress)?,
        showcase: set.showcase.name.clone(),
        completed_by: completer.title(),
        seed: params.seed,
        seconds: 0.0,
    };
    show.edits(progress)?;
    EditList::cleared(&scene)?.save(&scene, &scene_lock)?;
    edit::write_overviews(&scene, &[], &scene_lock)?;
    page::write(folder, &set, &report)?;
    drop(lock);
    Ok(DemoReport {
        seconds: start.elapsed().as_secs_f64(),
        ..report
    })
}

/// The finished scene beside the truth.
struct Show<'a> {
    set: &'a StageSet,
    scene: &'a Scene,
    lock: &'a WriteLock,
    folder: &'a Path,
    completer: &'a dyn Completer,
}

impl Show<'_> {
    fn depth(&self) -> Result<DepthFigures> {
        let frames = self.scene.frames(Role::Input)?;
        let validity = self.scene.maps::<bool>(Stage::Clean)?;
        let truth: Vec<Map<f32>> = self
            .set
            .inputs
            .iter()
            .map(|shot| shot.view.depth.clone())
            .collect();
        let DepthComparison { before, after } =
            DepthComparison::new(&frames, &validity, &truth, Alignment::Scale)?;
        Ok(DepthFigures {
            rmse_before: before.all.rmse,
            rmse_after: after.all.rmse,
            abs_rel_before: before.all.abs_rel,
            abs_rel_after: after.all.abs_rel,
            delta1_before: before.all.delta1,
            delta1_after: after.all.delta1,
            coverage_after: after.all.coverage,
        })
    }

    fn instances(&self) -> Result<InstanceFigures> {
        let found = edit::InstanceList::load(self.scene, &[])?;
        let instances = Instances {
            labels: self.scene.labels(Stage::Unify)?,
            scores: found.scores(),
            passes: 0,
        };
        let groups = segment::unify::without_unification(&self.scene.labels(Stage::Masks)?);
        let truth: Vec<Map<u32>> = self
            .set
            .inputs
            .iter()
            .map(|shot| shot.view.instances.clone())
            .collect();
        let cloud = self.scene.cloud(&self.scene.frames(Role::Input)?)?;
        let report = InstanceComparison::new(&groups, &instances, &cloud, &truth)?;
        Ok(InstanceFigures {
            ap_before: report.before.ap,
            ap: report.after.ap,
            ap50: report.after.ap50,
            ap75: report.after.ap75,
            scannet_ap: report.points.ap,
            scannet_ap50: report.points.ap50,
            scannet_ap25: report.points.ap25,
            objects: report.after.truths,
            predicted: report.after.predictions,
        })
    }

    fn rendering(&self, mask_references: bool) -> Rendering<'_> {
        Rendering {
            completer: self.completer,
            splats: SplatParams::default(),
            references: ReferenceParams {
                mask_references,
                ..ReferenceParams::default()
            },
        }
    }

    /// Renders the held-out views of the scene as edited by `edits`, and writes them into a folder of
    /// pictures.
    fn render(
        &self,
        edits: Vec<Edit>,
        into: &str,
        progress: &dyn Progress,
    ) -> Result<(EditedScene, Vec<View>)> {
        let mut list = EditList::cleared(self.scene)?;
        for edit in edits {
            list.push(edit)?;
        }
        list.save(self.scene, self.lock)?;
        let edited = EditedScene::load(self.scene)?;
        let rendered = (self.rendering(true)).views(&edited, &self.cameras(), progress)?;
        let views = self.set.held_out.iter().zip(rendered);
        let written = views.map(|(shot, (view, story))| {
            view.write(&self.pictures().join(into), &shot.name, &story)?;
            Ok(view)
        });
        let written = written.collect::<Result<_>>()?;
        Ok((edited, written))
    }

    /// The held-out views.
    fn cameras(&self) -> Vec<(String, Camera)> {
        let shots = self.set.held_out.iter();
        shots.map(|shot| (shot.name.clone(), shot.camera)).collect()
    }

    fn pictures(&self) -> PathBuf {
        self.folder.join("pictures")
    }

    fn views(&self, progress: &dyn Progress) -> Result<ViewFigures> {
        let (_, views) = self.render(Vec::new(), "novel_views", progress)?;
        let shots = self.set.held_out.iter().zip(&views);
        let compared: Vec<_> = shots
            .map(|(shot, view)| ComparedView {
                name: &shot.name,
                completed: &view.picture,
                projected: &view.projection.colour,
                truth: &shot.view.colour,
            })
            .collect();
        let report =
            ViewsReport::new(&compared, &Perceptual::none(), progress)?.ok_or_else(|| {
                Error::request("the room has no held-out view", "choose another seed")
            })?;
        Ok(ViewFigures {
            psnr: report.completed.psnr,
            ssim: report.completed.ssim,
            psnr_projected: report.projected.psnr,
            ssim_projected: report.projected.ssim,
        })
    }

    /// The instance that the showcase object has become: the one with the highest IoU.
    fn showcase_instance(&self) -> Result<u32> {
        let labels = self.scene.labels(Stage::Unify)?;
        let mut both: BTreeMap<u32, u64> = BTreeMap::new();
        let mut area: BTreeMap<u32, u64> = BTreeMap::new();
        let mut object = 0_u64;
        for (labels, shot) in labels.iter().zip(&self.set.inputs) {
            for (&label, &truth) in labels.values().iter().zip(shot.view.instances.values()) {
                let hit = truth == self.set.showcase.id;
                object += u64::from(hit);
                *area.entry(label).or_default() += 1;
                *both.entry(label).or_default() += u64::from(hit);
            }
        }
        let iou = |label: &u32| both[label] as f64 / (area[label] + object - both[label]) as f64;
        let labels = area.keys().filter(|&&label| label != 0);
        let best = labels
            .copied()
            .max_by(|a, b| iou(a).total_cmp(&iou(b)).then(b.cmp(a)));
        best.ok_or_else(|| {
            Error::file(
                self.scene.folder(),
                "has no instance",
                "try the demo with another seed",
            )
        })
    }

    /// Removes the showcase object, and renders with and without reference masks.
    fn removal(&self, progress: &dyn Progress) -> Result<EditedViewFigures> {
        let removal = Edit::Remove {
            instances: vec![self.showcase_instance()?],
        };
        let (edited, masked) = self.render(vec![removal], "removed", progress)?;
        let id = self.set.showcase.id;
        let shots = self.set.held_out.iter().zip(&self.set.without).zip(&masked);
        let regions = shots.map(|((with, without), masked)| {
            let region = with.view.instances.map(|&seen| seen == id);
            (region, without, masked)
        });
        // The views that show the object.
        let shown: Vec<_> = regions
            .filter(|(region, ..)| region.values().contains(&true))
            .collect();
        let cameras: Vec<_> = (shown.iter())
            .map(|(_, without, _)| (without.name.clone(), without.camera))
            .collect();
        let rendered = (self.rendering(false)).views(&edited, &cameras, progress)?;
        // For each, PSNR of the picture and of where the object was.
        let (mut with_masks, mut without_masks) = (Vec::new(), Vec::new());
        for ((region, without, masked), (unmasked, story)) in shown.into_iter().zip(&rendered) {
            let folder = self.pictures().join("removed_unmasked");
            unmasked.write(&folder, &without.name, story)?;
            let truth = &without.view.colour;
            for (view, figures) in [(masked, &mut with_masks), (unmasked, &mut without_masks)] {
                let whole = psnr(&view.picture, truth, None)?;
                figures.push([whole, psnr(&view.picture, truth, Some(&region))?]);
            }
        }
        let mean = |figures: &[[f64; 2]]| -> [f64; 2] {
            let sum = |k: usize| figures.iter().map(|figure| figure[k]).sum::<f64>();
            [0, 1].map(|k| sum(k) / figures.len() as f64)
        };
        let [psnr_masked, region_psnr_masked] = mean(&with_masks);
        let [psnr_unmasked, region_psnr_unmasked] = mean(&without_masks);
        Ok(EditedViewFigures {
            psnr_unmasked,
            psnr_masked,
            region_psnr_unmasked,
            region_psnr_masked,
            views: with_masks.len(),
        })
    }

    /// Shows a move and a change of colour.
    fn edits(&self, progress: &dyn Progress) -> Result<()> {
        let instance = self.showcase_instance()?;
        let [x, y] = free_place(&self.set.room, &self.set.showcase);
        let floor = &self.scene.manifest().floor_to_world;
        let place = floor.inverse_transform_point(&Point::new(x, y, 0.0));
        let placement = Placement {
            to: Some([place.x, place.y]),
            turn_degrees: 35.0,
            ..Placement::default()
        };
        let change = ColourChange::To {
            colour: Hex([30, 110, 190]),
        };
        self.render(
            vec![Edit::Move {
                instance,
                placement,
            }],
            "moved",
            progress,
        )?;
        let recolour = Edit::Recolour {
            instances: vec![instance],
            change,
        };
        self.render(vec![recolour], "recoloured", progress)?;
        Ok(())
    }
}
