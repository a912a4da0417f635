//! Masks of a photo by itself, without a scene, as files for people and for other programs.

use super::{CocoRle, Labels, Mask, MaskParams, overlay};
use crate::{Map, Result, photos::Photo, scene::files};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// An object of a picture: its mask, and what the networks say of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// Its pixels; the confidence is the intersection over union with the true object that the network
    /// itself expects.
    pub mask: Mask,
    /// The box that the mask was asked for: left, top, right, bottom, in pixels of the picture.
    pub corners: [f32; 4],
    /// How sure the detector is, 0 to 1.
    pub score: f32,
}

/// The objects of a photo that count.
#[derive(Clone, Debug)]
pub struct PhotoMasks {
    name: String,
    path: PathBuf,
    picture: RgbImage,
    /// The largest first.
    objects: Vec<Object>,
    labels: Labels,
}

/// What there is in a photo, in short.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotoReport {
    /// The photo's name.
    pub photo: String,
    /// The folder that was written.
    pub folder: PathBuf,
    /// Width and height of the photo.
    pub size: [u32; 2],
    /// Masks that count.
    pub masks: usize,
    /// Of these, masks that have pixels of their own in the label image.
    pub labels: usize,
    /// The share of the photo that has a label.
    pub covered: f64,
}

/// One mask in `masks.json`, as COCO and SA-1B have annotations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Annotation {
    /// From 1 on, the largest mask first; also the number of its PNG.
    id: usize,
    /// Its value in `labels.png`; none if others cover it.
    label: Option<u32>,
    /// Left, top, width and height of the mask.
    bbox: [u32; 4],
    /// Pixels.
    area: usize,
    predicted_iou: f32,
    score: f32,
    /// Left, top, width and height of the box that the detector found.
    detected_box: [f32; 4],
    segmentation: CocoRle,
}

/// `masks.json`.
#[derive(Serialize)]
struct File<'a> {
    image: ImageEntry<'a>,
    segmenter: &'a Value,
    annotations: Vec<Annotation>,
}

#[derive(Serialize)]
struct ImageEntry<'a> {
    file_name: &'a Path,
    width: u32,
    height: u32,
}

impl PhotoMasks {
    /// Those of the `objects` of `picture`, the pixels of `photo`, that count.
    pub fn new(photo: &Photo, picture: RgbImage, objects: &[Object], params: &MaskParams) -> Self {
        let (width, height) = picture.dimensions();
        let masks: Vec<Mask> = objects.iter().map(|object| object.mask.clone()).collect();
        let chosen = params.chosen(&masks, width as usize * height as usize);
        let objects: Vec<Object> = chosen.iter().map(|&k| objects[k].clone()).collect();
        let masks: Vec<Mask> = chosen.iter().map(|&k| masks[k].clone()).collect();
        Self {
            name: photo.name.clone(),
            path: photo.path.clone(),
            labels: params.labels(&masks, width, height),
            picture,
            objects,
        }
    }

    /// Writes `masks.json`, `labels.png` (16 bits, 0 for none), `overlay.png` and, with `each`, a black and
    /// white PNG of each mask into the folder `NAME_masks` below `parent`.
    ///
    /// # Errors
    /// When the folder cannot be written to.
    pub fn write(&self, parent: &Path, segmenter: &Value, each: bool) -> Result<PhotoReport> {
        let folder = parent.join(format!("{}_masks", self.name));
        let (width, height) = self.picture.dimensions();
        let annotations = (0..self.objects.len()).map(|k| self.annotation(k));
        let file = File {
            image: ImageEntry {
                file_name: self.path.file_name().map_or(&self.path, Path::new),
                width,
                height,
            },
            segmenter,
            annotations: annotations.collect(),
        };
        files::write_label_png(&folder.join("labels.png"), &self.labels.map)?;
        let drawn = overlay(&self.picture, &self.labels.map);
        files::write_png(&folder.join("overlay.png"), &drawn)?;
        if each {
            for (k, object) in self.objects.iter().enumerate() {
                let mut map = Map::filled(width, height, false);
                for (row, columns) in object.mask.row_runs(width) {
                    let start = map.index(0, row);
                    let [from, to] = [columns.start, columns.end].map(|x| start + x as usize);
                    map.values_mut()[from..to].fill(true);
                }
                files::write_mask_png(&folder.join(format!("mask_{:03}.png", k + 1)), &map)?;
            }
        }
        // Last: whoever finds it finds the others.
        files::write_json(&folder.join("masks.json"), &file)?;
        let labelled = self.labels.map.values().iter().filter(|&&label| label != 0);
        Ok(PhotoReport {
            photo: self.name.clone(),
            folder,
            size: [width, height],
            masks: self.objects.len(),
            labels: self.labels.masks.len(),
            covered: labelled.count() as f64 / self.labels.map.len().max(1) as f64,
        })
    }

    fn annotation(&self, k: usize) -> Annotation {
        let Object {
            mask,
            corners,
            score,
        } = &self.objects[k];
        let (width, height) = self.picture.dimensions();
        let [left, top, right, bottom] = *corners;
        let bbox = mask
            .bounds(width)
            .map_or([0; 4], |[left, top, right, bottom]| {
                [left, top, right - left + 1, bottom - top + 1]
            });
        let label = self.labels.masks.binary_search(&k);
        Annotation {
            id: k + 1,
            label: label.ok().map(|at| at as u32 + 1),
            bbox,
            area: mask.area(),
            predicted_iou: mask.confidence,
            score: *score,
            detected_box: [left, top, right - left, bottom - top],
            segmentation: CocoRle::new(mask, width, height),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, ImageReader};

    fn object(pixels: impl IntoIterator<Item = u32>) -> Object {
        Object {
            mask: Mask::from_pixels(pixels, 0.5),
            corners: [1.0, 2.0, 4.0, 8.0],
            score: 0.75,
        }
    }

    #[test]
    fn files_agree_with_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let photo = Photo::new("a", "somewhere/a.jpg");
        // The second covers the first but for its last row; the last one is too small to count.
        let objects = vec![object(0..40), object(50..70), object(0..100), object([99])];
        let params = MaskParams {
            min_mask_area: 0.02,
            ..MaskParams::default()
        };
        let masks = PhotoMasks::new(&photo, RgbImage::new(10, 10), &objects, &params);
        let report = masks.write(folder.path(), &Value::Null, true).unwrap();
        assert_eq!((report.masks, report.labels, report.covered), (3, 3, 1.0));
        let text = std::fs::read(report.folder.join("masks.json")).unwrap();
        let json: Value = serde_json::from_slice(&text).unwrap();
        assert_eq!(json["image"]["file_name"], "a.jpg");
        let annotations: Vec<Annotation> =
            serde_json::from_value(json["annotations"].clone()).unwrap();
        let areas: Vec<_> = annotations.iter().map(|a| a.area).collect();
        assert_eq!(areas, [100, 40, 20]);
        assert_eq!(annotations[1].bbox, [0, 0, 10, 4]);
        assert_eq!(annotations[1].detected_box, [1.0, 2.0, 3.0, 6.0]);
        let read = |name: &str| {
            let reader = ImageReader::open(report.folder.join(name)).unwrap();
            reader.decode().unwrap()
        };
        let DynamicImage::ImageLuma16(labels) = read("labels.png") else {
            panic!("labels have 16 bits");
        };
        for annotation in &annotations {
            let label = annotation.label.unwrap();
            let DynamicImage::ImageLuma8(mask) = read(&format!("mask_{:03}.png", annotation.id))
            else {
                panic!("masks are grey");
            };
            let inside = mask.pixels().filter(|pixel| pixel[0] == 255).count();
            assert_eq!(inside, annotation.area);
            let mut both = labels.pixels().zip(mask.pixels());
            assert!(both.all(|(l, m)| u32::from(l[0]) != label || m[0] == 255));
        }
        assert!(!report.folder.join("mask_004.png").exists());
        assert_eq!(read("overlay.png").width(), 10);
    }

    #[test]
    fn a_mask_that_others_cover_has_no_label() {
        let folder = tempfile::tempdir().unwrap();
        let objects = vec![object(0..60), object(0..30), object(30..60)];
        let photo = Photo::new("a", "a.jpg");
        let params = MaskParams::default();
        let masks = PhotoMasks::new(&photo, RgbImage::new(10, 10), &objects, &params);
        let report = masks.write(folder.path(), &Value::Null, false).unwrap();
        assert_eq!((report.masks, report.labels, report.covered), (3, 2, 0.6));
        let labels: Vec<_> = (0..3).map(|k| masks.annotation(k).label).collect();
        assert_eq!(labels, [None, Some(1), Some(2)]);
    }
}
