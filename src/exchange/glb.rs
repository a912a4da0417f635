//! Clouds and cameras as binary glTF 2.0 (`.glb`).
//!
//! glTF has y up and metres; its cameras look along -z. Vertex colours are linear.

use super::transforms::other_axes;
use crate::{
    Result,
    geometry::{Camera, Pose},
    scene::files,
};
use palette::Srgb;
use serde_json::{Value, json};
use std::{
    io::{self, Write},
    path::Path,
};

/// What a file holds, all in one frame of any orientation.
#[derive(Clone, Debug, PartialEq)]
pub struct Glb {
    /// What the whole is called.
    pub name: String,
    /// Facts about the whole.
    pub extras: Value,
    /// From the frame of clouds and cameras to glTF's: y up.
    pub to_gltf: Pose,
    /// A node each. Those without points are left out.
    pub clouds: Vec<GlbCloud>,
    /// A node each, under its name.
    pub cameras: Vec<(String, Camera)>,
}

/// A cloud.
#[derive(Clone, Debug, PartialEq)]
pub struct GlbCloud {
    /// What it is called.
    pub name: String,
    /// Facts about it.
    pub extras: Value,
    /// Where its points are.
    pub positions: Vec<[f32; 3]>,
    /// Their colours, sRGB.
    pub colours: Vec<[u8; 3]>,
}

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const ARRAY_BUFFER: u32 = 34962;
const POINTS: u32 = 0;

/// Bytes of a position and of a colour.
const POSITION_SIZE: usize = 12;
const COLOUR_SIZE: usize = 8;

/// Nothing nearer to a camera is shown, in the file's units.
const NEAR: f64 = 0.01;

/// Writes a file. Colours become linear numbers of 16 bits, with which no shade of sRGB is lost. A camera's
/// principal point, which glTF has no place for, and its lens in pixels are in the node's extras.
///
/// # Errors
/// When there is more than the 4 GB that the format can hold, or writing fails.
pub fn write_glb(path: &Path, glb: &Glb) -> Result<()> {
    files::write_atomically(path, |out| write(out, glb))
}

fn write(out: &mut dyn Write, glb: &Glb) -> io::Result<()> {
    let clouds: Vec<&GlbCloud> = glb
        .clouds
        .iter()
        .filter(|c| !c.positions.is_empty())
        .collect();
    let size = |cloud: &&GlbCloud| cloud.positions.len() * (POSITION_SIZE + COLOUR_SIZE);
    let binary: usize = clouds.iter().map(size).sum();
    let mut text = description(glb, &clouds, binary).to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');

    let length = |length: usize| {
        u32::try_from(length).map_err(|_| io::Error::other("a .glb holds no more than 4 GB"))
    };
    let total = length(12 + 8 + text.len() + 8 + binary)?;
    out.write_all(b"glTF")?;
    for word in [2, total, length(text.len())?] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(b"JSON")?;
    out.write_all(&text)?;
    out.write_all(&length(binary)?.to_le_bytes())?;
    out.write_all(b"BIN\0")?;
    for cloud in clouds {
        for coordinate in cloud.positions.iter().flatten() {
            out.write_all(&coordinate.to_le_bytes())?;
        }
        for &colour in &cloud.colours {
            for channel in linear(colour) {
                out.write_all(&channel.to_le_bytes())?;
            }
        }
    }
    Ok(())
}

/// The colour in linear light, with full opacity.
fn linear(colour: [u8; 3]) -> [u16; 4] {
    let linear = Srgb::from(colour).into_format::<f64>().into_linear();
    let [r, g, b] = [linear.red, linear.green, linear.blue].map(|c| (c * 65535.0).round() as u16);
    [r, g, b, u16::MAX]
}

/// The JSON part.
fn description(glb: &Glb, clouds: &[&GlbCloud], binary: usize) -> Value {
    let (mut nodes, mut meshes) = (Vec::new(), Vec::new());
    let (mut accessors, mut views) = (Vec::new(), Vec::new());
    let mut offset = 0;
    for cloud in clouds {
        let count = cloud.positions.len();
        let mut view = |size: usize| {
            let length = count * size;
            views.push(json!({
                "buffer": 0, "byteOffset": offset, "byteLength": length, "target": ARRAY_BUFFER,
            }));
            offset += length;
            views.len() - 1
        };
        let (positions, colours) = (view(POSITION_SIZE), view(COLOUR_SIZE));
        let bound = |pick: fn(f32, f32) -> f32| {
            let all = cloud.positions.iter().copied();
            all.reduce(|a, b| std::array::from_fn(|axis| pick(a[axis], b[axis])))
        };
        accessors.push(json!({
            "bufferView": positions, "componentType": FLOAT, "type": "VEC3", "count": count,
            "min": bound(f32::min), "max": bound(f32::max),
        }));
        accessors.push(json!({
            "bufferView": colours, "componentType": UNSIGNED_SHORT, "normalized": true, "type": "VEC4",
            "count": count,
        }));
        let attributes = json!({ "POSITION": accessors.len() - 2, "COLOR_0": accessors.len() - 1 });
        nodes.push(json!({ "name": cloud.name, "mesh": meshes.len(), "extras": cloud.extras }));
        meshes.push(json!({
            "name": cloud.name, "primitives": [{ "attributes": attributes, "mode": POINTS }],
        }));
    }
    let mut cameras = Vec::new();
    for (name, camera) in &glb.cameras {
        nodes.push(json!({
            "name": name, "camera": cameras.len(), "matrix": columns(&(camera.cam_to_world * other_axes())),
            "extras": { "intrinsics": camera.intrinsics },
        }));
        cameras.push(perspective(name, camera));
    }
    let children: Vec<usize> = (1..=nodes.len()).collect();
    nodes.insert(
        0,
        json!({
            "name": glb.name, "extras": glb.extras, "matrix": columns(&glb.to_gltf), "children": children,
        }),
    );
    let mut gltf = json!({
        "asset": { "version": "2.0", "generator": concat!("tid3r ", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": nodes,
    });
    // Lists must not be empty.
    if !clouds.is_empty() {
        gltf["meshes"] = meshes.into();
        gltf["accessors"] = accessors.into();
        gltf["bufferViews"] = views.into();
        gltf["buffers"] = json!([{ "byteLength": binary }]);
    }
    if !cameras.is_empty() {
        gltf["cameras"] = cameras.into();
    }
    gltf
}

fn perspective(name: &str, camera: &Camera) -> Value {
    let lens = &camera.intrinsics;
    let (width, height) = (
        f64::from(lens.width) / lens.fx,
        f64::from(lens.height) / lens.fy,
    );
    json!({
        "name": name, "type": "perspective",
        "perspective": {
            "yfov": 2.0 * (height / 2.0).atan(), "aspectRatio": width / height, "znear": NEAR,
        },
    })
}

/// A pose as glTF writes matrices: columns first.
fn columns(pose: &Pose) -> Vec<f64> {
    pose.to_homogeneous().as_slice().to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Intrinsics;

    fn glb(points: usize) -> Glb {
        let cloud = |name: &str, points: usize| GlbCloud {
            name: name.into(),
            extras: json!({ "id": 7 }),
            positions: (0..points).map(|k| [k as f32, -1.5, 2.0]).collect(),
            colours: vec![[0, 188, 255]; points],
        };
        let camera = Camera {
            intrinsics: Intrinsics {
                width: 200,
                height: 100,
                fx: 50.0,
                fy: 50.0,
                cx: 99.5,
                cy: 49.5,
            },
            cam_to_world: Pose::translation(1.0, 2.0, 3.0),
        };
        Glb {
            name: "room".into(),
            extras: Value::Null,
            to_gltf: Pose::identity(),
            clouds: vec![cloud("none", 0), cloud("chair", points)],
            cameras: vec![("door".into(), camera)],
        }
    }

    /// The two parts of a file whose lengths are as they must be.
    fn parts(glb: &Glb) -> (Value, Vec<u8>) {
        let mut bytes = Vec::new();
        write(&mut bytes, glb).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(
            (&bytes[..4], word(4), word(8)),
            (&b"glTF"[..], 2, bytes.len())
        );
        let text = word(12);
        assert_eq!((&bytes[16..20], text % 4), (&b"JSON"[..], 0));
        let json = serde_json::from_slice(&bytes[20..20 + text]).unwrap();
        let binary = &bytes[20 + text..];
        assert_eq!(&binary[4..8], b"BIN\0");
        assert_eq!(word(20 + text), binary.len() - 8);
        (json, binary[8..].to_vec())
    }

    #[test]
    fn accessors_say_what_the_bytes_are() {
        let (json, bytes) = parts(&glb(3));
        assert_eq!(json["buffers"][0]["byteLength"], bytes.len());
        assert_eq!(
            json["nodes"].as_array().unwrap().len(),
            3,
            "an empty cloud is left out"
        );
        assert_eq!(json["nodes"][1]["extras"]["id"], 7);
        assert_eq!(json["nodes"][0]["children"], json!([1, 2]));
        assert_eq!(json["accessors"][0]["max"], json!([2.0, -1.5, 2.0]));
        let at = json["bufferViews"][1]["byteOffset"].as_u64().unwrap() as usize;
        let channel = |k: usize| u16::from_le_bytes(bytes[at + 2 * k..][..2].try_into().unwrap());
        // sRGB 188 is half of the light.
        assert_eq!((channel(0), channel(2), channel(3)), (0, 65535, 65535));
        assert!(channel(1).abs_diff(32768) < 400, "{}", channel(1));
    }

    #[test]
    fn cameras_look_along_minus_z_with_their_angle_of_view() {
        let (json, _) = parts(&glb(0));
        assert!(json.get("buffers").is_none() && json.get("meshes").is_none());
        let lens = &json["cameras"][0]["perspective"];
        assert_eq!(lens["aspectRatio"], 2.0);
        assert!((lens["yfov"].as_f64().unwrap() - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        let wanted = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 1, 2, 3, 1].map(f64::from);
        assert_eq!(json["nodes"][1]["matrix"], json!(wanted));
    }

    #[test]
    fn every_shade_stays_one_of_its_own() {
        let mut shades = (0..=255).map(|c| linear([c; 3])[0]);
        assert!(shades.clone().is_sorted_by(|a, b| a < b));
        assert_eq!(
            (shades.clone().next(), shades.next_back()),
            (Some(0), Some(65535))
        );
    }
}
