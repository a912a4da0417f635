use super::Intrinsics;
use serde::Serialize;
use std::{fmt, str::FromStr};

/// A pinhole as recordings state it: in pixels of an image that goes unnamed, and with a negative
/// focal length where an axis of the camera's frame points the other way than the image's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Focal length along the image's rows; negative if the camera's x axis points left.
    pub fx: f64,
    /// Focal length along the image's columns; negative if the camera's y axis points up.
    pub fy: f64,
    /// Principal point, x.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
}

/// Focal lengths outside this range of image widths are taken for mistakes: the angles of view
/// would be above 157 or below 3 degrees.
const FOCAL_WIDTHS: std::ops::RangeInclusive<f64> = 0.1..=20.0;

impl Lens {
    /// The lens of a 3x3 camera matrix K, rows first.
    pub(crate) fn from_matrix(k: &[[f64; 3]; 3]) -> Result<Self, String> {
        let zeros = [k[1][0], k[2][0], k[2][1], k[2][2] - 1.0];
        if zeros.iter().any(|x| x.abs() > 1e-6) {
            return Err("the camera matrix is not of the form fx 0 cx, 0 fy cy, 0 0 1".into());
        }
        // A thousandth is far below what a pixel's corner shifts by in any calibrated camera.
        if k[0][1].abs() > 1e-3 * k[0][0].abs() {
            return Err(format!(
                "the camera matrix is skewed (by {}), which tid3r has no lens for",
                k[0][1]
            ));
        }
        Ok(Self {
            fx: k[0][0],
            fy: k[1][1],
            cx: k[0][2],
            cy: k[1][2],
        })
    }

    /// The lens of `camera-intrinsics.txt`: nine numbers of a 3x3 matrix, or four.
    pub(crate) fn from_numbers(numbers: &[f64]) -> Result<Self, String> {
        match *numbers {
            [fx, fy, cx, cy] => Ok(Self { fx, fy, cx, cy }),
            [a, b, c, d, e, f, g, h, i] => Self::from_matrix(&[[a, b, c], [d, e, f], [g, h, i]]),
            _ => Err(format!(
                "there are {} numbers where 9 (a 3x3 matrix) or 4 (fx fy cx cy) are expected",
                numbers.len()
            )),
        }
    }

    /// The diagonal of F, -1 for each axis that is flipped.
    pub(crate) fn axis_signs(&self) -> [f64; 2] {
        [self.fx.signum(), self.fy.signum()]
    }

    /// How far the principal point is from the centre of an image of `size`, in shares of the sides.
    pub(crate) fn off_centre(&self, size: [u32; 2]) -> f64 {
        let [x, y] = self.relative_principal_point(size);
        (x - 0.5).abs().max((y - 0.5).abs())
    }

    /// The intrinsics, if this is the lens of an image of `size`; flipped axes are turned round.
    ///
    /// # Errors
    /// What is wrong, when no such image has this lens.
    pub fn on_image(&self, size: [u32; 2]) -> Result<Intrinsics, String> {
        if [self.fx, self.fy, self.cx, self.cy]
            .iter()
            .any(|x| !x.is_finite())
        {
            return Err(format!("the intrinsics {self} are not all finite numbers"));
        }
        let [width, height] = size;
        let focals = [self.fx, self.fy].map(|f| f.abs() / f64::from(width));
        if focals.iter().any(|f| !FOCAL_WIDTHS.contains(f)) {
            return Err(format!(
                "the focal lengths {:.3} and {:.3} cannot be those of an image {width} pixels wide",
                self.fx, self.fy
            ));
        }
        if self
            .relative_principal_point(size)
            .iter()
            .any(|x| !(0.0..=1.0).contains(x))
        {
            return Err(format!(
                "the principal point ({}, {}) lies outside the image of {width}x{height}",
                self.cx, self.cy
            ));
        }
        Ok(Intrinsics {
            width,
            height,
            fx: self.fx.abs(),
            fy: self.fy.abs(),
            cx: self.cx,
            cy: self.cy,
        })
    }

    fn relative_principal_point(&self, [width, height]: [u32; 2]) -> [f64; 2] {
        [
            (self.cx + 0.5) / f64::from(width),
            (self.cy + 0.5) / f64::from(height),
        ]
    }
}

impl FromStr for Lens {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<f64> = text
            .split(',')
            .map(|number| number.trim().parse())
            .collect::<Result<_, _>>()
            .map_err(|_| format!("`{text}` is not fx,fy,cx,cy"))?;
        match *numbers {
            [fx, fy, cx, cy] if numbers.iter().all(|x| x.is_finite()) && fx * fy != 0.0 => {
                Ok(Self { fx, fy, cx, cy })
            }
            [_, _, _, _] => Err("the focal lengths must not be 0, and all numbers finite".into()),
            _ => Err(format!(
                "`{text}` has {} numbers; fx,fy,cx,cy are four",
                numbers.len()
            )),
        }
    }
}

impl fmt::Display for Lens {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{},{}", self.fx, self.fy, self.cx, self.cy)
    }
}

impl Serialize for Lens {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Lens = Lens {
        fx: 585.0,
        fy: -585.0,
        cx: 320.0,
        cy: 240.0,
    };

    #[test]
    fn four_numbers_and_matrices_give_the_same_lens() {
        let matrix = [585.0, 0.0, 320.0, 0.0, -585.0, 240.0, 0.0, 0.0, 1.0];
        assert_eq!(Lens::from_numbers(&matrix), Ok(LENS));
        assert_eq!(Lens::from_numbers(&[585.0, -585.0, 320.0, 240.0]), Ok(LENS));
        assert_eq!("585, -585,320,240".parse(), Ok(LENS));
        assert_eq!(LENS.to_string().parse(), Ok(LENS));
    }

    #[test]
    fn matrices_that_are_no_camera_are_refused() {
        let skewed = [585.0, 3.0, 320.0, 0.0, 585.0, 240.0, 0.0, 0.0, 1.0];
        assert!(Lens::from_numbers(&skewed).unwrap_err().contains("skewed"));
        let transposed = [585.0, 0.0, 0.0, 0.0, 585.0, 0.0, 320.0, 240.0, 1.0];
        assert!(Lens::from_numbers(&transposed).is_err());
        assert!(Lens::from_numbers(&[1.0; 12]).unwrap_err().contains("12"));
    }

    #[test]
    fn texts_that_are_no_lens_are_refused() {
        for text in ["", "1,2,3", "1,2,3,4,5", "a,b,c,d", "0,1,2,3", "1,nan,2,3"] {
            assert!(text.parse::<Lens>().is_err(), "{text}");
        }
    }

    #[test]
    fn a_lens_of_another_image_is_refused() {
        assert_eq!(LENS.on_image([640, 480]).unwrap().fy, 585.0);
        assert!(LENS.on_image([320, 240]).unwrap_err().contains("outside"));
        let with_focal = |fx| Lens { fx, ..LENS }.on_image([640, 480]);
        for fx in [0.0, 63.9, 12801.0] {
            assert!(with_focal(fx).unwrap_err().contains("focal"), "{fx}");
        }
        for fx in [f64::NAN, f64::INFINITY] {
            assert!(with_focal(fx).unwrap_err().contains("finite"), "{fx}");
        }
    }
}
