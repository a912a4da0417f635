//! Photos in ZIP files, as phones share them, and photos that cannot be read.

use crate::{Place, place::assert_same_files, recording, segment};
use exif::{Field, In, Tag, Value, experimental::Writer};
use image::{ImageEncoder, codecs::png::PngEncoder};
use std::{
    fs::{self, File},
    io::{Cursor, Write},
};
use zip::{ZipWriter, write::SimpleFileOptions};

/// The photos as files in `photos`, and as `photos.zip`, with a folder in it; tiny weights in `mvd`.
fn place() -> Place {
    let place = Place::new();
    fs::create_dir(place.path("photos")).unwrap();
    for (k, name) in ["a", "b", "c"].iter().enumerate() {
        let path = place.path(&format!("photos/{name}.png"));
        recording::photo(k).save(path).unwrap();
    }
    write_zip(
        &place,
        "photos.zip",
        &["a", "b", "c"].map(|name| (name, name)),
    );
    place.run_loud("weights synthesize mvdust3r --tiny -o mvd");
    place
}

/// A ZIP file of photos: what each is called there, and which one of `photos` it is.
fn write_zip(place: &Place, file: &str, photos: &[(&str, &str)]) {
    let mut zip = ZipWriter::new(File::create(place.path(file)).unwrap());
    let options = SimpleFileOptions::default();
    for (name, photo) in photos {
        zip.start_file(format!("shared/{name}.png"), options)
            .unwrap();
        let photo = fs::read(place.path(&format!("photos/{photo}.png"))).unwrap();
        zip.write_all(&photo).unwrap();
    }
    zip.start_file("__MACOSX/shared/._a.png", options).unwrap();
    zip.write_all(b"attributes").unwrap();
    zip.finish().unwrap();
}

#[test]
fn a_zip_file_is_as_good_as_a_folder_and_its_photos_go_where_the_scene_goes() {
    let place = place();
    place.run_loud("reconstruct photos -o from_folder --weights mvd --size 48");
    place.run_loud("reconstruct photos.zip -o from_zip --weights mvd --size 48");
    assert_same_files(&place.files("from_zip/photos"), &place.files("photos"));
    let [zip, folder] =
        ["from_zip", "from_folder"].map(|scene| place.files(&format!("{scene}/frames")));
    assert!(zip.keys().eq(folder.keys()));
    for name in ["a", "b", "c"] {
        let picture = format!("{name}/colour.png");
        assert_eq!(zip[&picture], folder[&picture]);
    }
    let times = place.times("from_zip");
    place.run("reconstruct photos.zip -o from_zip --weights mvd --size 48");
    assert_eq!(place.times("from_zip"), times, "nothing to do");

    fs::remove_file(place.path("photos.zip")).unwrap();
    fs::rename(place.path("from_zip"), place.path("moved")).unwrap();
    place.run_loud("clean moved");
    place.run("export moved -o exported/transforms.json");
    assert_same_files(&place.files("exported/images"), &place.files("photos"));
}

#[test]
fn a_run_that_was_stopped_goes_on_with_what_is_unpacked() {
    let place = place();
    place.run_loud("reconstruct photos.zip -o scene --weights mvd --size 48");
    let whole = place.files("scene");
    let times = place.times("scene/photos");
    fs::remove_file(place.path("scene/scene.json")).unwrap();
    fs::remove_file(place.path("scene/photos/b.png")).unwrap();
    place.run_loud("reconstruct photos.zip -o scene --weights mvd --size 48");
    assert_same_files(&place.files("scene"), &whole);
    assert_eq!(place.times("scene/photos")["a.png"], times["a.png"]);
}

#[test]
fn photos_of_a_scene_are_not_replaced_by_those_of_another_file() {
    let place = place();
    place.run_loud("reconstruct photos.zip -o scene --weights mvd --size 48");
    let before = place.files("scene");
    // The same names for other photos.
    write_zip(&place, "photos.zip", &[("a", "b"), ("b", "c"), ("c", "a")]);
    let message = place.fail("reconstruct photos.zip -o scene --weights mvd --size 48");
    assert!(message.contains("--force"), "{message}");
    assert_same_files(&place.files("scene"), &before);
    place.run_loud("reconstruct photos.zip -o scene --weights mvd --size 48 --force");
    assert_eq!(
        place.files("scene/photos")["a.png"],
        place.files("photos")["b.png"]
    );
}

#[test]
fn photos_of_several_files_have_names_of_their_own() {
    let place = place();
    write_zip(&place, "more.zip", &[("a", "b")]);
    place.run_loud("reconstruct photos.zip more.zip -o scene --weights mvd --size 48");
    // The folders within have one name: photos are counted.
    let files = place.files("scene/photos");
    assert_eq!(files.len(), 4);
    assert_eq!(files["1-shared-a.png.png"], place.files("photos")["a.png"]);
    assert_eq!(files["2-shared-a.png.png"], place.files("photos")["b.png"]);
    let message =
        place.fail("reconstruct photos.zip ./photos.zip -o other --weights mvd --size 48");
    assert!(message.contains("given twice"), "{message}");
}

#[test]
fn turned_photos_are_upright_and_know_their_lens() {
    let place = place();
    let field = |tag, value| Field {
        tag,
        ifd_num: In::PRIMARY,
        value: Value::Short(vec![value]),
    };
    // Held upright, and cut since: it then shows nobody knows which part of what the lens saw.
    let as_it_was = [
        field(Tag::Orientation, 6),
        field(Tag::FocalLengthIn35mmFilm, 26),
    ];
    let cut = [
        field(Tag::FocalLengthIn35mmFilm, 26),
        field(Tag::PixelXDimension, 4000),
        field(Tag::PixelYDimension, 2000),
    ];
    for (name, fields) in [("a", &as_it_was[..]), ("b", &cut[..])] {
        let mut writer = Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut exif = Cursor::new(Vec::new());
        writer.write(&mut exif, false).unwrap();
        let file = File::create(place.path(&format!("photos/{name}.png"))).unwrap();
        let mut encoder = PngEncoder::new(file);
        encoder.set_exif_metadata(exif.into_inner()).unwrap();
        recording::photo(0).write_with_encoder(encoder).unwrap();
    }
    write_zip(&place, "photos.zip", &[("a", "a"), ("b", "b")]);
    let [out, _] = place.run_loud(
        "reconstruct photos.zip -o scene --weights mvd --focal exif --order file --no-gaussians --json",
    );
    let report: serde_json::Value = serde_json::from_str(&out).unwrap();
    let placed = |k: usize| &report["photos"][k]["placed"];
    let lens = &placed(0)["intrinsics"];
    assert_eq!((&lens["width"], &lens["height"]), (&48.into(), &64.into()));
    // The diagonal of 64x48 is 80, that of film 43.27 mm.
    let focal = lens["fx"].as_f64().unwrap();
    assert!((focal - 80.0 * 26.0 / 43.2666).abs() < 1e-3, "{lens}");
    assert_eq!(placed(0)["focal"], "known");
    assert_ne!(placed(1)["focal"], "known");
    place.run_loud("clean scene");
    place.run("export scene -o colmap --format colmap");
    let copy = image::open(place.path("colmap/images/a.png")).unwrap();
    let upright = image::imageops::rotate90(&recording::photo(0));
    assert_eq!(copy.into_rgb8(), upright);
}

#[test]
fn masks_of_zipped_photos_need_no_scene() {
    let place = place();
    segment::add_weights(&place);
    place.run_loud(&format!(
        "segment --photo photos.zip -o out {}",
        segment::ALL
    ));
    assert_same_files(&place.files("out/unpacked_photos"), &place.files("photos"));
    assert!(place.path("out/a_masks/masks.json").is_file());
}

#[test]
fn files_of_no_use_say_what_to_do() {
    let place = place();
    place.write("damaged.zip", b"PK\x03\x04");
    let message = place.fail("reconstruct damaged.zip -o scene --weights mvd --size 48");
    assert!(message.contains("no whole ZIP file"), "{message}");
    let message = place.fail("import photos.zip -o scene");
    assert!(message.contains("unpack it"), "{message}");
    assert!(!place.path("scene").exists());
}

#[test]
#[cfg(not(feature = "heic"))]
fn heic_photos_are_known_for_what_they_are() {
    let place = place();
    let heic = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic";
    // Whatever they are called.
    for name in ["IMG_1.HEIC", "IMG_1.jpg"] {
        place.write(name, heic);
        let message = place.fail(&format!(
            "reconstruct {name} -o scene --weights mvd --size 48"
        ));
        assert!(
            message.contains("HEIC") && message.contains("Most Compatible"),
            "{message}"
        );
    }
    place.write("photos/IMG_1.HEIC", heic);
    let [_, err] = place.run_loud("reconstruct photos -o scene --weights mvd --size 48");
    assert!(err.contains("IMG_1.HEIC left out: HEIC; convert"), "{err}");
    fs::create_dir(place.path("heic")).unwrap();
    place.write("heic/IMG_1.HEIC", heic);
    let message = place.fail("reconstruct heic -o other --weights mvd --size 48");
    assert!(message.contains("heif-convert"), "{message}");
}
