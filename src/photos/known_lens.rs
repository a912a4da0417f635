use crate::{
    geometry::{Intrinsics, Lens},
    parameters,
};
use serde::Serialize;

/// What a user knows of the lens of a photo, in pixels of the upright photo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum KnownLens {
    /// The focal length; the principal point is the middle.
    Focal(f64),
    /// Both focal lengths and the principal point.
    Intrinsics(Lens),
}

impl KnownLens {
    /// A focal length, as a user writes it.
    ///
    /// # Errors
    /// What is wrong with `text`, when it is no positive number.
    pub fn parse_focal(text: &str) -> Result<Self, String> {
        parameters::positive(text).map(Self::Focal)
    }

    /// `fx,fy,cx,cy`, as a user writes them.
    ///
    /// # Errors
    /// What is wrong with `text`, when it is not four numbers or a focal length is not positive.
    pub fn parse_intrinsics(text: &str) -> Result<Self, String> {
        let lens: Lens = text.parse()?;
        if lens.fx < 0.0 || lens.fy < 0.0 {
            return Err("the focal lengths of a photo's lens must be above 0".into());
        }
        Ok(Self::Intrinsics(lens))
    }

    /// The intrinsics of a photo of `size` (width, height) by this lens.
    ///
    /// # Errors
    /// What is wrong, when no photo of this size has such a lens.
    pub fn on_photo(&self, size: [u32; 2]) -> Result<Intrinsics, String> {
        let lens = match *self {
            Self::Intrinsics(lens) => lens,
            Self::Focal(focal) => {
                let [cx, cy] = size.map(|side| (f64::from(side) - 1.0) / 2.0);
                Lens {
                    fx: focal,
                    fy: focal,
                    cx,
                    cy,
                }
            }
        };
        lens.on_image(size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_focal_length_puts_the_principal_point_in_the_middle() {
        let lens = KnownLens::parse_focal("500").unwrap();
        let portrait = lens.on_photo([300, 401]).unwrap();
        assert_eq!((portrait.fx, portrait.fy), (500.0, 500.0));
        // Of 401 rows, number 200 is the middle one.
        assert_eq!((portrait.cx, portrait.cy), (149.5, 200.0));
        assert!(lens.on_photo([20, 20]).unwrap_err().contains("focal"));
    }

    #[test]
    fn four_numbers_are_a_lens_and_others_are_refused() {
        let lens = KnownLens::parse_intrinsics("500,510,150,200").unwrap();
        assert_eq!(lens.on_photo([300, 400]).unwrap().fy, 510.0);
        assert!(KnownLens::parse_intrinsics("500,-510,150,200").is_err());
        assert!(KnownLens::parse_intrinsics("500").is_err());
        for text in ["", "f", "0", "-3", "inf", "nan"] {
            assert!(KnownLens::parse_focal(text).is_err(), "{text}");
        }
    }
}
