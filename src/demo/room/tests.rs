use super::*;
use crate::geometry::Point;
use std::collections::BTreeSet;

/// The camera with an image of 160 x 120.
fn small(camera: &Camera) -> Camera {
    Camera {
        intrinsics: camera.intrinsics.resized(160, 120),
        ..*camera
    }
}

/// A room with coarse light, which takes a fraction of the time.
fn quick_room(seed: u64) -> Room {
    let room = Room::furnish(seed);
    lit_quickly(room)
}

fn lit_quickly(room: Room) -> Room {
    let maps = room.light.bake(&room.scene, 0.4);
    room.light_maps.set(maps).unwrap();
    room
}

#[test]
fn furniture_stands_apart_on_what_carries_it() {
    for seed in 0..30 {
        let plan = layout::plan(&mut ChaCha8Rng::seed_from_u64(seed));
        let [hx, hy] = plan.shell.half;
        assert!((5.0..=6.5).contains(&(2.0 * hx)) && (4.5..=5.5).contains(&(2.0 * hy)));
        for (k, a) in plan.placed.iter().enumerate() {
            for b in &plan.placed[..k] {
                let overlap = a.piece.overlap(&b.piece);
                let (a, b) = (a.piece.name, b.piece.name);
                assert!(
                    overlap <= layout::TOUCHING,
                    "seed {seed}: {a} in {b} by {overlap} m"
                );
            }
            let (bounds, name) = (a.piece.bounds(), a.piece.name);
            let room = Bounds {
                min: Point::new(-hx, -hy, 0.0),
                max: Point::new(hx, hy, plan.shell.height),
            };
            let out = room.union(&bounds).size() - room.size();
            assert!(out.max() < 1e-9, "seed {seed}: {name} sticks out by {out}");
            let gap = match a.support {
                Support::Floor => bounds.min.z,
                // What carries the piece reaches up to it right below its middle.
                Support::Piece(below) => {
                    let carrier = plan.placed[below]
                        .piece
                        .parts
                        .iter()
                        .map(|part| part.bounds());
                    let middle = nalgebra::center(&bounds.min, &bounds.max);
                    let tops = carrier
                        .filter(|c| c.distance(&Point::new(middle.x, middle.y, c.min.z)) == 0.0)
                        .map(|c| c.max.z);
                    bounds.min.z - tops.fold(f64::NEG_INFINITY, f64::max)
                }
                Support::Wall => [
                    hx - bounds.max.x,
                    hx + bounds.min.x,
                    hy - bounds.max.y,
                    hy + bounds.min.y,
                ]
                .into_iter()
                .fold(f64::INFINITY, f64::min),
            };
            assert!(gap.abs() < 1e-6, "seed {seed}: {name} floats by {gap} m");
        }
    }
}

#[test]
fn objects_are_named_and_numbered() {
    let room = Room::furnish(1);
    assert!(room.objects().len() >= 10);
    assert!(
        room.objects()
            .iter()
            .map(|o| o.id)
            .eq(1..=room.objects().len() as u32)
    );
    let names: BTreeSet<_> = room.objects().iter().map(|o| o.name.as_str()).collect();
    assert_eq!(names.len(), room.objects().len());
    assert!(names.contains("sofa") && names.contains("chair 1") && names.contains("chair 2"));
    assert_eq!(Room::furnish(1).objects(), room.objects());
    assert_ne!(Room::furnish(2).objects(), room.objects());
}

#[test]
fn cameras_keep_clear_of_the_furniture() {
    for seed in 0..30 {
        let room = Room::furnish(seed);
        let (inputs, held_out) = room.cameras(DEFAULT_INPUTS, DEFAULT_HELD_OUT);
        assert_eq!((inputs.len(), held_out.len()), (12, 4));
        for camera in inputs.iter().chain(&held_out) {
            let centre = camera.centre();
            assert!((1.3..1.7).contains(&centre.z));
            for object in room.objects() {
                let distance = object.bounds.distance(&centre);
                let name = &object.name;
                assert!(
                    distance >= walk::CLEARANCE,
                    "seed {seed}: {distance} m from {name}"
                );
            }
        }
        for view in &held_out {
            let nearest = inputs.iter().map(|c| (c.centre() - view.centre()).norm());
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            assert!(
                (0.05..1.2).contains(&nearest),
                "seed {seed}: {nearest} m from the photos"
            );
        }
    }
}

#[test]
fn any_number_of_cameras_can_be_had() {
    let room = Room::furnish(0);
    for (inputs, held_out) in [(0, 0), (0, 2), (1, 0), (2, 9), (20, 8)] {
        let (a, b) = room.cameras(inputs, held_out);
        assert_eq!((a.len(), b.len()), (inputs, held_out));
    }
}

#[test]
fn every_object_is_in_two_photos_at_least() {
    for seed in 0..12 {
        let room = Room::furnish(seed);
        let (inputs, _) = room.cameras(DEFAULT_INPUTS, 0);
        let mut photos = vec![0; room.objects().len() + 1];
        for camera in &inputs {
            let ids = render::instances(&room.scene, &small(camera));
            for (id, photos) in photos.iter_mut().enumerate() {
                *photos += usize::from(ids.iter().filter(|i| **i == id as u32).count() >= 3);
            }
        }
        for object in room.objects() {
            let photos = photos[object.id as usize];
            assert!(
                photos >= 2,
                "seed {seed}: {} in {photos} photos",
                object.name
            );
        }
    }
}

#[test]
fn a_view_is_complete_and_repeatable() {
    let room = quick_room(3);
    let camera = small(&room.cameras(12, 0).0[0]);
    let view = room.render(&camera);
    assert_eq!(view, room.render(&camera));
    let last = SURFACES.len() as u32;
    for index in 0..view.depth.len() {
        let (x, y) = view.depth.pixel(index);
        let z = view.depth.values()[index];
        assert!(z.is_finite() && z > 0.2 && z < 9.0);
        let (object, surface) = (
            view.instances.values()[index],
            view.surfaces.values()[index],
        );
        assert_eq!(
            object == 0,
            (1..=last).contains(&surface),
            "pixel ({x}, {y})"
        );
        // The point lies on what the ids say: within the object's box, on the floor.
        let point = camera.unproject(f64::from(x), f64::from(y), f64::from(z));
        if object > 0 {
            let bounds = &room.objects()[object as usize - 1].bounds;
            assert!(bounds.distance(&point) < 1e-5);
        } else if surface == 1 {
            assert!(point.z.abs() < 1e-5);
        }
    }
    let levels: BTreeSet<_> = view.colour.pixels().map(|p| p.0[1]).collect();
    assert!(levels.len() > 100, "the photo has hardly any tones");
}

#[test]
fn photos_agree_where_they_see_the_same() {
    let room = quick_room(5);
    let (cameras, _) = room.cameras(12, 0);
    let (a, b) = (small(&cameras[0]), small(&cameras[1]));
    let (from, to) = (room.render(&a), room.render(&b));
    let (mut seen, mut alike) = (0, 0);
    for index in 0..from.depth.len() {
        let (x, y) = from.depth.pixel(index);
        let z = f64::from(from.depth.values()[index]);
        let point = a.unproject(f64::from(x), f64::from(y), z);
        let Some(([u, v], depth)) = b.project(&point) else {
            continue;
        };
        let Some(there) = to.depth.nearest(u, v) else {
            continue;
        };
        if (f64::from(to.depth.values()[there]) / depth - 1.0).abs() > 0.01 {
            continue;
        }
        seen += 1;
        let (tx, ty) = to.depth.pixel(there);
        let (p, q) = (from.colour.get_pixel(x, y), to.colour.get_pixel(tx, ty));
        alike += usize::from((0..3).all(|c| p.0[c].abs_diff(q.0[c]) < 30));
    }
    assert!(
        seen > 4000,
        "neighbouring photos share only {seen} of 19200 pixels"
    );
    assert!(
        alike as f64 > 0.85 * f64::from(seen),
        "{alike} of {seen} agree"
    );
}

#[test]
fn a_removed_object_leaves_nothing_behind() {
    let room = quick_room(4);
    let (inputs, held_out) = room.cameras(12, 4);
    let shown = room.showcase_object(&inputs, &held_out).unwrap().clone();
    assert!(room.objects().iter().all(|o| o.rests_on != Some(shown.id)));
    let without = lit_quickly(room.without(shown.id));
    assert_eq!(without.objects().len(), room.objects().len() - 1);
    assert!(
        without
            .objects()
            .iter()
            .all(|o| *o == room.objects()[o.id as usize - 1])
    );
    assert_eq!(without.cameras(12, 4), (inputs.clone(), held_out));
    let mut uncovered = 0;
    for camera in inputs.iter().step_by(3).map(small) {
        let (before, after) = (room.render(&camera), without.render(&camera));
        for index in 0..before.depth.len() {
            let (z, z_after) = (before.depth.values()[index], after.depth.values()[index]);
            let id_after = after.instances.values()[index];
            assert_ne!(id_after, shown.id);
            if before.instances.values()[index] == shown.id {
                uncovered += 1;
                assert!(z_after > z);
            } else {
                assert_eq!(z, z_after);
                assert_eq!(before.instances.values()[index], id_after);
            }
        }
    }
    assert!(uncovered > 100);
    assert_eq!(
        room.without(0).scene.solids().len(),
        room.scene.solids().len()
    );
}
