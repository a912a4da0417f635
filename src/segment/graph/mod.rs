//! Masks without a network: a graph-based segmentation of one frame with depth.
//!
//! 1. A plane is fitted around every pixel: it averages the noise out and gives the normals.
//! 2. Felzenszwalb and Huttenlocher's segmentation of the pixel graph ("Efficient Graph-Based Image
//!    Segmentation", 2004) makes superpixels; weights tell colour, depth jumps and creases.
//! 3. Superpixels in the planes that bound the room become its floor, walls and ceiling, and what is
//!    painted on these or hangs flat on them.
//! 4. The other superpixels become objects: neighbours merge by increasing difference of colour and
//!    shape. As in Stein et al., "Object Partitioning using Local Convexity" (2014), surfaces that
//!    meet in a ridge belong together and those that meet in a valley are two, the more so where
//!    one of them is the floor or a wall.
//! 5. Small holes of the depth map are filled from around them.

mod colour;
mod fill;
mod forest;
mod grid;
mod hull;
mod moments;
mod objects;
mod pixels;
mod plane_fit;
mod regions;
mod surface;

use super::{Mask, Segmenter};
use crate::{Map, Result, geometry::Intrinsics, scene::Frame};
use grid::Grid;
use image::RgbImage;
use objects::Objects;
use pixels::Pixels;
use regions::RegionGraph;
use serde::{Deserialize, Serialize};
use surface::Surface;

/// How a frame is cut into masks. Tolerances say how much of a difference counts as one; differences
/// of several kinds add up (as squares).
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
#[serde(default)]
pub struct GraphParams {
    /// Size of the superpixels that objects are made of: Felzenszwalb and Huttenlocher's k
    #[arg(long, value_name = "K", default_value_t = Self::default().superpixel_scale,
          value_parser = crate::parameters::not_negative_f32)]
    pub superpixel_scale: f32,
    /// Colour difference (CIELAB) of neighbouring pixels that separates superpixels
    #[arg(long, value_name = "DELTA_E", default_value_t = Self::default().pixel_colour,
          value_parser = crate::parameters::not_negative_f32)]
    pub pixel_colour: f32,
    /// Angle between the surfaces at neighbouring pixels that separates superpixels
    #[arg(long, value_name = "DEGREES", default_value_t = Self::default().pixel_crease,
          value_parser = crate::parameters::not_negative_f32)]
    pub pixel_crease: f32,
    /// Jump of the depth, as a share of it, that separates surfaces (noise is added to it)
    #[arg(long, value_name = "SHARE", default_value_t = Self::default().gap_tolerance,
          value_parser = crate::parameters::not_negative_f32)]
    pub gap_tolerance: f32,
    /// Difference of mean colours (CIELAB) that separates objects
    #[arg(long, value_name = "DELTA_E", default_value_t = Self::default().object_colour,
          value_parser = crate::parameters::not_negative_f32)]
    pub object_colour: f32,
    /// Concave angle that separates objects
    #[arg(long, value_name = "DEGREES", default_value_t = Self::default().object_crease,
          value_parser = crate::parameters::not_negative_f32)]
    pub object_crease: f32,
    /// Concave angle that separates an object from the floor, a wall or the ceiling
    #[arg(long, value_name = "DEGREES", default_value_t = Self::default().hull_crease,
          value_parser = crate::parameters::not_negative_f32)]
    pub hull_crease: f32,
    /// Colour difference (CIELAB) that separates a picture, a door or a rug from its wall or floor
    #[arg(long, value_name = "DELTA_E", default_value_t = Self::default().hull_colour,
          value_parser = crate::parameters::not_negative_f32)]
    pub hull_colour: f32,
    /// Share of the image that a floor, wall or ceiling covers at least
    #[arg(long, value_name = "SHARE", default_value_t = Self::default().hull_area,
          value_parser = crate::parameters::not_negative_f32)]
    pub hull_area: f32,
    /// Share of the image that a mask covers at least
    #[arg(long, value_name = "SHARE", default_value_t = Self::default().min_area,
          value_parser = crate::parameters::not_negative_f32)]
    pub min_area: f32,
    /// How far masks grow into pixels without depth
    #[arg(long, value_name = "PIXELS", default_value_t = Self::default().hole_reach)]
    pub hole_reach: u32,
}

impl Default for GraphParams {
    fn default() -> Self {
        Self {
            superpixel_scale: 5.0,
            pixel_colour: 10.0,
            pixel_crease: 35.0,
            gap_tolerance: 0.012,
            object_colour: 20.0,
            object_crease: 60.0,
            hull_crease: 30.0,
            hull_colour: 15.0,
            hull_area: 0.03,
            min_area: 0.001,
            hole_reach: 8,
        }
    }
}

/// The graph-based segmentation as a [`Segmenter`].
#[derive(Clone, Debug, Default)]
pub struct GraphSegmenter(pub GraphParams);

impl Segmenter for GraphSegmenter {
    fn segment(&self, frame: &Frame, _: &mut dyn FnMut(f64)) -> Result<Vec<Mask>> {
        let Frame {
            colour,
            depth,
            camera,
            ..
        } = frame;
        let labels = segment(colour, depth, &camera.intrinsics, &self.0);
        Ok(Mask::from_labels(&labels))
    }
}

/// Cuts a frame into masks: labels 1, 2, ... by decreasing area; 0 is no mask.
///
/// `depth` is z in the camera frame, 0 where unknown. 0 is what a photo without any depth gets, and
/// what any photo gets whose size is not that of `depth` and of `intrinsics`.
pub fn segment(
    colour: &RgbImage,
    depth: &Map<f32>,
    intrinsics: &Intrinsics,
    params: &GraphParams,
) -> Map<u32> {
    let (width, height) = (depth.width(), depth.height());
    let fits = colour.dimensions() == (width, height)
        && (intrinsics.width, intrinsics.height) == (width, height);
    Grid::new(intrinsics)
        .filter(|_| fits)
        .and_then(|grid| Map::new(width, height, masks(colour, depth, &grid, params)))
        .unwrap_or_else(|| Map::filled(width, height, 0))
}

fn masks(colour: &RgbImage, depth: &Map<f32>, grid: &Grid, params: &GraphParams) -> Vec<u32> {
    let surface = Surface::of(depth, grid, params.gap_tolerance);
    let colours = colour::smoothed(colour, &surface, grid);
    let pixels = Pixels {
        grid,
        colours: &colours,
        surface: &surface,
        params,
    };
    let (superpixels, count) = pixels.superpixels();
    let mut graph = RegionGraph::new(&pixels, &superpixels, count);
    let objects = Objects {
        params,
        noise: f64::from(surface.noise),
        pixels: grid.len() as f64,
    };
    let min_area = f64::from(params.min_area) * grid.len() as f64;
    hull::merge_hull(&mut graph, grid, &objects);
    objects.merge_alike(&mut graph);
    objects.merge_small(&mut graph, min_area);
    let mut labels: Vec<Option<u32>> = superpixels
        .iter()
        .map(|superpixel| superpixel.map(|s| graph.find(s)))
        .collect();
    fill::fill_holes(&mut labels, &colours, grid, params);
    fill::by_area(&labels, count, min_area.ceil() as usize)
}

#[cfg(test)]
mod tests;
