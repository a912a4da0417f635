use super::*;
use crate::{
    demo::room::{Room, RoomView},
    geometry::{Camera, Warp},
};
use image::Rgb;

const PHOTOS: usize = 10;

/// Photos of a room, with their cameras.
fn walk_through(seed: u64) -> (Vec<Camera>, Vec<RoomView>) {
    let room = Room::furnish(seed);
    let small = |camera: Camera| Camera {
        intrinsics: camera.intrinsics.resized(160, 120),
        ..camera
    };
    let cameras: Vec<Camera> = room.cameras(PHOTOS, 0).0.into_iter().map(small).collect();
    let views = cameras.iter().map(|camera| room.render(camera)).collect();
    (cameras, views)
}

/// The share of the pixels of photo `a` whose surface photo `b` sees.
fn seen_again(cameras: &[Camera], views: &[RoomView], a: usize, b: usize) -> f64 {
    let warp = Warp::new(&cameras[a], &cameras[b]);
    let (from, to) = (&views[a].depth, &views[b].depth);
    let is_seen = |index: &usize| {
        let (x, y) = from.pixel(*index);
        warp.apply(x, y, from.values()[*index])
            .is_some_and(|([u, v], depth)| {
                let seen = to.nearest(u, v).map(|at| f64::from(to.values()[at]));
                seen.is_some_and(|seen| (depth - seen).abs() < 0.03 * seen)
            })
    };
    (0..from.len()).filter(is_seen).count() as f64 / from.len() as f64
}

/// The mean of `between` from the first view to all others, and from each view that is no reference
/// to the reference that it shares most with.
fn quality(order: &[usize], references: usize, between: &dyn Fn(usize, usize) -> f64) -> [f64; 2] {
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    let with_first = order[1..].iter().map(|&b| between(order[0], b)).collect();
    let (references, rest) = order.split_at(references);
    let best = |&b: &usize| {
        references
            .iter()
            .map(|&a| between(a, b))
            .fold(0.0, f64::max)
    };
    [mean(with_first), mean(rest.iter().map(best).collect())]
}

/// Numbers from 0 in one of many orders.
fn shuffled(count: usize, shuffle: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    // Any scattered numbers will do.
    order.sort_by_key(|&k| (k + 1) * (2 * shuffle + 7919) * 7_368_787 % 1_000_003);
    order
}

#[test]
fn overlap_finds_better_references_than_chance() {
    const SEEDS: [u64; 3] = [1, 2, 3];
    const SHUFFLES: usize = 20;
    let (mut auto, mut chance) = ([0.0; 2], [0.0; 2]);
    for seed in SEEDS {
        let (cameras, views) = walk_through(seed);
        let between = |a, b| {
            let there = seen_again(&cameras, &views, a, b);
            (there + seen_again(&cameras, &views, b, a)) / 2.0
        };
        let truth: Vec<f64> = (0..PHOTOS * PHOTOS)
            .map(|pair| between(pair / PHOTOS, pair % PHOTOS))
            .collect();
        let between = |a: usize, b: usize| truth[a * PHOTOS + b];
        let pictures: Vec<RgbImage> = views.iter().map(|view| view.colour.clone()).collect();
        let order = view_order(OrderChoice::Auto, &pictures, 4);
        let add = |sums: &mut [f64; 2], order: &[usize], weight: f64| {
            let quality = quality(order, 4, &between);
            sums.iter_mut()
                .zip(quality)
                .for_each(|(sum, q)| *sum += q * weight);
        };
        add(&mut auto, &order, 1.0);
        for shuffle in 0..SHUFFLES {
            add(
                &mut chance,
                &shuffled(PHOTOS, shuffle),
                1.0 / SHUFFLES as f64,
            );
        }
    }
    assert!(
        auto[0] >= chance[0],
        "first view: {auto:?}, by chance {chance:?}"
    );
    assert!(
        auto[1] > 1.05 * chance[1],
        "references: {auto:?}, by chance {chance:?}"
    );
}

#[test]
fn the_order_of_the_files_does_not_matter() {
    let (_, views) = walk_through(5);
    let pictures: Vec<RgbImage> = views.into_iter().map(|view| view.colour).collect();
    let order = view_order(OrderChoice::Auto, &pictures, 4);
    for shuffle in 0..3 {
        let files = shuffled(PHOTOS, shuffle);
        let given: Vec<RgbImage> = files.iter().map(|&k| pictures[k].clone()).collect();
        let again = view_order(OrderChoice::Auto, &given, 4);
        let again: Vec<usize> = again.into_iter().map(|k| files[k]).collect();
        assert_eq!(again, order);
    }
}

#[test]
fn references_cover_and_the_rest_follows_what_it_overlaps() {
    // Two groups, 0 1 2 around 1 and 3 4 around 3, that share nothing.
    let pairs = [[0, 1], [1, 2], [3, 4]];
    let overlaps = Overlaps::from_pairs(5, &pairs, &[0.5, 0.5, 0.7]);
    // By way of 1, 0 and 2 share 0.8 * 0.25.
    assert!((overlaps.between(0, 2) - 0.2).abs() < 1e-6);
    assert_eq!(overlaps.between(0, 3), 0.0);
    assert_eq!(order_by_overlap(&overlaps, 2), [1, 3, 4, 0, 2]);
    assert_eq!(order_by_overlap(&overlaps, 1), [1, 0, 2, 3, 4]);
}

#[test]
fn pictures_without_a_corner_keep_their_order() {
    let flat = |value| RgbImage::from_pixel(64, 48, Rgb([value; 3]));
    let pictures: Vec<_> = [3, 1, 2].map(flat).into();
    assert_eq!(view_order(OrderChoice::Auto, &pictures, 4), [0, 1, 2]);
    let tiny = vec![RgbImage::new(1, 1), RgbImage::new(16, 16)];
    assert_eq!(view_order(OrderChoice::Auto, &tiny, 1), [0, 1]);
    for choice in [OrderChoice::Auto, OrderChoice::Spread, OrderChoice::File] {
        assert!(view_order(choice, &[], 4).is_empty());
        assert_eq!(view_order(choice, &tiny[..1], 4), [0]);
    }
}

#[test]
fn every_order_has_every_picture() {
    for count in 0..40 {
        let mut order = spread_order(count);
        order.sort_unstable();
        assert!(order.into_iter().eq(0..count));
    }
}
