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
mod tests;
