use super::{Distortion, TransformsFrame};
use crate::{exchange::half_pixels, geometry::Intrinsics};
use serde::{Deserialize, Serialize, Serializer};

/// The lens as it is written, for all frames or for one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct LensFields {
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_model: Option<CameraModel>,
    #[serde(
        skip_serializing_if = "Option::is_none",
        serialize_with = "whole_number"
    )]
    w: Option<f64>,
    #[serde(
        skip_serializing_if = "Option::is_none",
        serialize_with = "whole_number"
    )]
    h: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_y: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cx: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cy: Option<f64>,
    #[serde(skip_serializing)]
    camera_angle_x: Option<f64>,
    #[serde(skip_serializing)]
    camera_angle_y: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k2: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k3: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k4: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k5: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k6: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p2: Option<f64>,
}

/// Writes the side of an image as 640 and not 640.0; some files that are read have the latter.
fn whole_number<S: Serializer>(side: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    side.map(|side| side as u32).serialize(serializer)
}

/// The models that are OpenCV's or special cases of it, in which unused parameters are 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
enum CameraModel {
    SimplePinhole,
    Pinhole,
    SimpleRadial,
    Radial,
    Opencv,
    OpencvFisheye,
}

impl LensFields {
    pub(super) fn of(frame: &TransformsFrame) -> Self {
        let lens = half_pixels::lens_to(frame.intrinsics);
        let Distortion { fisheye, k, p } = frame.distortion;
        let pinhole = k == [0.0; 6] && p == [0.0; 2] && !fisheye;
        let [k1, k2, k3, k4, k5, k6] = k.map(|k| Some(k).filter(|_| !pinhole));
        let [p1, p2] = p.map(|p| Some(p).filter(|_| !pinhole));
        Self {
            camera_model: Some(match (pinhole, fisheye) {
                (true, _) => CameraModel::Pinhole,
                (_, false) => CameraModel::Opencv,
                (_, true) => CameraModel::OpencvFisheye,
            }),
            w: Some(lens.width.into()),
            h: Some(lens.height.into()),
            fl_x: Some(lens.fx),
            fl_y: Some(lens.fy),
            cx: Some(lens.cx),
            cy: Some(lens.cy),
            camera_angle_x: None,
            camera_angle_y: None,
            k1,
            k2,
            k3,
            k4,
            k5,
            k6,
            p1,
            p2,
        }
    }

    /// A frame's own fields, and those of all frames where it has none.
    pub(super) fn or(&self, all: &Self) -> Self {
        Self {
            camera_model: self.camera_model.or(all.camera_model),
            w: self.w.or(all.w),
            h: self.h.or(all.h),
            fl_x: self.fl_x.or(all.fl_x),
            fl_y: self.fl_y.or(all.fl_y),
            cx: self.cx.or(all.cx),
            cy: self.cy.or(all.cy),
            camera_angle_x: self.camera_angle_x.or(all.camera_angle_x),
            camera_angle_y: self.camera_angle_y.or(all.camera_angle_y),
            k1: self.k1.or(all.k1),
            k2: self.k2.or(all.k2),
            k3: self.k3.or(all.k3),
            k4: self.k4.or(all.k4),
            k5: self.k5.or(all.k5),
            k6: self.k6.or(all.k6),
            p1: self.p1.or(all.p1),
            p2: self.p2.or(all.p2),
        }
    }

    pub(super) fn intrinsics(&self) -> Result<Intrinsics, String> {
        let (Some(w), Some(h)) = (self.w, self.h) else {
            return Err("there is no w and h".into());
        };
        let side = |length: f64| match length.fract() == 0.0 {
            true => length as u32,
            false => 0,
        };
        let focal = |side: f64, angle: f64| side / 2.0 / (angle / 2.0).tan();
        let fx = self
            .fl_x
            .or(self.camera_angle_x.map(|angle| focal(w, angle)));
        let fy = self
            .fl_y
            .or(self.camera_angle_y.map(|angle| focal(h, angle)));
        let Some((fx, fy)) = fx.or(fy).zip(fy.or(fx)) else {
            return Err("there is neither fl_x nor camera_angle_x".into());
        };
        let lens = half_pixels::lens_from(Intrinsics {
            width: side(w),
            height: side(h),
            fx,
            fy,
            cx: self.cx.unwrap_or(w / 2.0),
            cy: self.cy.unwrap_or(h / 2.0),
        });
        match lens.is_possible() {
            true => Ok(lens),
            false => Err("the size or the lens is impossible".into()),
        }
    }

    pub(super) fn distortion(&self) -> Distortion {
        let number = |field: Option<f64>| field.unwrap_or(0.0);
        Distortion {
            fisheye: self.camera_model == Some(CameraModel::OpencvFisheye),
            k: [self.k1, self.k2, self.k3, self.k4, self.k5, self.k6].map(number),
            p: [self.p1, self.p2].map(number),
        }
    }
}
