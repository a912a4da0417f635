use super::{
    job::{Job, Part},
    plan::{Plan, Way},
    stage::{Settings, Stage},
    *,
};
use crate::{
    Error, Map,
    edit::{Edited, Motions},
    progress::{Progress, Silent},
    render::{EditedScene, ReferenceParams, Rendering, SplatParams, Story, View},
    scene::{
        Cloud,
        test_frames::{camera_at, facing_wall},
    },
};

fn weights(params: &See3dParams) -> See3dWeights {
    See3dWeights::synthetic_tiny(params).unwrap()
}

fn part(stage: Stage, group: usize, number: usize, carried: &[usize], targets: [usize; 2]) -> Part {
    Part {
        stage,
        group,
        number,
        carried: carried.to_vec(),
        targets: targets[0]..targets[1],
    }
}

#[test]
fn what_is_not_said_is_the_originals() {
    let default = Settings::new(&See3dParams::default(), false);
    assert_eq!(
        (default.size, default.steps, default.guidance),
        (512, [50, 30], 2.0)
    );
    assert_eq!(default.stages().collect::<Vec<_>>(), [Stage::Main]);
    let fast = See3dParams {
        quality: Quality::Fast,
        super_resolution: true,
        ..See3dParams::default()
    };
    let fast = Settings::new(&fast, false);
    assert_eq!(fast.steps, [15, 15]);
    assert_eq!(fast.side(Stage::SuperResolution), 1024);
    let said = See3dParams {
        size: Some(128),
        steps: Some(7),
        ..See3dParams::default()
    };
    let said = Settings::new(&said, true);
    assert_eq!((said.size, said.steps), (128, [7, 5]));
}

#[test]
fn super_resolution_follows_within_each_group() {
    let params = See3dParams {
        super_resolution: true,
        references: 2,
        ..See3dParams::default()
    };
    let (weights, settings) = (weights(&params), Settings::new(&params, true));
    let job = Job {
        weights: &weights,
        settings: &settings,
        views: 11,
        photos: 2,
    };
    let (main, sr) = (Stage::Main, Stage::SuperResolution);
    // Groups of 6 and 5 views: 5 of (2 + 6 + 3) / 2 at a time, and of (2 + 5 + 3) / 2.
    let wanted = [
        part(main, 0, 0, &[], [0, 6]),
        part(main, 1, 1, &[5], [6, 11]),
        part(sr, 0, 0, &[], [0, 5]),
        part(sr, 0, 1, &[2, 4], [5, 6]),
        part(sr, 1, 2, &[], [6, 11]),
    ];
    assert_eq!(job.parts(6), wanted);
}

#[test]
fn less_memory_means_the_least_harm_first() {
    let params = See3dParams {
        size: Some(512),
        references: 3,
        ..See3dParams::default()
    };
    let (weights, settings) = (weights(&params), Settings::new(&params, true));
    let job = Job {
        weights: &weights,
        settings: &settings,
        views: 12,
        photos: 3,
    };
    let ample = job.plan(Some(u64::MAX)).unwrap();
    assert_eq!(
        (ample.group, ample.way.stays, ample.way.in_turn),
        (8, true, false)
    );
    assert_eq!(ample.concessions(), None);
    let mut limit = job.bytes(&ample).unwrap();
    assert_eq!(job.plan(Some(limit)).unwrap(), ample);
    // Each time a little too little, until nothing fits.
    let mut plans = vec![ample];
    let message = loop {
        match job.plan(Some(limit - 1)) {
            Ok(plan) => {
                limit = job.bytes(&plan).unwrap();
                plans.push(plan);
            }
            Err(refused) => break refused.to_string(),
        }
    };
    assert!(plans.len() > 3, "{plans:?}");
    assert!(plans.iter().any(|plan| plan.group == 8 && plan.way.in_turn));
    assert!(
        plans
            .iter()
            .rev()
            .skip(1)
            .any(|plan| plan.concessions().is_some())
    );
    let groups: Vec<usize> = plans.iter().map(|plan| plan.group).collect();
    assert!(
        groups.is_sorted_by(|a, b| a >= b) && groups.last() == Some(&1),
        "{groups:?}"
    );
    assert!(message.contains("--references 2"), "{message}");

    // A group that was asked for is not made smaller, but it is said which would do.
    let asked = Settings {
        group: Some(8),
        ..settings.clone()
    };
    let asked = Job {
        settings: &asked,
        ..job
    };
    let message = asked.plan(Some(limit)).unwrap_err().to_string();
    assert!(
        message.contains("8 views guided by 3 photos at 512x512"),
        "{message}"
    );
    assert!(message.contains("--group 1"), "{message}");
    let message = asked.plan(Some(1000)).unwrap_err().to_string();
    assert!(message.contains("allow for"), "{message}");
    assert!(
        job.check(&ample, Some(limit))
            .unwrap_err()
            .to_string()
            .contains("--force")
    );
}

#[test]
fn more_frames_take_more_of_everything() {
    let params = See3dParams::default();
    let (weights, settings) = (weights(&params), Settings::new(&params, true));
    let job = |views, photos| Job {
        weights: &weights,
        settings: &settings,
        views,
        photos,
    };
    let way = Way {
        stays: true,
        in_turn: false,
        tile: None,
    };
    let bytes = |views, photos, group| job(views, photos).bytes(&Plan { group, way }).unwrap();
    assert!(bytes(4, 1, 4) < bytes(6, 1, 6));
    assert!(bytes(4, 1, 4) < bytes(4, 3, 4));
    let work = |views, photos, group| {
        let job = job(views, photos);
        let parts = job.parts(group);
        let each = parts
            .iter()
            .map(|part| job.work(part, way.tiling()).unwrap());
        each.sum::<f64>()
    };
    assert!(work(4, 1, 4) < work(6, 1, 6));
    assert!(work(4, 1, 4) < work(4, 2, 4));
    // Twice as many frames together are more than twice the work: attention is quadratic.
    assert!(work(8, 0, 8) > 2.0 * work(4, 0, 4));
}

/// A wall with gaps, and photos of it.
fn scene() -> EditedScene {
    let frames: Vec<_> = [0.0, 0.3, 0.6].map(|x| facing_wall(x, 4.0)).into();
    let gaps = Map::from_fn(32, 24, |x, _| x % 11 != 0);
    let edited = Edited {
        cloud: Cloud::from_frames(&frames, &[gaps.clone(), gaps.clone(), gaps], None),
        vacated: Cloud::default(),
        photos: frames.iter().map(|frame| frame.colour.clone()).collect(),
        instances: Vec::new(),
        motions: Motions::default(),
    };
    EditedScene { frames, edited }
}

fn rendered(params: &See3dParams, views: usize) -> Vec<(View, Story)> {
    rendered_by(&See3d::new(weights(params), params), views)
}

fn rendered_by(see3d: &See3d, views: usize) -> Vec<(View, Story)> {
    let rendering = Rendering {
        completer: see3d,
        splats: SplatParams::default(),
        references: ReferenceParams::default(),
    };
    let cameras = (0..views).map(|k| (format!("view_{k}"), camera_at(0.1 * k as f64)));
    let cameras: Vec<_> = cameras.collect();
    rendering.views(&scene(), &cameras, &Silent).unwrap()
}

/// Wants a rendering no more once it is told of some progress for so many times.
struct Impatient(std::sync::atomic::AtomicUsize);

impl Progress for Impatient {
    fn begin(&self, _: &str, _: usize) {}
    fn advance(&self, _: usize) {
        let relaxed = std::sync::atomic::Ordering::Relaxed;
        let _ = (self.0).fetch_update(relaxed, relaxed, |left| left.checked_sub(1));
    }
    fn end(&self) {}
    fn is_cancelled(&self) -> bool {
        self.0.load(std::sync::atomic::Ordering::Relaxed) == 0
    }
}

#[test]
fn a_step_can_be_cancelled_while_it_is_taken() {
    let params = See3dParams::default();
    let see3d = See3d::new(weights(&params), &params);
    let rendering = Rendering {
        completer: &see3d,
        splats: SplatParams::default(),
        references: ReferenceParams::default(),
    };
    let cameras = [("view".to_string(), camera_at(0.1))];
    // Encoders of text and photos tell of three steps, the networks of many more.
    for patience in [0, 3, 6] {
        let progress = Impatient(patience.into());
        let result = rendering.views(&scene(), &cameras, &progress);
        assert!(matches!(result, Err(Error::Cancelled)), "{patience}");
    }
    let estimate = rendering.estimate(&scene(), &cameras).unwrap().unwrap();
    assert!(estimate.contains("view"), "{estimate}");
}

#[test]
fn groups_and_super_resolution_come_to_pictures_of_the_views_size() {
    let params = See3dParams {
        group: Some(2),
        references: 2,
        steps: Some(2),
        super_resolution: true,
        ..See3dParams::default()
    };
    let views = rendered(&params, 3);
    assert_eq!(views.len(), 3);
    for (view, story) in &views {
        assert_eq!(view.picture.dimensions(), (32, 24));
        assert_eq!(story.details["stage"], "super-resolution");
        assert_eq!(story.details["photos"].as_array().unwrap().len(), 2);
    }
    assert_ne!(views[0].0.picture, views[1].0.picture);
    let once_more = rendered(&params, 3);
    let other_seed = See3dParams { seed: 43, ..params };
    let others = rendered(&other_seed, 3);
    for k in 0..3 {
        assert_eq!(views[k].0.picture, once_more[k].0.picture);
        assert_ne!(views[k].0.picture, others[k].0.picture);
    }
}

#[test]
fn little_memory_comes_to_the_same_pictures() {
    let params = See3dParams {
        references: 3,
        group: Some(2),
        steps: Some(1),
        ..See3dParams::default()
    };
    let mut see3d = See3d::new(weights(&params), &params);
    let ample = rendered_by(&see3d, 4);
    let job = Job {
        weights: &see3d.weights,
        settings: &see3d.settings,
        views: 4,
        photos: 3,
    };
    let ample_plan = job.plan(Some(u64::MAX)).unwrap();
    let limit = job.bytes(&ample_plan).unwrap() - 1;
    let little_plan = job.plan(Some(limit)).unwrap();
    assert_ne!(little_plan, ample_plan);
    assert_eq!(little_plan.way.tile, None, "tiles are another picture");
    see3d.max_memory = Some(limit);
    for ((little, story), (ample, _)) in rendered_by(&see3d, 4).iter().zip(&ample) {
        assert_eq!(little.picture, ample.picture);
        assert_eq!(story.details["tile"], Value::Null);
    }
}

#[test]
fn one_photo_and_the_fast_sampler_do_it_too() {
    let params = See3dParams {
        references: 1,
        quality: Quality::Fast,
        ..See3dParams::default()
    };
    let views = rendered(&params, 1);
    let (_, story) = &views[0];
    assert_eq!(story.details["unet"]["network"], "see3d-single");
    let settings = &story.completer["see3d"]["settings"];
    assert_eq!(settings["quality"], "fast");
    assert_eq!(settings["seed"], 42);
}
