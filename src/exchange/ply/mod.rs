//! Point clouds as PLY files: ours are written, those of any program are read.
//!
//! The format is G. Turk's "The PLY Polygon File Format" (1994). Properties have the names that
//! MeshLab, CloudCompare, Open3D, trimesh and plyfile look for (`red`, `green`, `blue` as `uchar`);
//! `instance` and `confidence` are extra properties, which readers that do not know them skip.

mod read;
mod splats;

pub use read::{PlyCloud, read_cloud};
pub use splats::{Splat, write_splats};

use crate::{
    Result,
    scene::{Cloud, Scale, files},
};
use std::{
    io::{self, Write},
    path::Path,
};

/// Writes a cloud as a PLY file: whole or not at all.
///
/// # Errors
/// When writing fails.
pub fn write_cloud(path: &Path, cloud: &Cloud, scale: Scale) -> Result<()> {
    files::write_atomically(path, |out| write(out, cloud, scale))
}

/// Writes binary little-endian PLY: `x y z` as `float`, `red green blue` as `uchar`, `instance` as
/// `int`, `confidence` as `float`; 23 bytes a point, in the cloud's order. `out` should be buffered.
fn write(out: &mut dyn Write, cloud: &Cloud, scale: Scale) -> io::Result<()> {
    let scale = match scale {
        Scale::Metric => "metric",
        Scale::Relative => "relative",
    };
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\n\
         comment written by tid3r {}\n\
         comment scale {scale}\n\
         element vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         property int instance\nproperty float confidence\n\
         end_header\n",
        env!("CARGO_PKG_VERSION"),
        cloud.len(),
    )?;
    for (index, position) in cloud.positions.iter().enumerate() {
        for coordinate in position {
            out.write_all(&coordinate.to_le_bytes())?;
        }
        out.write_all(&cloud.colours[index])?;
        // Ids count from 1 and never come near the sign bit.
        out.write_all(&cloud.instances[index].to_le_bytes())?;
        out.write_all(&cloud.confidences[index].to_le_bytes())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Source;
    use ply_rs_bw::{
        parser::Parser,
        ply::{DefaultElement, Encoding, Property},
    };

    fn cloud() -> Cloud {
        Cloud {
            positions: vec![[1.5, -2.25, 3.0], [f32::MIN_POSITIVE, 0.0, -1e30]],
            colours: vec![[0, 128, 255], [10, 13, 26]],
            confidences: vec![1.0, 0.125],
            radii: vec![0.1; 2],
            directions: vec![[0.0, 0.0, 1.0]; 2],
            sources: vec![Source { frame: 0, pixel: 0 }; 2],
            instances: vec![0, 70_000],
        }
    }

    fn written(cloud: &Cloud) -> Vec<u8> {
        let mut bytes = Vec::new();
        write(&mut bytes, cloud, Scale::Metric).unwrap();
        bytes
    }

    #[test]
    fn another_reader_finds_what_was_written() {
        let (cloud, bytes) = (cloud(), written(&cloud()));
        let ply = Parser::<DefaultElement>::new()
            .read_ply(&mut bytes.as_slice())
            .unwrap();
        assert_eq!(ply.header.encoding, Encoding::BinaryLittleEndian);
        assert!(ply.header.comments.contains(&"scale metric".to_string()));
        assert!(ply.header.comments[0].starts_with("written by tid3r"));
        let vertices = &ply.payload["vertex"];
        assert_eq!(vertices.len(), 2);
        for (i, vertex) in vertices.iter().enumerate() {
            for (axis, name) in ["x", "y", "z"].iter().enumerate() {
                assert_eq!(vertex[*name], Property::Float(cloud.positions[i][axis]));
            }
            for (channel, name) in ["red", "green", "blue"].iter().enumerate() {
                assert_eq!(vertex[*name], Property::UChar(cloud.colours[i][channel]));
            }
            assert_eq!(vertex["instance"], Property::Int(cloud.instances[i] as i32));
            assert_eq!(vertex["confidence"], Property::Float(cloud.confidences[i]));
        }
    }

    #[test]
    fn a_point_takes_23_bytes_and_an_empty_cloud_none() {
        let header = |bytes: &[u8]| {
            let end = b"end_header\n";
            bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len()
        };
        let two = written(&cloud());
        assert_eq!(two.len() - header(&two), 2 * 23);
        let none = written(&Cloud::default());
        assert_eq!(none.len(), header(&none));
    }
}
