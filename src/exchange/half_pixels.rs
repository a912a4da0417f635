//! Pixel centres of other programs.
//!
//! COLMAP and nerfstudio say that the first pixel's centre is at (0.5, 0.5), tid3r that it is at (0, 0).
//! Their files are converted here and nowhere else.

use crate::geometry::Intrinsics;

/// Where they have the centre of the first pixel, along both axes.
const CENTRE: f64 = 0.5;

/// Our image point for one of theirs.
pub(super) fn point_from(theirs: [f64; 2]) -> [f64; 2] {
    theirs.map(|x| x - CENTRE)
}

/// Their image point for one of ours.
pub(super) fn point_to(ours: [f64; 2]) -> [f64; 2] {
    ours.map(|x| x + CENTRE)
}

/// Our lens for one of theirs.
pub(super) fn lens_from(theirs: Intrinsics) -> Intrinsics {
    let [cx, cy] = point_from([theirs.cx, theirs.cy]);
    Intrinsics { cx, cy, ..theirs }
}

/// Their lens for one of ours.
pub(super) fn lens_to(ours: Intrinsics) -> Intrinsics {
    let [cx, cy] = point_to([ours.cx, ours.cy]);
    Intrinsics { cx, cy, ..ours }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_an_image_is_half_its_size_there() {
        let ours = Intrinsics {
            width: 640,
            height: 480,
            fx: 500.0,
            fy: 500.0,
            cx: 319.5,
            cy: 239.5,
        };
        let theirs = lens_to(ours);
        assert_eq!([theirs.cx, theirs.cy], [320.0, 240.0]);
        assert_eq!(lens_from(theirs), ours);
    }
}
