use super::{SplatParams, project};
use crate::{
    Map,
    geometry::Camera,
    scene::{Cloud, Frame},
};
use image::{Rgb, RgbImage};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A photo that guides completion.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Where it was taken.
    pub camera: Camera,
    /// The pixels, black where the mask is false.
    pub colour: RgbImage,
    /// False where the photo shows what is no longer there.
    pub mask: Map<bool>,
}

/// How references are masked after edits.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
pub struct ReferenceParams {
    /// Widens the masks over removed and moved objects in the photos, in pixels
    #[arg(long, value_name = "PX", default_value_t = 6,
          value_parser = clap::value_parser!(u32).range(0..=4096))]
    pub dilate: u32,
    /// Show completion the photos as they are, removed objects and all (the paper's ablation)
    #[arg(long = "no-reference-masks", action = clap::ArgAction::SetFalse)]
    pub mask_references: bool,
}

impl Default for ReferenceParams {
    fn default() -> Self {
        Self {
            dilate: 6,
            mask_references: true,
        }
    }
}

/// Points this much nearer or farther, relatively, than what the photo shows are hidden in it.
const DEPTH_TOLERANCE: f32 = 0.1;

impl Reference {
    /// The photos as references, their pixels zeroed where they show vacated places.
    ///
    /// `photos` are the frames' pictures, recoloured or restyled perhaps.
    pub fn all(
        frames: &[Frame],
        photos: Vec<RgbImage>,
        vacated: &Cloud,
        params: &ReferenceParams,
    ) -> Vec<Self> {
        let masks = if params.mask_references {
            reference_masks(frames, vacated, params.dilate)
        } else {
            frames
                .iter()
                .map(|frame| frame.depth.map(|_| true))
                .collect()
        };
        frames
            .iter()
            .zip(photos)
            .zip(masks)
            .map(|((frame, mut colour), mask)| {
                for (pixel, &keep) in colour.pixels_mut().zip(mask.values()) {
                    if !keep {
                        *pixel = Rgb([0; 3]);
                    }
                }
                Self {
                    camera: frame.camera,
                    colour,
                    mask,
                }
            })
            .collect()
    }
}

/// For each frame, false where it shows a vacated place: where points that were removed, or moved
/// away, project to at their old positions, unless something else hides them there, widened by
/// `dilate` pixels. The paper's reference masking.
pub fn reference_masks(frames: &[Frame], vacated: &Cloud, dilate: u32) -> Vec<Map<bool>> {
    frames
        .par_iter()
        .map(|frame| {
            let gone = project(vacated, &frame.camera, &SplatParams::default());
            let shown = gone.depth.values().iter().zip(frame.depth.values());
            let mut shown = shown.map(|(&gone, &seen)| {
                gone > 0.0 && (seen == 0.0 || gone <= seen * (1.0 + DEPTH_TOLERANCE))
            });
            let (width, height) = (gone.depth.width(), gone.depth.height());
            let shown = Map::from_fn(width, height, |_, _| shown.next().unwrap_or(false));
            shown.dilated(dilate).map(|&shown| !shown)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::{facing_wall, frame};

    #[test]
    fn masks_cover_what_is_gone_where_it_was_visible() {
        // An object 2 away over the left half of the first view; a screen 1 away hides it from the second.
        let object = frame(
            0.0,
            Map::from_fn(32, 24, |x, _| if x < 16 { 2.0 } else { 4.0 }),
        );
        let screen = facing_wall(0.0, 1.0);
        let validity = object.depth.map(|&z| z < 3.0);
        let vacated = Cloud::from_frames(std::slice::from_ref(&object), &[validity], None);
        let masks = reference_masks(&[object, screen], &vacated, 0);
        for y in 0..24 {
            for x in 0..32 {
                let edge = (15..=17).contains(&x);
                assert!(edge || masks[0][(x, y)] == (x >= 16), "({x}, {y})");
            }
        }
        assert!(masks[1].values().iter().all(|&keep| keep));
    }

    #[test]
    fn masked_pixels_are_black_and_the_ablation_masks_nothing() {
        let wall = [facing_wall(0.0, 4.0)];
        let vacated = Cloud::from_frames(&wall, &[wall[0].depth.map(|_| true)], None);
        let photos = || vec![wall[0].colour.clone()];
        let masked = Reference::all(&wall, photos(), &vacated, &ReferenceParams::default());
        assert!(masked[0].colour.pixels().all(|pixel| pixel.0 == [0; 3]));
        let params = ReferenceParams {
            mask_references: false,
            ..ReferenceParams::default()
        };
        let as_is = Reference::all(&wall, photos(), &vacated, &params);
        assert_eq!(as_is[0].colour, wall[0].colour);
    }
}
