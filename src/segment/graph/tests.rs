use super::*;
use nalgebra::{Rotation3, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use std::collections::BTreeMap;

const LENS: Intrinsics = Intrinsics {
    width: 160,
    height: 120,
    fx: 140.0,
    fy: 140.0,
    cx: 79.5,
    cy: 59.5,
};

/// What a ray hits: depth, colour, and the name of the thing.
type Hit = (f64, [u8; 3], &'static str);

/// A box from `low` to `high`, room coordinates (y up).
struct Block {
    low: [f64; 3],
    high: [f64; 3],
    colour: [u8; 3],
    name: &'static str,
}

/// A camera 1.5 above the floor (y = 0) of a room with its back wall at z = 4, looking down at
/// `pitch` degrees.
fn look(pitch: f64, ray: [f64; 2], blocks: &[Block]) -> Hit {
    const FLOOR: [u8; 3] = [120, 100, 80];
    const WALL: [u8; 3] = [200, 200, 190];
    let local = Vector3::new(ray[0], -ray[1], 1.0);
    let way = Rotation3::from_axis_angle(&Vector3::x_axis(), pitch.to_radians()) * local;
    let from = Vector3::new(0.0, 1.5, 0.0);
    // `local.z` is 1, so the length along `way` is the depth.
    let mut hit = (4.0 / way.z, WALL, "wall");
    if way.y < 0.0 && -from.y / way.y < hit.0 {
        hit = (-from.y / way.y, FLOOR, "floor");
    }
    for block in blocks {
        let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
        for axis in 0..3 {
            let near = (block.low[axis] - from[axis]) / way[axis];
            let far = (block.high[axis] - from[axis]) / way[axis];
            enter = enter.max(near.min(far));
            leave = leave.min(near.max(far));
        }
        if enter < leave && enter < hit.0 {
            hit = (enter, block.colour, block.name);
        }
    }
    hit
}

/// The masks of the room, with `noise` (standard deviation of the disparity), and by the names of
/// the things the share of their pixels that each label has.
fn masks_of(blocks: &[Block], noise: f64) -> BTreeMap<&'static str, BTreeMap<u32, f64>> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let hits = Map::from_fn(LENS.width, LENS.height, |x, y| {
        let ray = LENS.unproject(f64::from(x), f64::from(y), 1.0);
        let mut hit = look(25.0, [ray.x, ray.y], blocks);
        let normal = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        hit.0 = 1.0 / (1.0 / hit.0 + noise * normal);
        hit
    });
    let colour = RgbImage::from_fn(LENS.width, LENS.height, |x, y| image::Rgb(hits[(x, y)].1));
    let depth = hits.map(|hit| hit.0 as f32);
    let labels = segment(&colour, &depth, &LENS, &GraphParams::default());
    let mut shares = BTreeMap::<_, BTreeMap<u32, f64>>::new();
    for (label, hit) in labels.values().iter().zip(hits.values()) {
        *shares.entry(hit.2).or_default().entry(*label).or_default() += 1.0;
    }
    for labels in shares.values_mut() {
        let all: f64 = labels.values().sum();
        labels.values_mut().for_each(|count| *count /= all);
    }
    shares
}

/// Each thing has one mask with nearly all of it, and no two things share one.
fn assert_separate(shares: &BTreeMap<&'static str, BTreeMap<u32, f64>>, least: f64) {
    let mut taken = Vec::new();
    for (name, labels) in shares {
        let best = labels.iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
        assert!(*best.1 >= least, "{name} is in pieces: {labels:?}");
        assert!(
            *best.0 != 0 && !taken.contains(best.0),
            "{name}: {shares:?}"
        );
        taken.push(*best.0);
    }
}

/// A box on the floor, of which the camera sees the front and the top.
fn crate_of(colour: [u8; 3]) -> Block {
    Block {
        low: [-0.3, 0.0, 2.0],
        high: [0.5, 0.6, 2.6],
        colour,
        name: "box",
    }
}

#[test]
fn a_box_on_the_floor_is_one_mask_even_in_the_floors_colour() {
    for colour in [[120, 100, 80], [160, 40, 40]] {
        assert_separate(&masks_of(&[crate_of(colour)], 0.0), 0.95);
    }
}

#[test]
fn noise_of_a_depth_camera_does_no_harm() {
    // 1.5e-3 is what a Kinect has.
    for colour in [[120, 100, 80], [160, 40, 40]] {
        assert_separate(&masks_of(&[crate_of(colour)], 1.5e-3), 0.9);
    }
}

#[test]
fn things_of_one_colour_at_different_depths_are_two() {
    let behind = Block {
        low: [-1.2, 0.0, 3.2],
        high: [0.2, 1.2, 3.6],
        colour: [160, 40, 40],
        name: "behind",
    };
    assert_separate(&masks_of(&[crate_of([160, 40, 40]), behind], 0.0), 0.9);
}

#[test]
fn a_wall_stays_one_mask_behind_a_pillar() {
    let pillar = Block {
        low: [-0.2, 0.0, 2.4],
        high: [0.2, 9.0, 2.6],
        colour: [60, 60, 140],
        name: "pillar",
    };
    assert_separate(&masks_of(&[pillar], 0.0), 0.95);
}

/// A wall right ahead, 3 away, in the colours of `paint`.
fn flat(paint: impl Fn(u32, u32) -> [u8; 3]) -> Map<u32> {
    let colour = RgbImage::from_fn(LENS.width, LENS.height, |x, y| image::Rgb(paint(x, y)));
    let depth = Map::filled(LENS.width, LENS.height, 3.0);
    segment(&colour, &depth, &LENS, &GraphParams::default())
}

#[test]
fn flat_regions_of_different_colour_separate_and_the_larger_is_first() {
    let masks = flat(|x, _| if x < 60 { [180, 60, 60] } else { [60, 60, 180] });
    assert_eq!(masks[(20, 60)], 2);
    assert_eq!(masks[(120, 60)], 1);
    let wrong = masks.values().iter().enumerate().filter(|&(i, &label)| {
        let expected = if i % 160 < 60 { 2 } else { 1 };
        label != expected
    });
    assert!(wrong.count() < 3 * 120);
}

#[test]
fn a_picture_is_one_mask_on_its_wall_whatever_it_shows_and_a_stain_is_none() {
    let masks = flat(|x, y| match (x, y) {
        (60..80, 40..70) => [180, 60, 60],
        (80..100, 40..70) => [60, 60, 180],
        (20..26, 20..26) => [60, 180, 60],
        _ => [150; 3],
    });
    for (pixel, label) in [((5, 5), 1), ((70, 55), 2), ((90, 55), 2), ((23, 23), 1)] {
        assert_eq!(masks[pixel], label, "at {pixel:?}");
    }
    assert_eq!(masks.values().iter().max(), Some(&2));
}

#[test]
fn shading_does_not_cut_a_wall() {
    let masks = flat(|x, _| [90 + (x / 2) as u8; 3]);
    assert!(masks.values().iter().all(|&label| label == 1));
}

#[test]
fn no_mask_is_smaller_than_the_minimum() {
    let colour = RgbImage::from_fn(160, 120, |x, y| {
        let tile = (x / 16 * 7 + y / 12 * 5) % 6;
        image::Rgb([
            (tile * 50) as u8,
            255 - (tile * 40) as u8,
            (tile * 90 % 256) as u8,
        ])
    });
    let depth = Map::from_fn(160, 120, |x, y| 2.0 + ((x / 16 + y / 12) % 3) as f32);
    for min_area in [0.0, 0.005, 0.03, 2.0] {
        let params = GraphParams {
            min_area,
            ..GraphParams::default()
        };
        let masks = segment(&colour, &depth, &LENS, &params);
        let highest = *masks.values().iter().max().unwrap();
        let areas: Vec<usize> = (1..=highest)
            .map(|l| masks.values().iter().filter(|&&m| m == l).count())
            .collect();
        assert!(areas.is_sorted_by(|a, b| a >= b));
        assert!(
            areas
                .iter()
                .all(|&a| a as f32 >= min_area * 19200.0 && a > 0)
        );
        assert_eq!(areas.is_empty(), min_area > 1.0);
    }
}

#[test]
fn photos_without_depth_and_sizes_that_disagree_have_no_masks() {
    let params = GraphParams::default();
    let colour = RgbImage::new(160, 120);
    let none = Map::filled(160, 120, 0);
    assert_eq!(
        segment(&colour, &Map::filled(160, 120, 0.0), &LENS, &params),
        none
    );
    let depth = Map::filled(160, 120, 1.0);
    assert_eq!(segment(&RgbImage::new(8, 8), &depth, &LENS, &params), none);
    let other = LENS.resized(80, 60);
    assert_eq!(segment(&colour, &depth, &other, &params), none);
    for fx in [0.0, -1.0, f64::NAN] {
        assert_eq!(
            segment(&colour, &depth, &Intrinsics { fx, ..LENS }, &params),
            none
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn nothing_panics_everything_repeats_and_what_has_depth_has_a_mask(
        width in 0u32..9,
        height in 0u32..9,
        values in prop::collection::vec(prop_oneof![
            Just(0.0f32), 0.5f32..5.0, Just(f32::NAN), Just(f32::INFINITY), Just(f32::MAX), Just(1e-30),
        ], 64),
        bytes in prop::collection::vec(any::<u8>(), 64 * 3),
    ) {
        let size = (width * height) as usize;
        let colour = RgbImage::from_raw(width, height, bytes[..3 * size].to_vec()).unwrap();
        let depth = Map::new(width, height, values[..size].to_vec()).unwrap();
        let lens = Intrinsics { width, height, ..LENS };
        let params = GraphParams { min_area: 0.0, ..GraphParams::default() };
        let masks = segment(&colour, &depth, &lens, &params);
        prop_assert!(masks.same_size(&depth));
        for (label, z) in masks.values().iter().zip(depth.values()) {
            prop_assert!(*label > 0 || surface::disparity(*z) == 0.0);
        }
        prop_assert_eq!(&masks, &segment(&colour, &depth, &lens, &params));
    }
}
