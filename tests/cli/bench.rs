//! `tid3r bench` on the networks of See3D, and on single layers.

use crate::Place;
use serde_json::Value;

#[test]
fn networks_of_see3d_are_measured() {
    let place = Place::new();
    place.run("-q weights synthesize see3d --tiny -o models");
    let rows = |network: &str, options: &str| -> Vec<Value> {
        let of = format!("--model {network} --weights models/{network} --runs 1 --json {options}");
        let rows = place.json(&format!("-q bench {of}"));
        let rows = rows.as_array().unwrap().clone();
        for row in &rows {
            assert_eq!(row["model"], network);
            for figure in ["median_seconds", "gflops", "share_of_peak"] {
                assert!(row[figure].as_f64().unwrap() > 0.0, "{figure}");
            }
        }
        rows
    };
    let unet = rows("see3d-sparse", "--views 1,3 --size 128x64");
    assert_eq!(unet.len(), 2);
    assert_eq!(
        (&unet[0]["views"], &unet[1]["views"]),
        (&1.into(), &3.into())
    );
    assert_eq!(unet[0]["size"]["width"], 128);
    let vae = rows("see3d-vae", "--size 64");
    let parts: Vec<_> = vae.iter().map(|row| &row["part"]).collect();
    assert_eq!(parts, ["encode", "decode"]);
    assert_eq!(vae[0]["size"]["height"], 64);
    assert_eq!(vae[0]["dtype"], "f32");
    let image = rows("see3d-image-encoder", "--dtype bf16");
    assert_eq!(
        (&image[0]["size"]["width"], &image[0]["dtype"]),
        (&56.into(), &"bf16".into())
    );
    let text = rows("see3d-text-encoder", "");
    assert_eq!(
        (&text[0]["tokens"], text[0].get("size")),
        (&77.into(), None)
    );

    let table =
        place.run("-q bench --model see3d-vae --weights models/see3d-vae --size 32 --runs 1");
    assert!(table.contains("decode, 32x32"), "{table}");
    let message =
        place.fail("-q bench --model see3d-single --weights models/see3d-single --size 96");
    assert!(message.contains("multiples of 64"), "{message}");
    let message =
        place.fail("-q bench --model see3d-single --weights models/see3d-sparse --size 64");
    assert!(message.contains("holds weights of See3D"), "{message}");
}

#[test]
fn kernels_are_measured() {
    let place = Place::new();
    let rows = place.json("-q bench --kernels --runs 1 --json");
    let rows = rows.as_array().unwrap();
    assert!(rows.len() >= 12);
    for row in rows {
        for figure in ["milliseconds", "candle_milliseconds", "ratio", "floor"] {
            assert!(row[figure].as_f64().unwrap() > 0.0, "{row}");
        }
    }
    place.misuse("bench");
    place.misuse("bench --kernels --model mvdust3r");
    place.misuse("bench --kernels --size 64");
    place.misuse("bench --model mvdust3r --check");
}

#[test]
fn fewer_photos_than_a_network_sees_are_refused() {
    let place = Place::new();
    place.run("-q weights synthesize mvdust3r-plus --tiny -o models/plus");
    let problem =
        place.fail("bench --model mvdust3r-plus --weights models/plus --runs 1 --views 4,1");
    assert!(problem.contains("at least"), "{problem}");
    assert!(problem.contains("--views"), "{problem}");
}
