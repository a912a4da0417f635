use super::files::MapFile;
use crate::{Map, Result};

/// A Gaussian for each pixel of a frame, to be splatted; its mean is the pixel's point.
///
/// Extents are raw outputs of the network, and those it was trained on were clipped to between 1e-4
/// and 4e-3 of a scene of normalised size.
#[derive(Clone, Debug, PartialEq)]
pub struct Gaussians {
    /// From 0 to 1.
    pub opacity: Map<f32>,
    /// Extent along each axis.
    pub scale: [Map<f32>; 3],
    /// Unit quaternion w, x, y, z, in the scene frame.
    pub rotation: [Map<f32>; 4],
    /// Spherical harmonics of the colour, red, green and blue of each in turn; raw.
    pub colour: Vec<Map<f32>>,
}

impl Gaussians {
    /// The maps of a file, all of a width and height.
    ///
    /// # Errors
    /// When one is missing or damaged.
    pub(super) fn read(file: &MapFile) -> Result<Self> {
        let map = |name: &str, k: usize| file.map::<f32>(&format!("{name}_{k}"));
        let colours = (0..).take_while(|k| file.holds(&format!("colour_{k}")));
        Ok(Self {
            colour: colours.map(|k| map("colour", k)).collect::<Result<_>>()?,
            opacity: file.map("opacity")?,
            scale: [map("scale", 0)?, map("scale", 1)?, map("scale", 2)?],
            rotation: [
                map("rotation", 0)?,
                map("rotation", 1)?,
                map("rotation", 2)?,
                map("rotation", 3)?,
            ],
        })
    }

    /// The maps under the names that they have in files: `opacity`, `scale_0` and so on.
    pub(super) fn maps(&self) -> Vec<(String, &Map<f32>)> {
        let mut maps = vec![("opacity".to_string(), &self.opacity)];
        maps.extend(numbered("scale", &self.scale));
        maps.extend(numbered("rotation", &self.rotation));
        maps.extend(numbered("colour", &self.colour));
        maps
    }
}

fn numbered<'a>(name: &str, maps: &'a [Map<f32>]) -> impl Iterator<Item = (String, &'a Map<f32>)> {
    let numbered = maps.iter().enumerate();
    numbered.map(move |(i, map)| (format!("{name}_{i}"), map))
}
