use crate::Map;

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
