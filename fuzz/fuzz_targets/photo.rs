//! Photos: PNG, JPEG, WebP, TIFF, PNM; and pictures of labels.
#![no_main]

use libfuzzer_sys::{Corpus, fuzz_target};
use std::{fs, sync::LazyLock};
use tid3r::{
    Map,
    geometry::{Camera, Intrinsics, Pose},
    photos::{Photo, PhotoTransform},
    scene::Frame,
    segment::LabelImages,
};
use tid3r_fuzz::{heard, place, put};

/// Of a photo of 16 x 12 pixels, half as large.
static FRAME: LazyLock<Frame> = LazyLock::new(|| {
    let intrinsics = Intrinsics {
        width: 8,
        height: 6,
        fx: 7.0,
        fy: 7.0,
        cx: 3.5,
        cy: 2.5,
    };
    Frame {
        photo: Photo::new("photo", "photo.png"),
        transform: PhotoTransform::whole([16, 12], [8, 6]),
        camera: Camera {
            intrinsics,
            cam_to_world: Pose::identity(),
        },
        colour: Default::default(),
        depth: Map::filled(8, 6, 1.0),
        confidence: Map::filled(8, 6, 1.0),
    }
});

/// The pictures of labels.
static LABELS: LazyLock<LabelImages> = LazyLock::new(|| {
    let folder = place().join("labels");
    fs::create_dir(&folder).expect("room for a folder");
    LabelImages::open(&folder).expect("a folder")
});

fuzz_target!(|data: &[u8]| -> Corpus {
    // HEIC has a target of its own.
    if data.get(4..8) == Some(b"ftyp") {
        return Corpus::Reject;
    }
    let photo = Photo::new("photo", put("photo", data));
    let size = photo.size();
    if let Some(picture) = heard(photo.load()) {
        assert_eq!(size.ok(), Some([picture.width(), picture.height()]));
    }
    let _ = photo.is_stored_upright();
    let _ = photo.exif_focal();
    let labels = &*LABELS;
    put("labels/photo.png", data);
    let _ = labels.labels(&FRAME);
    Corpus::Keep
});
