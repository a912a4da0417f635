use super::*;
use crate::{
    progress::Silent,
    scene::test_frames::{facing_wall, frame},
};

const EXACT: UnifyParams = UnifyParams {
    eta: 1.0 / 3.0,
    depth_tolerance: 0.05,
    min_overlap: 0.0,
    fragment: 1.0,
    vote: false,
};

/// Frames that all look at the same wall from the same place: pixels correspond one to one.
fn same_view(labels: &[&dyn Fn(u32, u32) -> u32]) -> (Vec<Frame>, Vec<Map<bool>>, Vec<Map<u32>>) {
    let frames: Vec<Frame> = labels.iter().map(|_| facing_wall(0.0, 4.0)).collect();
    let validity = frames.iter().map(|f| f.depth.map(|_| true)).collect();
    let labels = labels
        .iter()
        .map(|label| Map::from_fn(32, 24, label))
        .collect();
    (frames, validity, labels)
}

fn run(scene: &(Vec<Frame>, Vec<Map<bool>>, Vec<Map<u32>>), params: &UnifyParams) -> Instances {
    unify(&scene.0, &scene.1, &scene.2, params, &Silent)
}

fn at(instances: &Instances, frame: usize, x: u32, y: u32) -> u32 {
    instances.labels[frame][(x, y)]
}

#[test]
fn masks_of_one_object_become_one_instance_whatever_their_labels() {
    let scene = same_view(&[&|x, _| 1 + x / 16, &|x, _| 2 - x / 16, &|x, _| 1 + x / 16]);
    let instances = run(&scene, &EXACT);
    assert_eq!(instances.scores, [1.0, 1.0]);
    for frame in 1..3 {
        assert_eq!(at(&instances, frame, 0, 0), at(&instances, 0, 0, 0));
        assert_eq!(at(&instances, frame, 31, 0), at(&instances, 0, 31, 0));
    }
    assert_ne!(at(&instances, 0, 0, 0), at(&instances, 0, 31, 0));
}

#[test]
fn iou_exactly_eta_does_not_merge() {
    // One column against three: IoU 1/3.
    let scene = same_view(&[&|x, _| u32::from(x < 3), &|x, _| u32::from(x < 1)]);
    assert_eq!(run(&scene, &EXACT).scores.len(), 2);
    let looser = UnifyParams { eta: 0.33, ..EXACT };
    assert_eq!(run(&scene, &looser).scores.len(), 1);
}

#[test]
fn a_group_merges_on_with_what_it_has_become() {
    // The second view splits the object in two; each half has IoU 1/2 with the whole.
    let scene = same_view(&[&|x, _| u32::from(x < 16), &|x, _| match x {
        0..8 => 1,
        8..16 => 2,
        _ => 0,
    }]);
    let instances = run(&scene, &EXACT);
    assert_eq!(instances.scores.len(), 1);
    assert!(instances.passes >= 3, "two passes merge, one finds nothing");
}

#[test]
fn one_mask_over_two_objects_does_not_fuse_them() {
    let two = |x: u32, _| 1 + x / 16;
    let fused = |_, _| 1;
    let scene = same_view(&[&two, &two, &two, &fused]);
    let instances = run(&scene, &EXACT);
    assert_eq!(instances.scores.len(), 2);
    assert_ne!(at(&instances, 0, 0, 0), at(&instances, 0, 31, 0));
    assert_eq!(
        at(&instances, 3, 0, 0),
        at(&instances, 3, 31, 0),
        "without a vote"
    );
    let voted = run(
        &scene,
        &UnifyParams {
            vote: true,
            ..EXACT
        },
    );
    assert_eq!(at(&voted, 3, 0, 0), at(&voted, 0, 0, 0));
    assert_eq!(
        at(&voted, 3, 31, 0),
        at(&voted, 0, 31, 0),
        "the vote splits the fused mask"
    );
}

#[test]
fn fragments_join_the_whole_but_a_cup_is_no_fragment() {
    // One view of three cuts a small piece off the left object.
    let whole = |x: u32, _| 1 + x / 16;
    let cut = |x: u32, y: u32| if x < 16 && y < 4 { 3 } else { 1 + x / 16 };
    let pieces = same_view(&[&whole, &whole, &cut]);
    assert_eq!(run(&pieces, &EXACT).scores.len(), 3);
    let params = UnifyParams {
        fragment: 0.7,
        ..EXACT
    };
    assert_eq!(run(&pieces, &params).scores.len(), 2);
    // A small object that two views see and the third one took for the large one.
    let cup = same_view(&[&cut, &cut, &whole]);
    assert_eq!(run(&cup, &params).scores.len(), 3);
}

#[test]
fn a_hidden_object_is_not_projected_through_what_hides_it() {
    // The first view sees a wall 4 away, the second a screen 2 away that fills its picture.
    let frames = vec![facing_wall(0.0, 4.0), facing_wall(0.0, 2.0)];
    let validity: Vec<Map<bool>> = frames.iter().map(|f| f.depth.map(|_| true)).collect();
    let labels = vec![Map::filled(32, 24, 1), Map::filled(32, 24, 1)];
    let instances = unify(&frames, &validity, &labels, &EXACT, &Silent);
    assert_eq!(
        instances.scores,
        [0.0, 0.0],
        "same pixels, other points: two instances nobody confirms"
    );
}

#[test]
fn a_near_view_sees_a_far_views_mask_without_holes() {
    // The second camera stands three times nearer; forward projection would leave 8 of 9 pixels empty.
    let mut near = facing_wall(0.0, 2.0);
    near.camera.cam_to_world.translation.z = 4.0;
    let frames = vec![facing_wall(0.0, 6.0), near];
    let validity: Vec<Map<bool>> = frames.iter().map(|f| f.depth.map(|_| true)).collect();
    let labels = vec![Map::filled(32, 24, 1), Map::filled(32, 24, 1)];
    let instances = unify(&frames, &validity, &labels, &EXACT, &Silent);
    assert_eq!(instances.scores.len(), 1);
}

#[test]
fn what_a_view_cannot_see_is_no_evidence_against() {
    // The cameras are 3 apart at distance 4: they share the outer 2 of 32 columns only.
    let frames = vec![facing_wall(0.0, 4.0), facing_wall(3.0, 4.0)];
    let validity: Vec<Map<bool>> = frames.iter().map(|f| f.depth.map(|_| true)).collect();
    let labels = vec![Map::filled(32, 24, 1), Map::filled(32, 24, 1)];
    let instances = unify(&frames, &validity, &labels, &EXACT, &Silent);
    assert_eq!(instances.scores, [1.0]);
    let demanding = UnifyParams {
        min_overlap: 0.5,
        ..EXACT
    };
    assert_eq!(
        unify(&frames, &validity, &labels, &demanding, &Silent)
            .scores
            .len(),
        2
    );
}

#[test]
fn pixels_without_a_point_keep_their_masks_instance() {
    let mut scene = same_view(&[&|_, _| 1, &|_, _| 1]);
    scene.1[0].values_mut()[0] = false;
    let instances = run(&scene, &UnifyParams::default());
    assert_eq!(at(&instances, 0, 0, 0), 1);
}

#[test]
fn the_vote_fills_a_mask_that_one_view_missed() {
    let scene = same_view(&[&|_, _| 1, &|_, _| 1, &|_, _| 0]);
    assert_eq!(at(&run(&scene, &EXACT), 2, 5, 5), 0);
    assert_eq!(at(&run(&scene, &UnifyParams::default()), 2, 5, 5), 1);
}

#[test]
fn instances_are_numbered_by_area_and_nothing_is_fine_too() {
    let scene = same_view(&[&|x, _| if x < 4 { 1 } else { 2 }]);
    let instances = run(&scene, &EXACT);
    assert_eq!((at(&instances, 0, 31, 0), at(&instances, 0, 0, 0)), (1, 2));
    let none = run(&same_view(&[&|_, _| 0, &|_, _| 0]), &EXACT);
    assert!(none.scores.is_empty());
    assert_eq!(run(&(vec![], vec![], vec![]), &EXACT).labels.len(), 0);
}

#[test]
fn without_unification_every_mask_is_an_instance() {
    let scene = same_view(&[&|x, _| 1 + x / 16, &|_, _| 1]);
    let groups = without_unification(&scene.2);
    assert_eq!(groups.scores.len(), 3);
    assert_eq!(
        (
            at(&groups, 0, 0, 0),
            at(&groups, 0, 31, 0),
            at(&groups, 1, 0, 0)
        ),
        (1, 2, 3)
    );
}

#[test]
fn a_mask_without_any_point_is_no_instance() {
    let mut scene = same_view(&[&|x, _| if x == 0 { 2 } else { 1 }, &|_, _| 1]);
    for (index, valid) in scene.1[0].values_mut().iter_mut().enumerate() {
        *valid = index % 32 != 0;
    }
    let instances = run(&scene, &EXACT).with_points(&scene.1);
    assert_eq!(instances.scores.len(), 1);
    assert_eq!((at(&instances, 0, 0, 0), at(&instances, 0, 1, 0)), (0, 1));
}

/// A frame with no depth at all must neither panic nor gain instances.
#[test]
fn a_frame_without_depth_takes_no_part() {
    let frames = vec![frame(0.0, Map::filled(32, 24, 0.0)), facing_wall(0.0, 4.0)];
    let validity: Vec<Map<bool>> = frames.iter().map(|f| f.depth.map(|&z| z > 0.0)).collect();
    let labels = vec![Map::filled(32, 24, 1), Map::filled(32, 24, 1)];
    let instances = unify(&frames, &validity, &labels, &EXACT, &Silent).with_points(&validity);
    assert_eq!(instances.scores.len(), 1);
    assert!(instances.labels[0].values().iter().all(|&id| id == 0));
}

#[test]
fn instances_without_a_point_are_left_out_and_the_others_close_up() {
    let labels = Map::new(4, 1, vec![1, 2, 3, 0]).unwrap();
    let validity = Map::new(4, 1, vec![true, false, true, true]).unwrap();
    let instances = Instances {
        labels: vec![labels],
        scores: vec![0.9, 0.8, 0.7],
        passes: 1,
    };
    let left = instances.with_points(&[validity]);
    assert_eq!(left.labels[0].values(), [1, 0, 2, 0]);
    assert_eq!(left.scores, [0.9, 0.7]);
}
