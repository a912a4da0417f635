//! Gaussian splats as PLY, in the layout of 3D Gaussian Splatting (Kerbl et al. 2023).

use crate::{Result, scene::files};
use std::{
    io::{self, Write},
    path::Path,
};

/// A Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Its mean.
    pub position: [f32; 3],
    /// sRGB, the same from all sides.
    pub colour: [u8; 3],
    /// From 0 to 1.
    pub opacity: f32,
    /// Standard deviations along its own axes, above 0.
    pub extent: [f32; 3],
    /// From its own axes to the world: a unit quaternion w, x, y, z.
    pub rotation: [f32; 4],
}

const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1",
    "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
];

/// The constant basis function of spherical harmonics, 1/2 sqrt(1/π).
const Y00: f32 = 0.282_094_8;

/// How near to 0 and 1 an opacity is written: a logit has no end.
const OPACITY_MARGIN: f32 = 1e-6;

/// Writes splats as viewers read them: binary little-endian, all properties `float`; opacity as its logit,
/// extents as their logarithms, colour as the constant term of spherical harmonics. There are no further
/// terms (`f_rest_*`): colours are the same from all sides.
///
/// # Errors
/// When writing fails.
pub fn write_splats(path: &Path, splats: &[Splat]) -> Result<()> {
    files::write_atomically(path, |out| write(out, splats))
}

fn write(out: &mut dyn Write, splats: &[Splat]) -> io::Result<()> {
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n",
        splats.len()
    )?;
    for name in PROPERTIES {
        writeln!(out, "property float {name}")?;
    }
    out.write_all(b"end_header\n")?;
    for splat in splats {
        for number in numbers(splat) {
            out.write_all(&number.to_le_bytes())?;
        }
    }
    Ok(())
}

fn numbers(splat: &Splat) -> [f32; 17] {
    let [x, y, z] = splat.position;
    let [r, g, b] = splat.colour.map(|c| (f32::from(c) / 255.0 - 0.5) / Y00);
    let opacity = splat.opacity.clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN);
    let logit = (opacity / (1.0 - opacity)).ln();
    let [s0, s1, s2] = splat.extent.map(f32::ln);
    let [q0, q1, q2, q3] = splat.rotation;
    [
        x, y, z, 0.0, 0.0, 0.0, r, g, b, logit, s0, s1, s2, q0, q1, q2, q3,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use ply_rs_bw::{
        parser::Parser,
        ply::{DefaultElement, Property},
    };

    #[test]
    fn a_viewer_gets_back_what_went_in() {
        let splat = Splat {
            position: [1.0, -2.0, 3.0],
            colour: [255, 51, 0],
            opacity: 0.75,
            extent: [0.01, 0.02, 0.5],
            rotation: [0.5, -0.5, 0.5, 0.5],
        };
        let opaque = Splat {
            opacity: 1.0,
            ..splat
        };
        let mut bytes = Vec::new();
        write(&mut bytes, &[splat, opaque]).unwrap();
        let ply = Parser::<DefaultElement>::new()
            .read_ply(&mut bytes.as_slice())
            .unwrap();
        let vertices = &ply.payload["vertex"];
        let get = |name: &str| match vertices[0][name] {
            Property::Float(x) => x,
            ref other => panic!("{other:?}"),
        };
        assert_eq!(["x", "y", "z"].map(get), splat.position);
        // What viewers do: sigmoid, exponential, 0.5 + Y00 dc.
        assert_relative_eq!(1.0 / (1.0 + (-get("opacity")).exp()), 0.75, epsilon = 1e-6);
        for (k, extent) in splat.extent.iter().enumerate() {
            let got = get(&format!("scale_{k}")).exp();
            assert_relative_eq!(got, *extent, max_relative = 1e-5);
        }
        let colour = [0, 1, 2].map(|k| 0.5 + 0.282_094_8 * get(&format!("f_dc_{k}")));
        assert_relative_eq!(colour[..], [1.0, 0.2, 0.0][..], epsilon = 1e-5);
        assert_eq!(
            [0, 1, 2, 3].map(|k| get(&format!("rot_{k}"))),
            splat.rotation
        );
        assert!(matches!(vertices[1]["opacity"], Property::Float(x) if x.is_finite() && x > 10.0));
    }
}
