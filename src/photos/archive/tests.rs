use super::*;
use image::{ImageFormat, RgbImage};
use std::{fs, io::Cursor};
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

fn png(grey: u8) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let picture = RgbImage::from_pixel(8, 6, image::Rgb([grey; 3]));
    picture.write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// A ZIP file of these entries, packed and not by turns.
fn zipped(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (k, (name, content)) in entries.iter().enumerate() {
        let method = [CompressionMethod::Deflated, CompressionMethod::Stored][k % 2];
        let options = SimpleFileOptions::default().compression_method(method);
        zip.start_file(*name, options).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.add_symlink("link.png", "/etc/passwd", SimpleFileOptions::default())
        .unwrap();
    zip.finish().unwrap().into_inner()
}

/// The photos in a file of these bytes, called `room.zip`, and the warnings.
fn found(bytes: &[u8]) -> Result<(tempfile::TempDir, Vec<ZippedPhoto>, Vec<String>)> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.zip");
    fs::write(&path, bytes).unwrap();
    let mut warnings = Vec::new();
    let photos = photos_in(&path, &mut warnings)?;
    Ok((folder, photos, warnings))
}

fn problem(bytes: &[u8]) -> String {
    found(bytes).unwrap_err().to_string()
}

#[test]
fn photos_come_in_natural_order_and_what_is_none_is_left_out() {
    let picture = png(7);
    let (_folder, photos, warnings) = found(&zipped(&[
        ("trip/10.png", &picture),
        ("trip/9.PNG", &picture),
        ("no_ending", &picture),
        ("__MACOSX/trip/._9.png", &picture),
        ("trip/.hidden.png", &picture),
        (".thumbnails/1.png", &picture),
        ("film.mp4", b"\0\0\0\x18ftypmp42"),
    ]))
    .unwrap();
    let called: Vec<&str> = photos
        .iter()
        .map(|photo| photo.called.to_str().unwrap())
        .collect();
    assert_eq!(
        called,
        ["room/no_ending", "room/trip/9.PNG", "room/trip/10.png"]
    );
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].contains("film.mp4 left out"), "{warnings:?}");
}

#[test]
fn no_name_leads_out_of_the_folder() {
    let (picture, others) = (png(1), png(2));
    let (folder, photos, _) = found(&zipped(&[
        ("../../up.png", &picture),
        ("/etc/root.png", &others),
        ("C:\\windows\\disk.png", &picture),
        ("a/../../../b.png", &others),
    ]))
    .unwrap();
    assert_eq!(photos.len(), 4);
    for photo in &photos {
        assert!(photo.called.starts_with("room"), "{:?}", photo.called);
        let plain =
            |part: std::path::Component<'_>| matches!(part, std::path::Component::Normal(_));
        assert!(photo.called.components().all(plain), "{:?}", photo.called);
        let path = folder
            .path()
            .join("photos")
            .join(photo.called.file_name().unwrap());
        photo.unpack(path).unwrap();
    }
    assert_eq!(
        fs::read_dir(folder.path().join("photos")).unwrap().count(),
        4
    );
    assert_eq!(
        fs::read(folder.path().join("photos/b.png")).unwrap(),
        others
    );
}

#[test]
fn what_is_unpacked_already_stays_and_what_is_another_is_replaced() {
    let picture = png(3);
    let (folder, photos, _) = found(&zipped(&[("1.png", &picture)])).unwrap();
    let path = folder.path().join("photos/1.png");
    photos[0].unpack(path.clone()).unwrap();
    let written = || fs::metadata(&path).unwrap().modified().unwrap();
    let first = written();
    photos[0].unpack(path.clone()).unwrap();
    assert_eq!(written(), first);
    // As long, and different.
    let mut other = picture.clone();
    *other.last_mut().unwrap() ^= 1;
    fs::write(&path, other).unwrap();
    photos[0].unpack(path.clone()).unwrap();
    assert_eq!(fs::read(&path).unwrap(), picture);
}

#[test]
fn files_without_photos_and_no_zip_files_are_refused() {
    assert!(problem(&zipped(&[("a.txt", b"words")])).contains("holds no picture"));
    assert!(problem(b"PK\x03\x04 and no more").contains("no whole ZIP file"));
    assert!(problem(b"").contains("no whole ZIP file"));
}

/// The ZIP file of one photo of 1000 bytes, with 4 bytes changed that come `offset` after each header's start
/// (of the entry itself, of the list at the end).
fn with_field(offsets: [usize; 2], value: u32) -> Vec<u8> {
    let mut bytes = zipped(&[("1.png", &[7; 1000])]);
    for (signature, offset) in [b"PK\x03\x04", b"PK\x01\x02"].into_iter().zip(offsets) {
        let at = bytes
            .windows(4)
            .position(|window| window == signature)
            .unwrap()
            + offset;
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    bytes
}

#[test]
fn bombs_and_lies_about_sizes_are_found_out() {
    let size = |bytes| with_field([22, 24], bytes);
    assert!(problem(&size(3_000_000_000)).contains("larger unpacked"));
    for stated in [10, 2000] {
        let (folder, photos, _) = found(&size(stated)).unwrap();
        let path = folder.path().join("1.png");
        let message = photos[0].unpack(path.clone()).unwrap_err().to_string();
        assert!(
            message.contains("1.png, which cannot be unpacked"),
            "{message}"
        );
        assert!(!path.exists());
    }
    let names: Vec<String> = (0..=ENTRY_LIMIT).map(|k| format!("{k}.png")).collect();
    let many: Vec<(&str, &[u8])> = names
        .iter()
        .map(|name| (name.as_str(), &b"x"[..]))
        .collect();
    assert!(problem(&zipped(&many)).contains("holds 10002 files"));
}

#[test]
fn a_wrong_checksum_is_damage() {
    let (folder, photos, _) = found(&with_field([14, 16], 1)).unwrap();
    let message = photos[0]
        .unpack(folder.path().join("1.png"))
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("cannot be unpacked") && message.contains("room.zip"),
        "{message}"
    );
    assert!(!folder.path().join("1.png").exists());
}

#[test]
fn encrypted_files_are_refused() {
    let mut bytes = zipped(&[("1.png", &png(1))]);
    for (signature, offset) in [(b"PK\x03\x04", 6), (b"PK\x01\x02", 8)] {
        let at = bytes
            .windows(4)
            .position(|window| window == signature)
            .unwrap()
            + offset;
        bytes[at] |= 1;
    }
    assert!(problem(&bytes).contains("is encrypted (1.png)"));
}

#[test]
fn no_damage_makes_it_panic() {
    let whole = zipped(&[("a/1.png", &png(1)), ("2.png", &png(2))]);
    for at in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[at] ^= 0xff;
        for bytes in [&damaged[..], &whole[..at]] {
            if let Ok((folder, photos, _)) = found(bytes) {
                for (k, photo) in photos.iter().enumerate() {
                    let _ = photo.unpack(folder.path().join(format!("{k}.png")));
                }
            }
        }
    }
}
