//! Frames as sharp as networks can see them.

use crate::{photos::PhotoTransform, scene::Frame};
use image::RgbImage;

/// What a frame shows, out of the photo itself, of which the frame may be but a small copy: in the photo's
/// own pixels, but no longer than `long_side`. The frame's colours if they are as sharp, or the photo is
/// not there any more.
pub(super) fn sharp_picture(frame: &Frame, long_side: u32) -> RgbImage {
    let crop = frame.transform.crop_size;
    let scale = (f64::from(long_side) / crop[0].max(crop[1])).min(1.0);
    let sharper = PhotoTransform {
        frame_size: crop.map(|side| (side * scale).round().max(1.0) as u32),
        ..frame.transform
    };
    if sharper.frame_size[0] <= frame.colour.width() {
        return frame.colour.clone();
    }
    let photo = frame.photo.load();
    let picture = photo.and_then(|photo| sharper.apply(&photo, &frame.photo.path));
    picture.unwrap_or_else(|problem| {
        tracing::warn!(
            "the masks of {} are made from its small frame: {problem}",
            frame.photo.name
        );
        frame.colour.clone()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::facing_wall;
    use image::Rgb;

    #[test]
    fn the_part_of_the_photo_that_a_frame_shows_is_seen_in_the_photos_pixels() {
        let folder = tempfile::tempdir().unwrap();
        let mut frame = facing_wall(0.0, 2.0);
        let (width, height) = frame.colour.dimensions();
        frame.photo.path = folder.path().join("a.png");
        // The frame is the middle of a photo, in a quarter of its size.
        frame.transform = PhotoTransform {
            photo_size: [6 * width, 4 * height],
            crop_origin: [f64::from(width), 0.0],
            crop_size: [width, height].map(|side| 4.0 * f64::from(side)),
            frame_size: [width, height],
        };
        assert_eq!(
            sharp_picture(&frame, 1024),
            frame.colour,
            "no photo is there"
        );
        let photo = RgbImage::from_fn(6 * width, 4 * height, |x, y| Rgb([x as u8, y as u8, 7]));
        photo.save(&frame.photo.path).unwrap();
        let seen = sharp_picture(&frame, 1024);
        assert_eq!(seen.dimensions(), (4 * width, 4 * height));
        for (x, y) in [(0, 0), (4 * width - 1, 4 * height - 1)] {
            assert_eq!(seen[(x, y)], photo[(x + width, y)]);
        }
        assert_eq!(sharp_picture(&frame, 2 * width).width(), 2 * width);
        assert_eq!(
            sharp_picture(&frame, width),
            frame.colour,
            "nothing is gained"
        );
    }
}
