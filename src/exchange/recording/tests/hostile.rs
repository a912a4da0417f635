//! Files that are cut short, or made to do harm.

use super::*;

fn sens(folder: &TempDir) -> (std::path::PathBuf, Vec<u8>) {
    let path = folder.path().join("scene.sens");
    let options = SensOptions {
        colour: 1,
        depth: 1,
        lost: None,
    };
    Room::new(8, 6, 1).write_sens(&path, options);
    let bytes = fs::read(&path).unwrap();
    (path, bytes)
}

#[test]
fn a_sens_file_cut_short_anywhere_is_an_error() {
    let folder = folder();
    let (path, bytes) = sens(&folder);
    // Without the last eight bytes, nothing that is read is missing.
    for length in (0..bytes.len() - 8).step_by(7) {
        fs::write(&path, &bytes[..length]).unwrap();
        let message = complaint(&folder, &ImportOptions::default());
        assert!(message.contains("short"), "{length}: {message}");
    }
}

#[test]
fn a_sens_file_with_absurd_numbers_is_an_error() {
    let folder = folder();
    let (path, bytes) = sens(&folder);
    let (name, matrices) = (4, 4 + 8 + 4);
    let sizes = matrices + 4 * 64 + 8;
    let frames = sizes + 4 * 4 + 4;
    let colour_bytes = frames + 8 + 64 + 16;
    for (at, value, word) in [
        (0, &3_u32.to_le_bytes()[..], "version 4"),
        (name, &u64::MAX.to_le_bytes(), "name"),
        (matrices, &f32::NAN.to_le_bytes(), "finite"),
        (
            matrices + 64 + 12,
            &0.1_f32.to_le_bytes(),
            "stands elsewhere",
        ),
        (sizes - 8, &9_u32.to_le_bytes(), "unknown way"),
        (sizes - 4, &2_u32.to_le_bytes(), "does not know"),
        (sizes, &u32::MAX.to_le_bytes(), "pixels large"),
        (sizes + 12, &0_u32.to_le_bytes(), "pixels large"),
        (sizes + 16, &0_f32.to_le_bytes(), "in a metre"),
        (frames, &u64::MAX.to_le_bytes(), "too short"),
        (colour_bytes, &u64::MAX.to_le_bytes(), "cut short"),
        (colour_bytes + 8, &(u64::MAX / 2).to_le_bytes(), "cut short"),
        (sizes + 8, &9_u32.to_le_bytes(), "damaged depth"),
        (sizes, &9_u32.to_le_bytes(), "is not 9x6"),
    ] {
        let mut changed = bytes.clone();
        changed[at..at + value.len()].copy_from_slice(value);
        fs::write(&path, changed).unwrap();
        let message = complaint(&folder, &ImportOptions::default());
        assert!(message.contains(word), "{at}: {message}");
    }
}

#[test]
fn any_byte_of_a_sens_file_may_be_wrong() {
    let folder = folder();
    let (path, bytes) = sens(&folder);
    for at in (0..bytes.len()).step_by(3) {
        let mut changed = bytes.clone();
        changed[at] ^= 0xff;
        fs::write(&path, changed).unwrap();
        // Whatever it says, it says so.
        let _ = frames(&folder, &ImportOptions::default());
    }
}

#[test]
fn damaged_lists_and_cameras_name_the_line() {
    let lens = ImportOptions {
        intrinsics: "28.8,30.4,16.3,11.5".parse().ok(),
        ..ImportOptions::default()
    };
    for (file, content, word) in [
        ("rgb.txt", "10.0", "line 1"),
        ("depth.txt", "ten depth/10.png", "line 1"),
        (
            "groundtruth.txt",
            "# truth\n10 0 0 0 0 0 1",
            "line 2: has 7 numbers",
        ),
        ("groundtruth.txt", "10 0 0 0 0 0 0 2", "length 2"),
        ("rgb.txt", "", "no frame can be used"),
    ] {
        let folder = folder();
        small().write_tum(folder.path());
        fs::write(folder.path().join(file), content).unwrap();
        let message = complaint(&folder, &lens);
        assert!(message.contains(word), "{file}: {message}");
    }
    let default = ImportOptions::default();
    for (file, content, word) in [
        ("traj.txt", "1 0 0", "line 1: there are 3 numbers"),
        ("cam_params.json", "{}", "camera"),
        (
            "cam_params.json",
            r#"{"camera": {"w": 32, "h": 24, "fx": 28, "fy": 28, "cx": 16, "cy": 12, "scale": 0}}"#,
            "impossible scale",
        ),
    ] {
        let folder = folder();
        small().write_replica(folder.path());
        fs::write(folder.path().join(file), content).unwrap();
        let message = complaint(&folder, &default);
        assert!(message.contains(word), "{file}: {message}");
    }
    let folder = folder();
    small().write_scannet(folder.path());
    fs::write(folder.path().join("intrinsic/intrinsic_color.txt"), "1 2 3").unwrap();
    assert!(complaint(&folder, &default).contains("4x4 camera matrix"));
}

#[test]
fn a_depth_bin_that_ends_early_is_an_error() {
    use DepthBinPacking::{Deflate, Lz4, Together};
    for packing in [Lz4, Deflate, Together] {
        let folder = folder();
        Room::new(256, 192, 1).write_scannetpp_iphone(folder.path(), Some(packing));
        let path = folder.path().join("iphone/depth.bin");
        let bytes = fs::read(&path).unwrap();
        for length in [bytes.len() - 9, bytes.len() / 2, 3] {
            fs::write(&path, &bytes[..length]).unwrap();
            let message = complaint(&folder, &ImportOptions::default());
            assert!(message.contains("depth"), "{packing:?}: {message}");
        }
    }
}
