use crate::{Place, instances::names, recording};
use serde_json::json;

/// Number of points, and their middle and mean colour, of an instance of the edited cloud.
pub(crate) fn exported(place: &Place, instance: &str) -> (usize, [f64; 3], [f64; 3]) {
    place.run(&format!("export scene -o only.ply --only {instance}"));
    let points = crate::export::read(&place.path("only.ply"));
    let mean = |of: &dyn Fn(&crate::export::PlyPoint) -> f64| {
        points.iter().map(of).sum::<f64>() / points.len() as f64
    };
    (
        points.len(),
        std::array::from_fn(|axis| mean(&|point| point.position[axis])),
        std::array::from_fn(|channel| mean(&|point| point.colour[channel])),
    )
}

#[test]
fn instances_go_by_id_or_name() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    assert_eq!(names(&place).len(), 5);
    place.run(&format!("instances rename scene {red} Pouf"));
    place.run("edit scene remove pouf");
    assert!(names(&place).iter().all(|(id, _)| *id != red));
    let message = place.fail("edit scene remove pouf");
    assert!(message.contains("no instance 'pouf'") && message.contains(&blue.to_string()));

    let list = place.run("edit scene list");
    let wanted = format!("edit 1: instance {red} is called 'Pouf'\nedit 2: remove {red}\n");
    assert_eq!(list, wanted);
}

#[test]
fn undo_redo_and_clear_walk_the_list() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    let unedited = place.files("scene");
    assert_eq!(place.run("edit scene list"), "no edits\n");
    assert!(place.fail("edit scene undo").contains("nothing to undo"));
    assert!(
        place
            .fail("edit scene redo")
            .contains("nothing to do again")
    );
    place.run(&format!("edit scene remove {red}"));
    place.run(&format!("edit scene recolour {blue} --to #00ff00"));
    let edited = place.files("scene");
    assert_eq!(
        place.json("edit scene list --json")["edits"],
        json!([
            {"edit": "remove", "instances": [red]},
            {"edit": "recolour", "instances": [blue], "change": {"to": {"colour": "#00ff00"}}},
        ])
    );
    assert!(place.run("edit scene undo").starts_with("undone: recolour"));
    let said = place.run("edit scene list");
    assert!(said.contains("1 undone, which `redo` does again"), "{said}");
    assert!(
        place
            .run("edit scene redo")
            .starts_with("done again: recolour")
    );
    assert_eq!(place.files("scene"), edited);
    place.run("edit scene undo");
    place.run("edit scene undo");
    place.run("edit scene clear");
    let mut cleared = place.files("scene");
    cleared.remove("edits.json");
    assert_eq!(cleared, unedited, "nothing was ever lost");
}

#[test]
fn keeping_some_removes_all_others() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    place.run(&format!("edit scene keep-only {red} {blue}"));
    let kept: Vec<u64> = names(&place).into_iter().map(|(id, _)| id).collect();
    assert_eq!(kept, [red.min(blue), red.max(blue)]);
    let said = place.run("export scene -o all.ply");
    let (points, ..) = exported(&place, &format!("{red},{blue}"));
    assert_eq!(said.trim(), format!("all.ply: {points} points"));
}

#[test]
fn moves_are_in_the_axes_of_the_floor() {
    let place = Place::with_scene();
    let [red, _] = place.boxes();
    let (points, [x, y, z], _) = exported(&place, &red.to_string());
    // Right, ahead and up as the first photo looks; it is turned by 0.15 about the vertical.
    place.run(&format!("edit scene move {red} --by 0.2,-0.1,0.5"));
    let (moved, [x2, y2, z2], _) = exported(&place, &red.to_string());
    assert_eq!(points, moved);
    let (s, c) = 0.15_f64.sin_cos();
    let wanted = [0.2 * c - 0.1 * s, -0.5, -0.2 * s - 0.1 * c];
    for (found, wanted) in [x2 - x, y2 - y, z2 - z].iter().zip(wanted) {
        assert!((found - wanted).abs() < 0.02, "{found} for {wanted}");
    }

    place.run("edit scene clear");
    place.run(&format!(
        "edit scene move {red} --to 0,2 --turn 90 --scale 0.5"
    ));
    let (_, [x2, y2, z2], _) = exported(&place, &red.to_string());
    // The floor's origin is under the first camera, which stands at (-0.45, -1.2).
    let off = ((x2 + 0.45 - 2.0 * s).powi(2) + (z2 + 1.2 - 2.0 * c).powi(2)).sqrt();
    assert!(
        off < 0.35,
        "the middle of what is seen of the box is {off} off"
    );
    assert!(y2 > y, "the smaller box stands on the floor");
}

#[test]
fn a_copy_is_an_instance_of_its_own() {
    let place = Place::with_scene();
    let [red, _] = place.boxes();
    let (points, [x, ..], _) = exported(&place, &red.to_string());
    place.run(&format!("instances rename scene {red} pouf"));
    place.run("edit scene duplicate pouf --by 1,0,0");
    let copy = names(&place).pop().unwrap();
    assert_eq!(copy, (6, "pouf (copy 1)".into()));
    let (copied, [x2, ..], _) = exported(&place, "6");
    assert_eq!(points, copied);
    assert!((x2 - x - 0.15_f64.cos()).abs() < 0.02);
    place.run("edit scene remove pouf");
    assert_eq!(exported(&place, "6").0, points, "the copy stays");
    place.run("edit scene duplicate 6 --by 0,1,0");
    assert_eq!(names(&place).pop().unwrap().0, 7);
}

#[test]
fn colours_change_where_they_should() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    let (_, _, before) = exported(&place, &blue.to_string());
    place.run(&format!("edit scene recolour {red} --to #20a040"));
    let (_, _, [r, g, b]) = exported(&place, &red.to_string());
    assert!(g > r + 50.0 && g > b + 50.0, "{r} {g} {b}");
    assert_eq!(exported(&place, &blue.to_string()).2, before);
    place.run(&format!("edit scene recolour {blue} --hue 120 --value 0.5"));
    let (_, _, [r, g, b]) = exported(&place, &blue.to_string());
    assert!(r > g && r > b && r < before[2], "{r} {g} {b}");
    let message = place.fail(&format!("edit scene recolour {red}"));
    assert!(message.contains("--to"), "{message}");
}

#[test]
fn restyled_photos_give_all_colours() {
    let place = Place::with_scene();
    std::fs::create_dir(place.path("grey")).unwrap();
    let style = |k: usize| format!("grey/frame-{k:06}.png");
    for k in 0..recording::PHOTOS {
        let grey = image::DynamicImage::from(recording::photo(k)).into_luma8();
        grey.save(place.path(&style(k))).unwrap();
    }
    place.run("edit scene restyle grey");
    let [red, _] = place.boxes();
    let (_, _, [r, g, b]) = exported(&place, &red.to_string());
    assert!(r == g && g == b, "{r} {g} {b}");
    place.run("render scene --at frame-000003");
    let view = image::open(place.path("scene/views/frame-000003.png")).unwrap();
    assert!(
        view.into_rgb8()
            .pixels()
            .all(|p| p[0] == p[1] && p[1] == p[2])
    );

    let before = place.files("scene");
    std::fs::remove_file(place.path(&style(3))).unwrap();
    let message = place.fail("edit scene restyle grey");
    assert!(message.contains("add frame-000003.png"), "{message}");
    image::RgbImage::new(20, 20)
        .save(place.path(&style(3)))
        .unwrap();
    let message = place.fail("edit scene restyle grey");
    assert!(message.contains("20x20 where 64x48"), "{message}");
    assert_eq!(place.files("scene"), before);
}

#[test]
fn impossible_moves_are_refused_and_change_nothing() {
    let place = Place::with_scene();
    let before = place.files("scene");
    for (target, part) in [
        ("--by 1e300,0,0", "a million"),
        ("--to 0,-2e6", "a million"),
        ("--scale 1e30", "from 0.001 to 1000"),
        ("--scale 1e-30", "from 0.001 to 1000"),
        ("", "required"),
    ] {
        let output = place.output(&format!("edit scene move 1 {target}"));
        assert_eq!(output.status.code(), Some(2), "{target}");
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(message.contains(part), "{message}");
    }
    assert_eq!(place.files("scene"), before);
    place.run("edit scene move 1 --by 1e6,-1e6,1e6 --scale 1000");
    place.run("render scene");
}

#[test]
fn a_scene_without_instances_cannot_be_edited() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    let message = place.fail("edit scene list");
    assert!(message.contains("run `tid3r segment scene`"), "{message}");
}
