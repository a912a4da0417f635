use super::*;
use approx::assert_relative_eq;
use exif::{Field, In, Tag, Value, experimental::Writer};
use image::{
    ImageEncoder, Rgb,
    codecs::{jpeg::JpegEncoder, png::PngEncoder, webp::WebPEncoder},
};

#[test]
fn a_lens_goes_to_a_portrait_photo_and_back() {
    // 3000x4000 halved, then the middle 1000 of 2000 rows.
    let transform = PhotoTransform {
        photo_size: [3000, 4000],
        crop_origin: [0.0, 1000.0],
        crop_size: [3000.0, 2000.0],
        frame_size: [1500, 1000],
    };
    let of_frame = Intrinsics {
        width: 1500,
        height: 1000,
        fx: 1400.0,
        fy: 1410.0,
        cx: 749.5,
        cy: 499.5,
    };
    let of_photo = transform.intrinsics_of_photo(&of_frame);
    let want = Intrinsics {
        width: 3000,
        height: 4000,
        fx: 2800.0,
        fy: 2820.0,
        // The middle stays the middle.
        cx: 1499.5,
        cy: 1999.5,
    };
    assert_eq!(of_photo, want);
    assert_eq!(transform.intrinsics_of_frame(&of_photo), of_frame);
}

#[test]
fn a_point_has_the_same_image_by_either_lens() {
    let frame = NetworkFrame::new([1234, 777], 224, false).unwrap();
    let transform = frame.transform();
    let of_photo = Intrinsics {
        width: 1234,
        height: 777,
        fx: 900.0,
        fy: 901.0,
        cx: 610.0,
        cy: 391.0,
    };
    let point = [0.3, -0.2, 2.0].into();
    let in_frame = transform.intrinsics_of_frame(&of_photo).project(&point);
    let want = of_photo.project(&point).unwrap();
    let got = transform.to_photo(in_frame.unwrap());
    assert_relative_eq!(got[0], want[0], epsilon = 1e-9);
    assert_relative_eq!(got[1], want[1], epsilon = 1e-9);
}

/// EXIF data of a lens of 26 mm on film, and with this orientation.
fn exif(orientation: u16) -> Vec<u8> {
    let field = |tag, value| Field {
        tag,
        ifd_num: In::PRIMARY,
        value: Value::Short(vec![value]),
    };
    let fields = [
        field(Tag::Orientation, orientation),
        field(Tag::FocalLengthIn35mmFilm, 26),
    ];
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut bytes = Cursor::new(Vec::new());
    writer.write(&mut bytes, false).unwrap();
    bytes.into_inner()
}

/// Red rises with x, green with y; 64x48.
fn ramps() -> RgbImage {
    RgbImage::from_fn(64, 48, |x, y| Rgb([3 * x as u8, 4 * y as u8, 90]))
}

/// The ramps in a file of this format, with EXIF data.
fn encoded(format: ImageFormat, orientation: u16) -> Vec<u8> {
    fn write(mut encoder: impl ImageEncoder, exif: Vec<u8>) {
        encoder.set_exif_metadata(exif).unwrap();
        ramps().write_with_encoder(encoder).unwrap();
    }
    let (mut bytes, exif) = (Vec::new(), exif(orientation));
    match format {
        ImageFormat::Png => write(PngEncoder::new(&mut bytes), exif),
        ImageFormat::WebP => write(WebPEncoder::new_lossless(&mut bytes), exif),
        ImageFormat::Jpeg => write(JpegEncoder::new_with_quality(&mut bytes, 100), exif),
        // A TIFF file is EXIF data.
        _ => {
            let mut file = Cursor::new(Vec::new());
            ramps().write_to(&mut file, ImageFormat::Tiff).unwrap();
            bytes = file.into_inner();
        }
    }
    bytes
}

/// Checks a photo of the ramps by size, colours and focal length.
fn assert_is_turned(bytes: &[u8], orientation: u16, tolerance: u8) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo");
    fs::write(&path, bytes).unwrap();
    let photo = Photo::new("photo", &path);
    let upright = photo.load().unwrap();
    assert_eq!([upright.width(), upright.height()], photo.size().unwrap());
    assert_eq!(photo.is_stored_upright().unwrap(), orientation == 1);
    // Of the upright photo's pixel, the column and row in the file (EXIF 2.32, table 6).
    let in_file = |x: u32, y: u32| match orientation {
        1 => [x, y],
        3 => [63 - x, 47 - y],
        6 => [y, 47 - x],
        _ => [63 - y, x],
    };
    for (x, y) in [(5, 9), (40, 20), (30, 45)] {
        let [column, row] = in_file(x, y);
        let wanted = *ramps().get_pixel(column, row);
        let alike = |(a, b): (&u8, &u8)| a.abs_diff(*b) <= tolerance;
        let found = *upright.get_pixel(x, y);
        assert!(
            found.0.iter().zip(&wanted.0).all(alike),
            "{orientation}: {found:?} {wanted:?}"
        );
    }
    // The diagonal of 64x48 is 80.
    let focal = photo.exif_focal().unwrap();
    assert_relative_eq!(focal, 80.0 * 26.0 / 43.266_615, max_relative = 1e-6);
    let lens = KnownLens::Focal(focal)
        .on_photo(photo.size().unwrap())
        .unwrap();
    assert_eq!(
        [lens.width, lens.height],
        [upright.width(), upright.height()]
    );

    let stored = Photo {
        as_stored: true,
        ..photo
    };
    assert_eq!(stored.size().unwrap(), [64, 48]);
    assert_eq!(stored.load().unwrap().dimensions(), (64, 48));
    assert_relative_eq!(stored.exif_focal().unwrap(), focal);
}

#[test]
fn photos_of_all_formats_are_turned_and_know_their_lens() {
    for orientation in [1, 3, 6, 8] {
        assert_is_turned(&encoded(ImageFormat::Png, orientation), orientation, 0);
        assert_is_turned(&encoded(ImageFormat::WebP, orientation), orientation, 0);
        assert_is_turned(&encoded(ImageFormat::Jpeg, orientation), orientation, 6);
    }
}

#[test]
fn exif_data_behind_other_segments_count() {
    let file = encoded(ImageFormat::Jpeg, 6);
    // Adobe's XMP has the same marker.
    let xmp = b"http://ns.adobe.com/xap/1.0/\0<x:xmpmeta/>";
    let mut with_xmp = file[..2].to_vec();
    with_xmp.extend([0xff, 0xe1]);
    with_xmp.extend((xmp.len() as u16 + 2).to_be_bytes());
    with_xmp.extend(xmp);
    with_xmp.extend(&file[2..]);
    assert_is_turned(&with_xmp, 6, 6);
}

#[test]
fn tiff_and_webp_files_that_are_cut_short_are_errors() {
    for format in [ImageFormat::Tiff, ImageFormat::WebP] {
        let whole = encoded(format, 1);
        let path = Path::new("photo");
        assert_eq!(decode(whole.clone(), path, false).unwrap(), ramps());
        for length in (0..whole.len()).step_by(7) {
            assert!(
                decode(whole[..length].to_vec(), path, false).is_err(),
                "{format:?} {length}"
            );
        }
    }
}

#[test]
fn a_small_file_of_a_picture_that_fills_the_memory_is_refused() {
    // Of 32 bits, four of them: (tag, type, value) of each entry.
    let entries = [
        (256, 4, 16384_u32),
        (257, 4, 16384),
        (258, 3, 32),
        (259, 3, 1),
        (262, 3, 2),
        (273, 4, 300),
        (277, 3, 4),
        (278, 4, 16384),
        (279, 4, u32::MAX),
        (339, 3, 3),
    ];
    let mut tiff = b"II*\0\x08\0\0\0\x0a\0".to_vec();
    for (tag, kind, value) in entries {
        tiff.extend([tag, kind].map(u16::to_le_bytes).concat());
        tiff.extend([1, value].map(u32::to_le_bytes).concat());
    }
    tiff.resize(400, 0);
    for (file, says) in [
        (b"P6\n60000 60000\n255\n".to_vec(), "60000x60000 pixels are"),
        (
            b"P6\n16384 16384\n65535\n".to_vec(),
            "16384x16384 pixels of 6 bytes are",
        ),
        (tiff, "16384x16384 pixels of 16 bytes are"),
    ] {
        let problem = decode(file, Path::new("bomb"), false).unwrap_err();
        assert!(
            problem.to_string().contains(&format!("{says} too many")),
            "{problem}"
        );
    }
}
