use super::*;
use crate::{
    edit::{ColourChange, Hex},
    scene::test_frames::facing_wall,
};
use image::Rgb;

/// A wall whose left half is instance 1 and whose right quarter is instance 2.
fn edited(edits: &[Edit]) -> Edited {
    edited_from(
        |x| match x {
            0..16 => 1,
            24.. => 2,
            _ => 0,
        },
        |_, _| true,
        edits,
    )
}

/// A wall with instances by column, and points by column and row.
fn edited_from(instance: fn(u32) -> u32, is_valid: fn(u32, u32) -> bool, edits: &[Edit]) -> Edited {
    tried(instance, is_valid, edits).unwrap()
}

fn tried(
    instance: fn(u32) -> u32,
    is_valid: fn(u32, u32) -> bool,
    edits: &[Edit],
) -> Result<Edited> {
    let frames = [facing_wall(0.0, 4.0)];
    let validity = [Map::from_fn(32, 24, is_valid)];
    let instances = vec![Map::from_fn(32, 24, |x, _| instance(x))];
    let cloud = Cloud::from_frames(&frames, &validity, Some(&instances));
    let style = |name: &str| {
        if name == "red" {
            Ok(vec![RgbImage::from_pixel(32, 24, Rgb([255, 0, 0]))])
        } else {
            Err(Error::request("no such style", "choose another"))
        }
    };
    apply(cloud, &frames, instances, &Pose::identity(), edits, style)
}

/// Splits what is left of a column of the wall off instance 1, as instance 3.
fn split_off_left_of(column: u32) -> Edit {
    let wall = facing_wall(0.0, 4.0);
    let x = wall.point(wall.depth.index(column, 0)).unwrap().x - 1e-3;
    Edit::Split {
        instance: 1,
        by: SplitBy::Box {
            low: [-1e3; 3],
            high: [x, 1e3, 1e3],
        },
        parts: vec![3],
    }
}

/// The columns in which an instance has points.
fn columns(cloud: &Cloud, instance: u32) -> BTreeSet<u32> {
    let points = cloud.sources.iter().zip(&cloud.instances);
    points
        .filter(|&(_, &id)| id == instance)
        .map(|(source, _)| source.pixel % 32)
        .collect()
}

fn count(cloud: &Cloud, instance: u32) -> usize {
    cloud.instances.iter().filter(|&&id| id == instance).count()
}

fn shift(x: f64) -> Placement {
    Placement {
        by: [x, 0.0, 0.0],
        ..Placement::default()
    }
}

#[test]
fn nothing_changes_without_edits() {
    let scene = edited(&[]);
    assert_eq!(scene.cloud.len(), 32 * 24);
    assert!(scene.vacated.is_empty());
}

#[test]
fn removed_points_are_gone_and_known_to_be_gone() {
    let scene = edited(&[Edit::Remove { instances: vec![2] }]);
    let near = scene
        .cloud
        .sources
        .iter()
        .any(|source| source.pixel % 32 >= 24 - FRINGE);
    assert!(!near, "its outline is gone too");
    assert_eq!(
        (count(&scene.cloud, 1), count(&scene.cloud, 2)),
        (16 * 24, 0)
    );
    assert_eq!(
        (scene.vacated.len(), count(&scene.vacated, 2)),
        (8 * 24, 8 * 24)
    );
}

fn merge(instance: u32, others: &[u32]) -> Edit {
    Edit::Merge {
        instance,
        others: others.to_vec(),
        name: None,
    }
}

#[test]
fn merged_instances_are_as_if_they_had_been_found_as_one() {
    let remove = |id| Edit::Remove {
        instances: vec![id],
    };
    for [kept, other] in [[1, 2], [2, 1]] {
        let merged = edited(&[merge(kept, &[other]), remove(kept)]);
        let as_one = if kept == 1 {
            |x| u32::from(!(16..24).contains(&x))
        } else {
            |x| 2 * u32::from(!(16..24).contains(&x))
        };
        let found = edited_from(as_one, |_, _| true, &[remove(kept)]);
        assert_eq!(merged.cloud, found.cloud);
        assert_eq!(merged.vacated, found.vacated);
        assert_eq!(merged.instances, found.instances);
        assert_eq!(merged.vacated.len(), 24 * 24, "both are gone");
    }
}

#[test]
fn a_part_is_an_instance_of_its_own() {
    let split = split_off_left_of(8);
    let scene = edited(std::slice::from_ref(&split));
    assert_eq!(columns(&scene.cloud, 3), (0..8).collect());
    assert_eq!(columns(&scene.cloud, 1), (8..16).collect());
    assert!(scene.vacated.is_empty());

    let remove = |id| Edit::Remove {
        instances: vec![id],
    };
    let scene = edited(&[split.clone(), remove(3)]);
    assert_eq!(scene.vacated.len(), 8 * 24);
    // Its outline goes with it, as between instances that were found.
    assert_eq!(columns(&scene.cloud, 1), (8 + FRINGE..16).collect());

    let to = ColourChange::To {
        colour: Hex([0, 0, 200]),
    };
    let paint = Edit::Recolour {
        instances: vec![3],
        change: to,
    };
    let scene = edited(&[split.clone(), paint]);
    let blue = |x: u32| scene.photos[0].get_pixel(x, 12)[2] > 150;
    assert!(blue(7) && !blue(8), "in the photos too");

    let scene = edited(&[split.clone(), merge(2, &[3]), remove(2)]);
    assert_eq!(scene.vacated.len(), 16 * 24, "a part can be merged again");
    let scene = edited(&[split, merge(1, &[3])]);
    assert_eq!(scene.cloud, edited(&[]).cloud);
    assert_eq!(scene.instances, edited(&[]).instances);
}

#[test]
fn parts_are_looked_for_where_an_instance_was_moved_to() {
    let moved = Edit::Move {
        instance: 1,
        placement: shift(1e3),
    };
    let scene = edited(&[moved.clone(), split_off_left_of(8)]);
    assert_eq!(count(&scene.cloud, 3), 0);
    let scene = edited(&[split_off_left_of(8), moved]);
    assert_eq!(columns(&scene.vacated, 1), (8..16).collect());
}

#[test]
fn copies_of_copies_do_not_fill_the_memory() {
    let copy = Edit::Duplicate {
        instance: 1,
        copy: 3,
        placement: Placement::default(),
    };
    let doubled = vec![vec![copy, merge(1, &[3])]; 60];
    let all = |times: usize| tried(|_| 1, |_, _| true, &doubled[..times].concat());
    assert_eq!(count(&all(4).unwrap().cloud, 1), 16 * 32 * 24);
    let problem = all(60).unwrap_err().to_string();
    assert!(problem.contains("more than 16 times"), "{problem}");
}

#[test]
fn a_copy_is_split_without_the_photos() {
    let copy = Edit::Duplicate {
        instance: 1,
        copy: 3,
        placement: Placement::default(),
    };
    let Edit::Split { by, .. } = split_off_left_of(8) else {
        unreachable!()
    };
    let split = Edit::Split {
        instance: 3,
        by,
        parts: vec![4],
    };
    let scene = edited(&[copy, split]);
    assert_eq!(
        (count(&scene.cloud, 3), count(&scene.cloud, 4)),
        (8 * 24, 8 * 24)
    );
    assert_eq!(scene.instances, edited(&[]).instances);
}

#[test]
fn pixels_without_points_go_with_the_part_next_to_them() {
    // Columns 6 to 9 have points in the first row only; the part ends before column 8.
    let scene = edited_from(
        |x| u32::from(x < 16),
        |x, y| y == 0 || !(6..10).contains(&x),
        &[split_off_left_of(8)],
    );
    for y in 0..24 {
        for x in 0..16 {
            let wanted = if x < 8 { 3 } else { 1 };
            assert_eq!(scene.instances[0][(x, y)], wanted, "({x}, {y})");
        }
    }
}

#[test]
fn pixels_with_no_way_to_a_point_stay() {
    let mut map = Map::from_fn(5, 1, |x, _| if x == 2 { 0 } else { 1 });
    share_out(&mut map, 1, &[(0, 7)]);
    assert_eq!(map.values(), [7, 7, 0, 1, 1]);
}

#[test]
fn keep_only_drops_points_of_no_instance_too() {
    let scene = edited(&[Edit::KeepOnly { instances: vec![2] }]);
    assert_eq!((scene.cloud.len(), scene.vacated.len()), (8 * 24, 24 * 24));
}

#[test]
fn an_object_moved_there_and_back_has_vacated_nothing() {
    let there = Edit::Move {
        instance: 1,
        placement: shift(0.5),
    };
    let scene = edited(std::slice::from_ref(&there));
    assert_eq!(scene.vacated.len(), 16 * 24);
    assert!(
        scene.vacated.positions.iter().all(|p| p[0] < 0.0),
        "where it was"
    );
    let twice = edited(&[there.clone(), there.clone()]);
    assert_eq!(
        twice.vacated, scene.vacated,
        "places in between were never photographed"
    );
    let back = Edit::Move {
        instance: 1,
        placement: shift(-0.5),
    };
    assert!(edited(&[there, back]).vacated.is_empty());
}

#[test]
fn motions_lead_from_where_points_were_photographed() {
    let placed = |instance, turn_degrees, scale| Edit::Move {
        instance,
        placement: Placement {
            turn_degrees,
            scale,
            ..shift(0.5)
        },
    };
    let copy = Edit::Duplicate {
        instance: 1,
        copy: 3,
        placement: shift(2.0),
    };
    let remove = Edit::Remove { instances: vec![1] };
    let moves = [placed(1, 30.0, 2.0), copy, placed(2, -70.0, 0.5), remove];
    let scene = edited(&[&moves[..], &[merge(2, &[3]), placed(2, 10.0, 1.5)]].concat());
    let wall = facing_wall(0.0, 4.0);
    let scales = (0..scene.cloud.len()).map(|index| {
        let motion = scene.motions.of(index);
        let before = wall
            .point(scene.cloud.sources[index].pixel as usize)
            .unwrap();
        let distance = (motion.point(&before) - scene.cloud.point(index)).norm();
        assert!(distance < 1e-4, "{index}: {distance}");
        (motion.scale * 4.0).round() as i32
    });
    let scales: BTreeSet<i32> = scales.collect();
    assert_eq!(
        scales,
        [3, 4, 12].into(),
        "merged parts keep motions of their own"
    );
}

#[test]
fn copies_are_instances_of_their_own() {
    let copy = Edit::Duplicate {
        instance: 2,
        copy: 3,
        placement: shift(1.0),
    };
    let scene = edited(&[copy.clone(), Edit::Remove { instances: vec![2] }]);
    assert_eq!(
        (count(&scene.cloud, 2), count(&scene.cloud, 3)),
        (0, 8 * 24)
    );
    assert_eq!(scene.vacated.len(), 8 * 24);
    let scene = edited(&[copy, Edit::Remove { instances: vec![3] }]);
    assert!(scene.vacated.is_empty(), "a copy was never in the photos");
}

#[test]
fn colours_change_in_cloud_and_photos() {
    let to = ColourChange::To {
        colour: Hex([0, 0, 200]),
    };
    let scene = edited(&[Edit::Recolour {
        instances: vec![1],
        change: to,
    }]);
    let blue = |c: [u8; 3]| c[2] > 150 && c[0] < 60;
    for (colour, &id) in scene.cloud.colours.iter().zip(&scene.cloud.instances) {
        assert_eq!(blue(*colour), id == 1);
    }
    assert!(blue(scene.photos[0].get_pixel(0, 0).0) && !blue(scene.photos[0].get_pixel(31, 0).0));
    let restyled = edited(&[Edit::Restyle {
        style: "red".into(),
    }]);
    assert!(restyled.cloud.colours.iter().all(|&c| c == [255, 0, 0]));
    assert_eq!(restyled.photos[0].get_pixel(3, 3).0, [255, 0, 0]);
}

#[test]
fn a_missing_instance_changes_nothing() {
    let edits = [
        Edit::Remove {
            instances: vec![99],
        },
        Edit::Move {
            instance: 99,
            placement: shift(1.0),
        },
    ];
    assert_eq!(edited(&edits).cloud, edited(&[]).cloud);
}
