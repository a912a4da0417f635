//! Reading point clouds of any program.

use crate::{Error, Result, scene::files};
use serde::Deserialize;
use serde_ply::{
    ElementDef, PlyFormat, PlyHeader, PlyProperty, PlyReader, PropertyType, ScalarType,
};
use std::{io::Read, path::Path};

/// The points of a PLY file. Fields have one entry for each point, or are `None` where the file has no
/// such properties.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlyCloud {
    /// Positions (`x y z`), finite, in the file's own frame and units.
    pub positions: Vec<[f64; 3]>,
    /// sRGB (`red green blue`, as numbers of 8 or 16 bits or as shares of 1).
    pub colours: Option<Vec<[u8; 3]>>,
    /// Normals (`nx ny nz`), as long as the file has them.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Confidences (`confidence`), whatever the file means by them.
    pub confidences: Option<Vec<f32>>,
    /// Instances (`instance`), 0 for none; what is no whole number from 0 on is none.
    pub instances: Option<Vec<u32>>,
    /// The comments of the header.
    pub comments: Vec<String>,
    /// How many points were left out, their positions not being finite numbers.
    pub left_out: usize,
}

const REMEDY: &str = "give a whole PLY file with the points of a cloud";

/// Reads the vertices of a PLY file: ASCII, or binary of either byte order. Other elements, and other
/// properties of vertices, lists among them, are skipped.
///
/// # Errors
/// When the file cannot be read, is no PLY file, is cut short, or has no vertices with `x y z`.
pub fn read_cloud(path: &Path) -> Result<PlyCloud> {
    read(&files::read(path, REMEDY)?).map_err(|problem| Error::file(path, problem, REMEDY))
}

/// A vertex as serde sees it; what the file does not have stays 0.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Vertex {
    x: f64,
    y: f64,
    z: f64,
    red: f32,
    green: f32,
    blue: f32,
    nx: f32,
    ny: f32,
    nz: f32,
    confidence: f32,
    instance: f64,
}

/// A row of another element.
#[derive(Deserialize)]
struct Skipped {}

fn read(bytes: &[u8]) -> Result<PlyCloud, String> {
    let mut body = bytes;
    let head = PlyReader::from_reader(&mut body).map_err(broken)?;
    let header = head.header().clone();
    check_counts(&header, body.len() as u64)?;
    // The last word of an ASCII file needs an end, whether or not the file has it.
    let end: &[u8] = match header.format {
        PlyFormat::Ascii => b"\n",
        _ => b"",
    };
    let mut reader = PlyReader::from_reader(bytes.chain(end)).map_err(broken)?;
    let comments = reader.header().comments.clone();
    while let Some(element) = reader.current_element() {
        if element.name != "vertex" {
            reader.next_element::<Vec<Skipped>>().map_err(broken)?;
            continue;
        }
        let has = Properties::of(element)?;
        let vertices: Vec<Vertex> = reader.next_element().map_err(broken)?;
        return Ok(PlyCloud {
            comments,
            ..has.cloud(vertices)
        });
    }
    Err("has no element 'vertex'".into())
}

fn broken(serde_ply::DeserializeError(error): serde_ply::DeserializeError) -> String {
    match error.kind() {
        std::io::ErrorKind::UnexpectedEof => "is cut short".into(),
        _ => format!("is no PLY file that can be read ({error})"),
    }
}

/// Refuses counts of rows that a body of `length` bytes is too short for: they would be allocated, or counted to.
fn check_counts(header: &PlyHeader, length: u64) -> Result<(), String> {
    let mut needed = 0_u64;
    for element in &header.elem_defs {
        let size = |property: &PlyProperty| match property.property_type {
            PropertyType::Scalar(scalar)
            | PropertyType::List {
                count_type: scalar, ..
            } => {
                match header.format {
                    // A digit and a space.
                    PlyFormat::Ascii => 2,
                    _ => bytes(scalar),
                }
            }
        };
        let row: u64 = element.properties.iter().map(size).sum();
        if row == 0 && element.count > 0 {
            return Err(format!("has an element '{}' of nothing", element.name));
        }
        needed = needed.saturating_add(row.saturating_mul(element.count as u64));
    }
    match needed > length.saturating_add(1) {
        true => Err("is cut short".into()),
        false => Ok(()),
    }
}

fn bytes(scalar: ScalarType) -> u64 {
    match scalar {
        ScalarType::I8 | ScalarType::U8 => 1,
        ScalarType::I16 | ScalarType::U16 => 2,
        ScalarType::I32 | ScalarType::U32 | ScalarType::F32 => 4,
        ScalarType::F64 => 8,
    }
}

/// Which properties vertices have.
struct Properties {
    /// What full intensity is written as.
    white: Option<f32>,
    normals: bool,
    confidence: bool,
    instance: bool,
}

impl Properties {
    fn of(vertex: &ElementDef) -> Result<Self, String> {
        let scalar = |name: &str| {
            let found = vertex.get_property(name)?;
            match found.property_type {
                PropertyType::Scalar(scalar) => Some(scalar),
                PropertyType::List { .. } => None,
            }
        };
        let all = |names: [&str; 3]| names.iter().all(|name| scalar(name).is_some());
        if !all(["x", "y", "z"]) {
            return Err("has vertices without x, y and z".into());
        }
        let white = match scalar("red") {
            Some(ScalarType::F32 | ScalarType::F64) => 1.0,
            Some(ScalarType::I16 | ScalarType::U16) => 65535.0,
            _ => 255.0,
        };
        Ok(Self {
            white: all(["red", "green", "blue"]).then_some(white),
            normals: all(["nx", "ny", "nz"]),
            confidence: scalar("confidence").is_some(),
            instance: scalar("instance").is_some(),
        })
    }

    fn cloud(&self, mut vertices: Vec<Vertex>) -> PlyCloud {
        let count = vertices.len();
        vertices.retain(|v| [v.x, v.y, v.z].iter().all(|x| x.is_finite()));
        let rgb = |v: &Vertex| [v.red, v.green, v.blue];
        // Some programs write floats from 0 to 255.
        let white = self.white.map(|white| {
            let brighter = vertices
                .iter()
                .flat_map(rgb)
                .any(|c| c > 1.0 && white == 1.0);
            if brighter { 255.0 } else { white }
        });
        let colour = |v: &Vertex, white: f32| {
            rgb(v).map(|c| (c / white * 255.0).round().clamp(0.0, 255.0) as u8)
        };
        let instance = |v: &Vertex| match v.instance.fract() == 0.0 && v.instance > 0.0 {
            // Ids that do not fit become the highest, which no instance has.
            true => v.instance as u32,
            false => 0,
        };
        PlyCloud {
            positions: vertices.iter().map(|v| [v.x, v.y, v.z]).collect(),
            colours: white.map(|white| vertices.iter().map(|v| colour(v, white)).collect()),
            normals: (self.normals).then(|| vertices.iter().map(|v| [v.nx, v.ny, v.nz]).collect()),
            confidences: (self.confidence).then(|| vertices.iter().map(|v| v.confidence).collect()),
            instances: (self.instance).then(|| vertices.iter().map(instance).collect()),
            comments: vec![],
            left_out: count - vertices.len(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
