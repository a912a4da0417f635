//! What was written, read back.

mod reading;

use super::{
    stream::{CHECKSUM_SEED, MAGIC, ROW_ID, kind, write},
    *,
};
use arrow_array::{
    Array,
    cast::AsArray,
    types::{Float32Type, UInt16Type, UInt32Type, UInt64Type},
};
use arrow_ipc::reader::StreamReader;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use reading::{bytes, fields, floats, messages, number, table, tables, values};
use sha2::{Digest, Sha256};
use std::io::Cursor;
use twox_hash::XxHash32;

fn written(rrd: &Rrd) -> Vec<u8> {
    let mut file = Vec::new();
    write(&mut file, rrd).unwrap();
    file
}

fn rrd() -> Rrd {
    let entity = |path: &[&str], contents| Entity {
        path: path.iter().map(|&part| part.into()).collect(),
        contents,
    };
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let pose = Pose::from_parts(Translation3::new(1.0, 2.0, 3.0), turn);
    let class = |id, label: &str, colour| Class {
        id,
        label: label.into(),
        colour,
    };
    let lens = Intrinsics {
        width: 6,
        height: 4,
        fx: 5.0,
        fy: 4.5,
        cx: 2.5,
        cy: 1.5,
    };
    let points = Archetype::Points {
        positions: vec![[0.5, 1.5, -2.0], [3.0, 4.0, 5.0]],
        colours: vec![[1, 2, 3], [255, 0, 128]],
        radii: vec![0.01, 0.02],
        class: 7,
    };
    let picture = Archetype::Picture {
        file: b"\xff\xd8 a photo".to_vec(),
        media_type: "image/jpeg",
    };
    let depth = Archetype::Depth(Map::from_fn(3, 2, |x, y| x as f32 + 10.0 * y as f32));
    let classes = vec![
        class(0, "none", [128; 3]),
        class(7, "old chair", [10, 20, 30]),
    ];
    Rrd {
        id: "an id".into(),
        name: "my room".into(),
        entities: vec![
            entity(&[], vec![Archetype::ZUp]),
            entity(
                &["scene"],
                vec![Archetype::Transform(pose), Archetype::Classes(classes)],
            ),
            entity(&["scene", "old chair"], vec![points]),
            entity(&["photo"], vec![Archetype::Pinhole(lens), picture]),
            entity(&["depth"], vec![depth]),
        ],
    }
}

#[test]
fn components_are_what_was_given() {
    let tables = tables(&written(&rrd()));
    let paths: Vec<&str> = tables.keys().map(String::as_str).collect();
    assert_eq!(
        paths,
        [
            "/",
            "/__properties",
            "/depth",
            "/photo",
            "/scene",
            "/scene/old\\ chair"
        ]
    );

    let name = values(&tables["/__properties"], "RecordingInfo:name", "Name");
    assert_eq!(name.as_string::<i32>().value(0), "my room");
    let axes = values(&tables["/"], "ViewCoordinates:xyz", "ViewCoordinates");
    assert_eq!(
        bytes(axes.as_fixed_size_list().values()),
        [3, 5, 1],
        "right, forward, up"
    );

    let points = &tables["/scene/old\\ chair"];
    let positions = floats(points, "Points3D:positions", "Position3D");
    assert_eq!(positions, [0.5, 1.5, -2.0, 3.0, 4.0, 5.0]);
    let colours = values(points, "Points3D:colors", "Color");
    let colours = colours.as_primitive::<UInt32Type>().values();
    assert_eq!(colours[..], [0x0102_03ff, 0xff00_80ff]);
    let radii = values(points, "Points3D:radii", "Radius");
    assert_eq!(
        radii.as_primitive::<Float32Type>().values()[..],
        [0.01, 0.02]
    );
    let labels = values(points, "Points3D:show_labels", "ShowLabels");
    assert!(!labels.as_boolean().value(0));
    let class = values(points, "Points3D:class_ids", "ClassId");
    assert_eq!(class.as_primitive::<UInt16Type>().values()[..], [7]);

    let scene = &tables["/scene"];
    assert_eq!(
        floats(scene, "Transform3D:translation", "Translation3D"),
        [1.0, 2.0, 3.0]
    );
    let half = std::f32::consts::FRAC_1_SQRT_2;
    assert_eq!(
        floats(scene, "Transform3D:quaternion", "RotationQuat"),
        [0.0, 0.0, half, half]
    );

    let photo = &tables["/photo"];
    let lens = floats(photo, "Pinhole:image_from_camera", "PinholeProjection");
    assert_eq!(
        lens,
        [5.0, 0.0, 0.0, 0.0, 4.5, 0.0, 3.0, 2.0, 1.0],
        "columns first"
    );
    assert_eq!(
        floats(photo, "Pinhole:resolution", "Resolution"),
        [6.0, 4.0]
    );
    let axes = values(photo, "Pinhole:camera_xyz", "ViewCoordinates");
    assert_eq!(
        bytes(axes.as_fixed_size_list().values()),
        [3, 2, 5],
        "right, down, forward"
    );
    let file = values(photo, "EncodedImage:blob", "Blob");
    assert_eq!(bytes(&file.as_list::<i32>().value(0)), b"\xff\xd8 a photo");
    let kind = values(photo, "EncodedImage:media_type", "MediaType");
    assert_eq!(kind.as_string::<i32>().value(0), "image/jpeg");
}

#[test]
fn classes_have_names_and_colours() {
    let tables = tables(&written(&rrd()));
    let context = values(
        &tables["/scene"],
        "AnnotationContext:context",
        "AnnotationContext",
    );
    let pairs = context.as_list::<i32>().value(0);
    let pairs = pairs.as_struct();
    let description = pairs
        .column_by_name("class_description")
        .unwrap()
        .as_struct();
    let info = description.column_by_name("info").unwrap().as_struct();
    for (of, name) in [(pairs, "class_id"), (info, "id")] {
        let ids = of.column_by_name(name).unwrap();
        assert_eq!(ids.as_primitive::<UInt16Type>().values()[..], [0, 7]);
    }
    let labels = info.column_by_name("label").unwrap().as_string::<i32>();
    assert_eq!([labels.value(0), labels.value(1)], ["none", "old chair"]);
    let colours = info
        .column_by_name("color")
        .unwrap()
        .as_primitive::<UInt32Type>();
    assert_eq!(colours.values()[..], [0x8080_80ff, 0x0a14_1eff]);
    for name in ["keypoint_annotations", "keypoint_connections"] {
        let lists = description.column_by_name(name).unwrap().as_list::<i32>();
        assert!(lists.len() == 2 && lists.values().is_empty());
    }
}

#[test]
fn depth_is_in_rows_of_floats() {
    let tables = tables(&written(&rrd()));
    let depth = &tables["/depth"];
    let pixels = values(depth, "DepthImage:buffer", "ImageBuffer");
    let pixels = bytes(&pixels.as_list::<i32>().value(0));
    let pixels = pixels
        .as_chunks::<4>()
        .0
        .iter()
        .map(|z| f32::from_le_bytes(*z));
    assert_eq!(
        pixels.collect::<Vec<_>>(),
        [0.0, 1.0, 2.0, 10.0, 11.0, 12.0]
    );
    let format = values(depth, "DepthImage:format", "ImageFormat");
    let format = format.as_struct();
    let side = |name| {
        format
            .column_by_name(name)
            .unwrap()
            .as_primitive::<UInt32Type>()
            .value(0)
    };
    assert_eq!((side("width"), side("height")), (3, 2));
    assert_eq!(
        bytes(format.column_by_name("channel_datatype").unwrap()),
        [34]
    );
    for name in ["pixel_format", "color_model"] {
        assert!(format.column_by_name(name).unwrap().is_null(0));
    }
    let metre = values(depth, "DepthImage:meter", "DepthMeter");
    assert_eq!(metre.as_primitive::<Float32Type>().values()[..], [1.0]);
}

#[test]
fn the_footer_says_where_tables_are() {
    let file = written(&rrd());
    let messages = messages(&file);
    assert_eq!(messages[0].0, kind::SET_STORE_INFO);
    let store = fields(&fields(&fields(messages[0].2)[&2])[&2]);
    assert_eq!((number(&store[&1]), &*store[&2]), (1, &b"an id"[..]));
    assert_eq!(fields(&store[&3])[&1], b"tid3r");

    let &(last, at, footer) = messages.last().unwrap();
    let frame = &file[at + footer.len()..];
    assert_eq!(
        (last, number(&frame[..8]), number(&frame[8..16])),
        (kind::END, at as u64, footer.len() as u64)
    );
    let checksum = XxHash32::oneshot(CHECKSUM_SEED, footer);
    assert_eq!(frame[16..20], checksum.to_le_bytes());
    assert_eq!(frame[20..], [&MAGIC[..], b"FOOT\x01\0\0\0"].concat());

    let manifest = fields(&fields(footer)[&1]);
    assert_eq!(fields(&manifest[&1]), store);
    let schema = &fields(&manifest[&2])[&1];
    assert_eq!(manifest[&3], Sha256::digest(schema).to_vec());
    let schema = StreamReader::try_new(Cursor::new(schema), None)
        .unwrap()
        .schema();
    let named =
        |name: &str| schema.field_with_name(name).unwrap().metadata()["rerun:entity_path"].clone();
    assert_eq!(
        named("/scene/old\\ chair:Points3D:colors"),
        "/scene/old\\ chair"
    );
    assert_eq!(named("property:RecordingInfo:name"), "/__properties");

    let index = table(&fields(&manifest[&4])[&2]);
    let counts = |name: &str| {
        index
            .column_by_name(name)
            .unwrap()
            .as_primitive::<UInt64Type>()
            .values()
            .to_vec()
    };
    let (starts, sizes) = (counts("chunk_byte_offset"), counts("chunk_byte_size"));
    let ids = index
        .column_by_name("chunk_id")
        .unwrap()
        .as_fixed_size_binary();
    let paths = index
        .column_by_name("chunk_entity_path")
        .unwrap()
        .as_string::<i32>();
    let mut rows = Vec::new();
    for (row, (_, at, message)) in messages[1..messages.len() - 1].iter().enumerate() {
        assert_eq!(
            (starts[row], sizes[row]),
            (*at as u64, message.len() as u64)
        );
        let fields = fields(message);
        let unpacked = number(&fields[&3]);
        assert_eq!(counts("chunk_byte_size_uncompressed")[row], unpacked);
        let table = table(&lz4_flex::block::decompress(&fields[&5], unpacked as usize).unwrap());
        let schema = table.schema();
        assert_eq!(schema.metadata()["rerun:entity_path"], paths.value(row));
        let id = u128::from_be_bytes(ids.value(row).try_into().unwrap());
        assert_eq!(
            schema.metadata()["rerun:id"].to_lowercase(),
            format!("chunk_{id:032x}")
        );
        for column in schema
            .fields()
            .iter()
            .filter(|field| field.name() != ROW_ID)
        {
            let has = format!("{}:has_static_data", column.name());
            assert!(
                index.column_by_name(&has).unwrap().as_boolean().value(row),
                "{has}"
            );
        }
        let row = table.column_by_name(ROW_ID).unwrap().as_fixed_size_binary();
        rows.push(row.value(0).to_vec());
    }
    assert_eq!(rows.len(), index.num_rows());
    assert!(rows.is_sorted_by(|a, b| a < b));
}

#[test]
fn the_same_contents_give_the_same_bytes() {
    assert_eq!(written(&rrd()), written(&rrd()));
}
