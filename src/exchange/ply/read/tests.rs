use super::*;
use proptest::prelude::*;

fn ascii(header: &str, rows: &str) -> Result<PlyCloud, String> {
    read(format!("ply\nformat ascii 1.0\n{header}end_header\n{rows}").as_bytes())
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

#[test]
fn what_is_not_known_is_skipped() {
    let header = format!(
        "comment scale metric\nelement camera 1\nproperty list uchar int ids\nproperty int k\n\
         element vertex 2\nproperty double t\nproperty list uchar float weights\n{XYZ}\
         property uchar red\nproperty uchar green\nproperty uchar blue\nproperty int instance\n\
         element face 1\nproperty list uchar int vertex_indices\n"
    );
    let rows = "2 7 8 9\n0.5 1 0.25 1 2 3 10 20 30 4\n0.5 0 -1 -2 -3 40 50 60 -1\n3 0 1 0";
    let cloud = ascii(&header, rows).unwrap();
    assert_eq!(cloud.positions, [[1.0, 2.0, 3.0], [-1.0, -2.0, -3.0]]);
    assert_eq!(cloud.colours.unwrap(), [[10, 20, 30], [40, 50, 60]]);
    assert_eq!(cloud.instances.unwrap(), [4, 0]);
    assert_eq!(cloud.comments, ["scale metric"]);
    assert!(cloud.normals.is_none() && cloud.confidences.is_none());
}

#[test]
fn colours_come_in_several_types() {
    let coloured = |kind: &str, colour: &str| {
        let rgb = ["red", "green", "blue"].map(|c| format!("property {kind} {c}\n"));
        let header = format!("element vertex 1\n{XYZ}{}", rgb.concat());
        ascii(&header, &format!("0 0 0 {colour}"))
            .unwrap()
            .colours
            .unwrap()[0]
    };
    assert_eq!(coloured("uchar", "0 128 255"), [0, 128, 255]);
    assert_eq!(coloured("float", "0 0.5 1"), [0, 128, 255]);
    assert_eq!(coloured("double", "0 128 255"), [0, 128, 255]);
    assert_eq!(coloured("ushort", "0 32896 65535"), [0, 128, 255]);
    assert_eq!(coloured("float", "-3 nan 1"), [0, 0, 255]);
}

#[test]
fn both_byte_orders_are_read() {
    for big in [false, true] {
        let order = if big { "big" } else { "little" };
        let mut bytes = format!(
            "ply\nformat binary_{order}_endian 1.0\nelement vertex 2\n{XYZ}\
             property float nx\nproperty float ny\nproperty float nz\n\
             property ushort confidence\nend_header\n"
        )
        .into_bytes();
        for number in [1.5_f32, 2.0, -3.0, 0.0, 0.0, 1.0] {
            bytes.extend(if big {
                number.to_be_bytes()
            } else {
                number.to_le_bytes()
            });
        }
        bytes.extend(if big {
            7_u16.to_be_bytes()
        } else {
            7_u16.to_le_bytes()
        });
        bytes.extend([0xff; 26]);
        let cloud = read(&bytes).unwrap();
        assert_eq!(cloud.positions, [[1.5, 2.0, -3.0]], "NaN is no position");
        assert_eq!(cloud.left_out, 1);
        assert_eq!(cloud.normals.unwrap(), [[0.0, 0.0, 1.0]]);
        assert_eq!(cloud.confidences.unwrap(), [7.0]);
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "{length}");
        }
    }
}

#[test]
fn counts_beyond_the_file_are_refused_before_anything_is_allocated() {
    let most = u64::MAX;
    for header in [
        format!("element vertex {most}\n{XYZ}"),
        format!("element other {most}\nelement vertex 1\n{XYZ}"),
        format!("element other {most}\nproperty list uchar int a\nelement vertex 1\n{XYZ}"),
        format!("element vertex 1\n{XYZ}property list uint float far\n"),
    ] {
        assert!(ascii(&header, "1 2 3 4000000000 5").is_err(), "{header}");
    }
}

#[test]
fn other_files_are_refused() {
    assert!(read(b"").is_err() && read(b"PK\x03\x04").is_err());
    let message = ascii("element face 0\nproperty int a\n", "").unwrap_err();
    assert!(message.contains("vertex"), "{message}");
    let message = ascii("element vertex 1\nproperty float x\n", "1 ").unwrap_err();
    assert!(message.contains("x, y and z"), "{message}");
    let message = ascii(&format!("element vertex 1\n{XYZ}"), "1 2 three").unwrap_err();
    assert!(message.contains("f32"), "{message}");
}

proptest! {
    #[test]
    fn no_bytes_make_the_reader_panic(
        kind in 0..3_usize, body in prop::collection::vec(any::<u8>(), 0..200), count in 0..9_usize,
    ) {
        let format = ["ascii", "binary_little_endian", "binary_big_endian"][kind];
        let header = format!(
            "ply\nformat {format} 1.0\nelement a {count}\nproperty list uchar short b\n\
             element vertex {count}\n{XYZ}property list int double c\nend_header\n"
        );
        for bytes in [[header.as_bytes(), &body].concat(), body] {
            if let Ok(cloud) = read(&bytes) {
                prop_assert!(cloud.positions.len() + cloud.left_out <= count);
            }
        }
    }
}
