use super::{Mask, Segmenter};
use crate::{
    Error, Map, Result,
    photos::{same_shape, unreadable},
    scene::{Frame, Hasher},
};
use image::{DynamicImage, ImageReader};
use std::path::{Path, PathBuf};

/// Masks recorded as label images: one file for each photo, each value a mask, 0 none. Values need
/// not mean the same in different files.
///
/// A photo called `name` has `name.png` or `name.pgm`; 8 or 16 bits of grey are the label, colours are
/// labels too (black is none). An image of another size, but of the photo's shape, is sampled at pixel centres.
#[derive(Clone, Debug)]
pub struct LabelImages {
    folder: PathBuf,
}

impl LabelImages {
    /// The label images in `folder`.
    ///
    /// # Errors
    /// When there is no such folder.
    pub fn open(folder: &Path) -> Result<Self> {
        if !folder.is_dir() {
            return Err(Error::file(
                folder,
                "is not a folder",
                "give the folder that holds one label image for each photo",
            ));
        }
        Ok(Self {
            folder: folder.to_path_buf(),
        })
    }

    /// The label image of a frame's photo, in the frame's size.
    ///
    /// # Errors
    /// When there is none, it cannot be read, or it has not the photo's shape.
    pub fn labels(&self, frame: &Frame) -> Result<Map<u32>> {
        let path = self.find(&frame.photo.name)?;
        let image = ImageReader::open(&path)
            .and_then(ImageReader::with_guessed_format)
            .map_err(Error::io("read", &path))?
            .decode()
            .map_err(|error| unreadable(&path, error))?;
        let size = [image.width(), image.height()];
        let transform = &frame.transform;
        if size != transform.frame_size && !same_shape(size, transform.photo_size) {
            return Err(Error::file(
                &path,
                format!("is {}x{}, unlike its photo", size[0], size[1]),
                format!(
                    "give a label image of the photo's size, {}x{}, or of its shape",
                    transform.photo_size[0], transform.photo_size[1]
                ),
            ));
        }
        let labels = labels_of(&image);
        if size == transform.frame_size {
            return Ok(labels);
        }
        let [width, height] = transform.frame_size;
        Ok(Map::from_fn(width, height, |x, y| {
            let at = transform.to_photo([f64::from(x), f64::from(y)]);
            let [u, v] = std::array::from_fn(|axis| {
                let scale = f64::from(size[axis]) / f64::from(transform.photo_size[axis]);
                (at[axis] + 0.5) * scale - 0.5
            });
            labels.nearest(u, v).map_or(0, |at| labels.values()[at])
        }))
    }

    /// A hash of the label images of these photos, as files.
    ///
    /// # Errors
    /// When one is missing or cannot be read.
    pub fn content_hash<'a>(&self, names: impl Iterator<Item = &'a str>) -> Result<String> {
        let mut hasher = Hasher::new();
        for name in names {
            let path = self.find(name)?;
            hasher.bytes(&std::fs::read(&path).map_err(Error::io("read", &path))?);
        }
        Ok(hasher.finish())
    }

    /// The label image of the photo called `name`.
    fn find(&self, name: &str) -> Result<PathBuf> {
        let path = ["png", "pgm"]
            .iter()
            .map(|extension| self.folder.join(format!("{name}.{extension}")))
            .find(|path| path.is_file());
        path.ok_or_else(|| {
            Error::file(
                &self.folder,
                format!("has no label image for the photo '{name}'"),
                format!("add {name}.png, 8 or 16 bits, one value per mask, 0 for none"),
            )
        })
    }
}

impl Segmenter for LabelImages {
    fn segment(&self, frame: &Frame, _: &mut dyn FnMut(f64)) -> Result<Vec<Mask>> {
        Ok(Mask::from_labels(&self.labels(frame)?))
    }
}

fn labels_of(image: &DynamicImage) -> Map<u32> {
    let (width, height) = (image.width(), image.height());
    match image {
        DynamicImage::ImageLuma8(grey) => {
            Map::from_fn(width, height, |x, y| u32::from(grey.get_pixel(x, y)[0]))
        }
        DynamicImage::ImageLuma16(grey) => {
            Map::from_fn(width, height, |x, y| u32::from(grey.get_pixel(x, y)[0]))
        }
        other => {
            let rgb = other.to_rgb8();
            Map::from_fn(width, height, |x, y| {
                let [r, g, b] = rgb.get_pixel(x, y).0;
                u32::from_be_bytes([0, r, g, b])
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::facing_wall;
    use image::{ImageBuffer, Luma};

    #[test]
    fn sixteen_bit_labels_are_read_at_photo_or_frame_size() {
        let folder = tempfile::tempdir().unwrap();
        let mut frame = facing_wall(0.0, 2.0);
        frame.photo.name = "a".into();
        frame.transform.photo_size = [64, 48];
        frame.transform.crop_size = [64.0, 48.0];
        for (width, half) in [(64, 32), (32, 16), (128, 64)] {
            let image = ImageBuffer::from_fn(width, width * 3 / 4, |x, _| {
                Luma([if x < half { 700_u16 } else { 300 }])
            });
            image.save(folder.path().join("a.png")).unwrap();
            let masks = LabelImages::open(folder.path())
                .unwrap()
                .segment(&frame, &mut |_| ())
                .unwrap();
            assert_eq!(masks.len(), 2);
            assert!(
                masks[0].pixels().all(|at| at % 32 >= 16),
                "label 300 is the right half"
            );
            assert_eq!(masks[0].area() + masks[1].area(), 32 * 24);
        }
    }

    #[test]
    fn a_missing_or_mis_sized_label_image_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let mut frame = facing_wall(0.0, 2.0);
        frame.photo.name = "a".into();
        let images = LabelImages::open(folder.path()).unwrap();
        assert!(
            images
                .segment(&frame, &mut |_| ())
                .unwrap_err()
                .to_string()
                .contains("add a.png")
        );
        image::GrayImage::new(5, 5)
            .save(folder.path().join("a.png"))
            .unwrap();
        let message = images.segment(&frame, &mut |_| ()).unwrap_err().to_string();
        assert!(
            message.contains("5x5") && message.contains("32x24"),
            "{message}"
        );
        std::fs::write(folder.path().join("a.png"), "no picture").unwrap();
        let message = images.segment(&frame, &mut |_| ()).unwrap_err().to_string();
        assert!(message.contains("not a readable picture"), "{message}");
    }
}
