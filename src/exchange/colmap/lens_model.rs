use super::ColmapCamera;
use crate::{exchange::half_pixels, geometry::Intrinsics};

/// COLMAP's camera models that have a focal length and a principal point: all but its equirectangular one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LensModel(&'static Row);

#[derive(Debug, PartialEq, Eq)]
struct Row {
    id: i32,
    name: &'static str,
    focals: usize,
    distortion: &'static [&'static str],
}

const fn row(
    id: i32,
    name: &'static str,
    focals: usize,
    distortion: &'static [&'static str],
) -> Row {
    Row {
        id,
        name,
        focals,
        distortion,
    }
}

/// Parameters are the focal lengths, the principal point, then the distortion.
static MODELS: [Row; 17] = [
    row(0, "SIMPLE_PINHOLE", 1, &[]),
    row(1, "PINHOLE", 2, &[]),
    row(2, "SIMPLE_RADIAL", 1, &["k1"]),
    row(3, "RADIAL", 1, &["k1", "k2"]),
    row(4, "OPENCV", 2, &["k1", "k2", "p1", "p2"]),
    row(5, "OPENCV_FISHEYE", 2, &["k1", "k2", "k3", "k4"]),
    row(
        6,
        "FULL_OPENCV",
        2,
        &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
    ),
    row(7, "FOV", 2, &["omega"]),
    row(8, "SIMPLE_RADIAL_FISHEYE", 1, &["k1"]),
    row(9, "RADIAL_FISHEYE", 1, &["k1", "k2"]),
    row(
        10,
        "THIN_PRISM_FISHEYE",
        2,
        &["k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"],
    ),
    row(
        11,
        "RAD_TAN_THIN_PRISM_FISHEYE",
        2,
        &[
            "k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1", "s0", "s1", "s2", "s3",
        ],
    ),
    row(12, "SIMPLE_DIVISION", 1, &["k"]),
    row(13, "DIVISION", 2, &["k"]),
    row(14, "SIMPLE_FISHEYE", 1, &[]),
    row(15, "FISHEYE", 2, &[]),
    row(16, "EUCM", 2, &["alpha", "beta"]),
];

impl LensModel {
    /// A pinhole with two focal lengths: what tid3r's own cameras are.
    pub const PINHOLE: Self = Self(&MODELS[1]);

    /// The model of an id in binary files.
    pub fn from_id(id: i32) -> Option<Self> {
        MODELS.iter().find(|row| row.id == id).map(Self)
    }

    /// The model of a name in text files.
    pub fn from_name(name: &str) -> Option<Self> {
        MODELS.iter().find(|row| row.name == name).map(Self)
    }

    /// The id in binary files.
    pub fn id(self) -> i32 {
        self.0.id
    }

    /// The name in text files.
    pub fn name(self) -> &'static str {
        self.0.name
    }

    /// What the parameters behind focal lengths and principal point are called, in order: `k` radial, `p`
    /// tangential, and so on, as in OpenCV. The lens is a pinhole if there are none and its name says so.
    pub fn distortion_names(self) -> &'static [&'static str] {
        self.0.distortion
    }

    /// Whether fx and fy are one parameter.
    pub fn has_one_focal_length(self) -> bool {
        self.0.focals == 1
    }

    /// How many parameters there are in all.
    pub fn parameter_count(self) -> usize {
        self.0.focals + 2 + self.0.distortion.len()
    }
}

impl ColmapCamera {
    /// The camera that a file states: its principal point comes to our pixel centres here.
    pub(super) fn from_file(
        id: u32,
        model: LensModel,
        size: [u64; 2],
        parameters: &[f64],
    ) -> Result<Self, String> {
        if parameters.len() != model.parameter_count() {
            return Err(format!(
                "camera {id} has {} parameters where {} has {}",
                parameters.len(),
                model.name(),
                model.parameter_count()
            ));
        }
        let (focals, rest) = parameters.split_at(model.0.focals);
        // Sizes that do not fit become ones that are not possible.
        let [width, height] = size.map(|side| u32::try_from(side).unwrap_or(0));
        let camera = Self {
            id,
            model,
            intrinsics: half_pixels::lens_from(Intrinsics {
                width,
                height,
                fx: focals[0],
                fy: focals[focals.len() - 1],
                cx: rest[0],
                cy: rest[1],
            }),
            distortion: rest[2..].to_vec(),
        };
        camera.check()?;
        Ok(camera)
    }

    /// The parameters as files state them.
    pub(super) fn parameters(&self) -> Vec<f64> {
        let lens = half_pixels::lens_to(self.intrinsics);
        let focals = [lens.fx, lens.fy];
        let focals = focals[..self.model.0.focals].iter();
        let centre = [lens.cx, lens.cy];
        let all = focals.chain(&centre).chain(&self.distortion);
        all.copied().collect()
    }

    /// What is wrong with a camera that cannot be.
    pub(super) fn check(&self) -> Result<(), String> {
        let lens = &self.intrinsics;
        let finite = self.distortion.iter().all(|x| x.is_finite());
        if !lens.is_possible() || !finite {
            let (id, width, height) = (self.id, lens.width, lens.height);
            return Err(format!(
                "camera {id} has an impossible size or lens ({width}x{height})"
            ));
        }
        let fits = self.distortion.len() == self.model.0.distortion.len();
        if !fits || (self.model.has_one_focal_length() && lens.fx != lens.fy) {
            let (id, name) = (self.id, self.model.name());
            return Err(format!("camera {id} has a lens that {name} cannot express"));
        }
        Ok(())
    }
}
