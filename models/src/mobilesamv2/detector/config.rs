//! Hyper-parameters.

use std::collections::BTreeMap;

use candle_core::{Error, Result, bail};
use serde::{Deserialize, Serialize};

/// The hyper-parameters of a YOLOv8 with a segmentation head, as the shapes of its tensors tell them.
///
/// `nc`, `reg_max` and `nm` are the original's names; the original has the others in a description
/// of the network that no checkpoint has to keep, so that they have no name there.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Config {
    /// Channels of the backbone's maps of 1/2, 1/4, 1/8, 1/16 and 1/32 of the image's size. The neck's
    /// maps have those of the last three.
    pub widths: [usize; 5],
    /// Bottlenecks in each C2f block: `model.` 2, 4, 6, 8, 12, 15, 18, 21.
    pub repeats: [usize; 8],
    /// Classes of things.
    pub nc: usize,
    /// Bins of the distance between an anchor and a side of its box.
    pub reg_max: usize,
    /// Mask coefficients of an anchor; 0 if the checkpoint has none.
    pub nm: usize,
    /// Hidden channels of the head's branch for boxes, `cv2`.
    pub box_hidden: usize,
    /// Hidden channels of its branch for classes, `cv3`.
    pub class_hidden: usize,
    /// Hidden channels of its branch for mask coefficients, `cv4`; 0 if there is none.
    pub mask_hidden: usize,
}

impl Config {
    /// The layers of [`Self::repeats`].
    pub(super) const C2F_LAYERS: [usize; 8] = [2, 4, 6, 8, 12, 15, 18, 21];

    /// The object-aware detector in its full size: x, one class, 26 bins, 32 mask coefficients.
    pub fn released() -> Self {
        Self::scaled((1.0, 1.25, 512), 1, 26, 32)
    }

    /// A YOLOv8 of ultralytics' (depth, width, most channels before scaling): n is (0.33, 0.25, 1024),
    /// s (0.33, 0.5, 1024), m (0.67, 0.75, 768), l (1, 1, 512), x (1, 1.25, 512).
    pub fn scaled(
        (depth, width, max_channels): (f64, f64, usize),
        nc: usize,
        reg_max: usize,
        nm: usize,
    ) -> Self {
        let widths = [64, 128, 256, 512, 1024].map(|channels: usize| {
            let scaled = channels.min(max_channels) as f64 * width;
            (scaled / 8.0).ceil() as usize * 8
        });
        let repeats = [3, 6, 6, 3, 3, 3, 3, 3].map(|count| {
            let scaled: f64 = f64::from(count) * depth;
            (scaled.round_ties_even() as usize).max(1)
        });
        let finest = widths[2];
        Self {
            widths,
            repeats,
            nc,
            reg_max,
            nm,
            box_hidden: (finest / 4).max(4 * reg_max).max(16),
            class_hidden: finest.max(nc),
            mask_hidden: if nm == 0 { 0 } else { (finest / 4).max(nm) },
        }
    }

    /// The configuration of a checkpoint whose tensors have these names and shapes. Only those that
    /// say something new are looked at; others may be there.
    ///
    /// # Errors
    ///
    /// If one of them is missing, has too few axes or a size that no network can have.
    pub fn from_shapes(shapes: &BTreeMap<String, Vec<usize>>) -> Result<Self> {
        let size = |name: &str, axis: usize| {
            let shape = shapes.get(name).ok_or_else(|| {
                Error::Msg(format!("the tensor {name} of a YOLOv8 detector is missing"))
            })?;
            shape.get(axis).copied().ok_or_else(|| {
                let wanted = axis + 1;
                Error::Msg(format!(
                    "the tensor {name} has shape {shape:?} where at least {wanted} axes are wanted"
                ))
            })
        };
        let mut widths = [0; 5];
        for (width, layer) in widths.iter_mut().zip([0, 1, 3, 5, 7]) {
            *width = size(&format!("model.{layer}.conv.weight"), 0)?;
        }
        let repeats = Self::C2F_LAYERS.map(|layer| {
            let name = |j: usize| format!("model.{layer}.m.{j}.cv1.conv.weight");
            (0..).take_while(|&j| shapes.contains_key(&name(j))).count()
        });
        let mask = "model.22.cv4.0.2.weight";
        let (nm, mask_hidden) = match shapes.contains_key(mask) {
            true => (size(mask, 0)?, size(mask, 1)?),
            false => (0, 0),
        };
        let config = Self {
            widths,
            repeats,
            nc: size("model.22.cv3.0.2.weight", 0)?,
            reg_max: size("model.22.dfl.conv.weight", 1)?,
            nm,
            box_hidden: size("model.22.cv2.0.2.weight", 1)?,
            class_hidden: size("model.22.cv3.0.2.weight", 1)?,
            mask_hidden,
        };
        config.validate()?;
        Ok(config)
    }

    /// Channels of the head's three maps, the finest first.
    pub(super) fn levels(&self) -> [usize; 3] {
        let [_, _, levels @ ..] = self.widths;
        levels
    }

    /// Refuses sizes with which no network can be built.
    ///
    /// # Errors
    ///
    /// If a size is 0 or absurdly large, or channels cannot be halved.
    pub(super) fn validate(&self) -> Result<()> {
        const LARGEST: usize = 1 << 14;
        let sizes = [
            ("nc", &[self.nc][..]),
            ("reg_max", &[self.reg_max]),
            ("box_hidden", &[self.box_hidden]),
            ("class_hidden", &[self.class_hidden]),
            ("widths", &self.widths),
            ("repeats", &self.repeats),
        ];
        for (name, sizes) in sizes {
            if let Some(size) = sizes.iter().find(|size| !(1..=LARGEST).contains(*size)) {
                bail!("{name} must be from 1 to {LARGEST}, got {size}");
            }
        }
        if let Some(width) = self.widths.iter().find(|width| !width.is_multiple_of(2)) {
            bail!("widths must be even, got {width}");
        }
        if self.nm.max(self.mask_hidden) > LARGEST || (self.nm == 0) != (self.mask_hidden == 0) {
            bail!(
                "nm and mask_hidden must both be 0, or both from 1 to {LARGEST}, got {} and {}",
                self.nm,
                self.mask_hidden
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Detector, MaskCoefficients};
    use super::*;

    const SCALES: [(f64, f64, usize); 5] = [
        (0.33, 0.25, 1024),
        (0.33, 0.5, 1024),
        (0.67, 0.75, 768),
        (1.0, 1.0, 512),
        (1.0, 1.25, 512),
    ];

    #[test]
    fn the_scales_of_ultralytics() {
        let widths = SCALES.map(|scale| Config::scaled(scale, 1, 26, 32).widths);
        assert_eq!(
            widths,
            [
                [16, 32, 64, 128, 256],
                [32, 64, 128, 256, 512],
                [48, 96, 192, 384, 576],
                [64, 128, 256, 512, 512],
                [80, 160, 320, 640, 640],
            ]
        );
        let repeats = SCALES.map(|scale| Config::scaled(scale, 1, 26, 32).repeats);
        assert_eq!(repeats[0], [1, 2, 2, 1, 1, 1, 1, 1]);
        assert_eq!(repeats[2], [2, 4, 4, 2, 2, 2, 2, 2]);
        assert_eq!(repeats[4], [3, 6, 6, 3, 3, 3, 3, 3]);
        // Channels are rounded up to 8; half of 3 repeats is 1.5, rounded to even.
        let odd = Config::scaled((0.5, 0.14, 1024), 80, 16, 32);
        assert_eq!(odd.widths, [16, 24, 40, 72, 144]);
        assert_eq!(odd.repeats, [2, 3, 3, 2, 2, 2, 2, 2]);
        assert_eq!(
            (odd.box_hidden, odd.class_hidden, odd.mask_hidden),
            (64, 80, 32)
        );
    }

    #[test]
    fn shapes_tell_the_configuration() {
        let mut configs = SCALES
            .map(|scale| Config::scaled(scale, 1, 26, 32))
            .to_vec();
        configs.push(Config::scaled((0.5, 0.14, 1024), 80, 16, 0));
        // As no scale has it.
        configs.push(Config {
            widths: [8, 12, 18, 22, 10],
            repeats: [1, 2, 3, 4, 5, 6, 7, 8],
            nc: 3,
            reg_max: 5,
            nm: 7,
            box_hidden: 11,
            class_hidden: 13,
            mask_hidden: 17,
        });
        for config in configs {
            let mut shapes = Detector::tensors(&config).unwrap();
            shapes.extend(MaskCoefficients::tensors(&config).unwrap());
            shapes.insert(
                "model.22.proto.cv1.conv.weight".to_owned(),
                vec![4, 8, 3, 3],
            );
            assert_eq!(Config::from_shapes(&shapes).unwrap(), config);
        }
    }

    #[test]
    fn shapes_of_something_else_are_refused() {
        let config = Config::scaled(SCALES[0], 1, 26, 32);
        let all = Detector::tensors(&config).unwrap();
        for (name, shape, problem) in [
            ("model.7.conv.weight", None, "missing"),
            ("model.22.dfl.conv.weight", Some(vec![26]), "axes"),
            ("model.0.conv.weight", Some(vec![0, 3, 3, 3]), "widths"),
            ("model.12.m.0.cv1.conv.weight", None, "repeats"),
        ] {
            let mut shapes = all.clone();
            match shape {
                Some(shape) => shapes.insert(name.to_owned(), shape),
                None => shapes.remove(name),
            };
            let message = Config::from_shapes(&shapes).unwrap_err().to_string();
            assert!(message.contains(problem), "{message}");
        }
    }

    #[test]
    fn a_configuration_survives_the_way_through_json() {
        let config = Config::released();
        let text = serde_json::to_string(&config).unwrap();
        assert!(text.contains(r#""reg_max":26"#), "{text}");
        assert_eq!(serde_json::from_str::<Config>(&text).unwrap(), config);
    }
}
