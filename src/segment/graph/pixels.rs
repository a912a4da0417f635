use super::{
    GraphParams,
    colour::{self, Colour},
    forest::{self, Edge},
    grid::Grid,
    surface::Surface,
};

/// Superpixels of fewer pixels join a neighbour,
const MIN_SUPERPIXEL: u32 = 40;
/// but never over a contrast of more tolerances than this.
const MAX_CONTRAST: f32 = 2.0;
/// What a ridge counts beside a valley: faces that meet in a ridge usually are one object's.
const RIDGE: f32 = 0.5;

/// What two neighbouring pixels differ in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Contrast {
    /// Colour difference.
    pub(super) colour: f32,
    /// Gap between the surfaces in multiples of the tolerance: over 1, one hides part of the other.
    pub(super) gap: f32,
    /// Angle between the surfaces, radians: positive in a valley (concave), negative on a ridge.
    pub(super) valley: f32,
}

/// All that is known of the pixels.
pub(super) struct Pixels<'a> {
    pub(super) grid: &'a Grid,
    pub(super) colours: &'a [Colour],
    pub(super) surface: &'a Surface,
    pub(super) params: &'a GraphParams,
}

impl Pixels<'_> {
    /// The contrast of pixel `a` with its neighbour `b`, which lies `step` further; `None` where one
    /// has no depth.
    ///
    /// Disparity being affine on planes, two surfaces form a valley exactly where its slope increases
    /// from one to the other.
    pub(super) fn contrast(&self, a: usize, b: usize, step: (isize, isize)) -> Option<Contrast> {
        let (p, q) = (self.surface.planes[a]?, self.surface.planes[b]?);
        let angle = p.normal.dot(&q.normal).clamp(-1.0, 1.0).acos();
        Some(Contrast {
            colour: colour::difference(&self.colours[a], &self.colours[b]),
            gap: self.surface.gap(&p, &q, step),
            valley: if q.slope(step) > p.slope(step) {
                angle
            } else {
                -angle
            },
        })
    }

    /// Cuts the pixels with depth into superpixels, numbered from 0 as they come in the image, and
    /// says how many there are.
    pub(super) fn superpixels(&self) -> (Vec<Option<u32>>, usize) {
        let mut edges = Vec::with_capacity(4 * self.grid.len());
        for a in 0..self.grid.len() {
            for step in [(1, 0), (0, 1), (1, 1), (-1, 1)] {
                let Some(b) = self.grid.neighbour(a, step) else {
                    continue;
                };
                if let Some(contrast) = self.contrast(a, b, step) {
                    edges.push(Edge {
                        a: a as u32,
                        b: b as u32,
                        weight: self.weight(&contrast),
                    });
                }
            }
        }
        let roots = forest::segment(
            self.grid.len(),
            &edges,
            self.params.superpixel_scale,
            MIN_SUPERPIXEL,
            MAX_CONTRAST,
        );
        let mut number = vec![None; roots.len()];
        let mut count = 0;
        let labels = roots.iter().zip(&self.surface.planes);
        let labels = labels
            .map(|(&root, plane)| {
                plane.is_some().then(|| {
                    *number[root as usize].get_or_insert_with(|| {
                        count += 1;
                        count - 1
                    })
                })
            })
            .collect();
        (labels, count as usize)
    }

    /// The parts of a contrast, each in multiples of its tolerance, taken together.
    fn weight(&self, contrast: &Contrast) -> f32 {
        let colour = contrast.colour / self.params.pixel_colour;
        let ridge = if contrast.valley < 0.0 { RIDGE } else { 1.0 };
        let crease = ridge * contrast.valley.to_degrees() / self.params.pixel_crease;
        (colour * colour + contrast.gap * contrast.gap + crease * crease).sqrt()
    }
}
