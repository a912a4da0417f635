use super::*;
use crate::{edit::Motions, exchange::recording::test_room::write_turned_png};
use image::{Rgb, RgbImage};

/// The classes of instances that are called so.
fn classes_of(names: &[(u32, &str)]) -> Result<Vec<Class>> {
    let contents = Contents {
        frames: vec![],
        cloud: Cloud::default(),
        motions: Motions::none(0),
        names: names.iter().map(|&(id, name)| (id, name.into())).collect(),
    };
    let ids = names.iter().map(|&(id, _)| id).chain([0]);
    classes(&contents, &ids.map(|id| (id, Cloud::default())).collect())
}

#[test]
fn each_instance_has_a_label_of_its_own() {
    let classes = classes_of(&[(2, "chair"), (3, "none"), (5, "chair"), (9, "Chair")]).unwrap();
    let found: Vec<(u16, &str)> = classes
        .iter()
        .map(|class| (class.id, &*class.label))
        .collect();
    let wanted = [
        (0, "none (0)"),
        (2, "chair (2)"),
        (3, "none (3)"),
        (5, "chair (5)"),
        (9, "Chair"),
    ];
    assert_eq!(found, wanted);
    assert_eq!(
        (classes[0].colour, classes[1].colour),
        ([128; 3], colour_of(2))
    );
    let message = classes_of(&[(65536, "chair")]).unwrap_err().to_string();
    assert!(
        message.contains("65536") && message.contains("--only"),
        "{message}"
    );
}

#[test]
fn photos_are_files_that_are_upright() {
    let folder = tempfile::tempdir().unwrap();
    let picture_of = |name: &str| match picture(&Photo::new("a", folder.path().join(name))).unwrap()
    {
        Archetype::Picture { file, media_type } => (file, media_type),
        other => panic!("{other:?}"),
    };
    let pixels = RgbImage::from_fn(6, 4, |x, y| Rgb([40 * x as u8, 60 * y as u8, 9]));
    for (name, kind) in [("a.png", "image/png"), ("a.jpg", "image/jpeg")] {
        pixels.save(folder.path().join(name)).unwrap();
        let file = fs::read(folder.path().join(name)).unwrap();
        assert_eq!(picture_of(name), (file, kind));
    }
    pixels.save(folder.path().join("a.ppm")).unwrap();
    write_turned_png(&folder.path().join("turned.png"), &pixels, 6);
    let turned = image::imageops::rotate90(&pixels);
    for (name, wanted) in [("a.ppm", &pixels), ("turned.png", &turned)] {
        let (file, kind) = picture_of(name);
        assert_eq!(
            (image::guess_format(&file).unwrap(), kind),
            (ImageFormat::Png, "image/png")
        );
        assert_eq!(
            image::load_from_memory(&file).unwrap().into_rgb8(),
            *wanted,
            "{name}"
        );
    }
}
