//! The focal length that a camera wrote into a photo.

use super::{KnownLens, Photo};
use exif::{Exif, In, Tag, Value};
use std::{fs::File, io::BufReader};

/// The diagonal of 35 mm film, 36 mm x 24 mm.
const FILM_DIAGONAL_MM: f64 = 43.266_615_305_567_87;
/// Photos whose sides are to each other as those that the camera wrote down, within this share, were
/// resized; others were cut, and show nobody knows which part of what the lens saw.
const ASPECT_TOLERANCE: f64 = 0.02;

impl Photo {
    /// The focal length that the camera wrote into the file (EXIF), in pixels of the photo; the same
    /// along both axes, and so whichever way the photo is turned.
    ///
    /// It is that of a lens with the photo's diagonal angle of view on 35 mm film, which is how cameras
    /// are to state it (CIPA DCG-001), and then includes any digital zoom; else, from the focal length
    /// in millimetres and the density of pixels on the sensor, times the digital zoom.
    ///
    /// `None` where the file says nothing or nothing believable, or was cut since.
    pub fn exif_focal(&self) -> Option<f64> {
        let mut file = BufReader::new(File::open(&self.path).ok()?);
        let exif = exif::Reader::new().read_from_container(&mut file).ok()?;
        focal(&exif, self.size().ok()?)
    }
}

/// The focal length in pixels of a picture of this width and height, whichever way it is turned.
fn focal(exif: &Exif, size: [u32; 2]) -> Option<f64> {
    let [width, height] = size.map(f64::from);
    let resized = resized_by(exif, [width, height])?;
    let by_film = number(exif, Tag::FocalLengthIn35mmFilm)
        .map(|millimetres| millimetres / FILM_DIAGONAL_MM * width.hypot(height));
    let focal = by_film.or_else(|| Some(sensor_focal(exif)? * resized))?;
    let is_believable = KnownLens::Focal(focal).on_photo(size).is_ok();
    is_believable.then_some(focal)
}

/// The focal length in pixels of the picture that the camera wrote.
fn sensor_focal(exif: &Exif) -> Option<f64> {
    let millimetres = number(exif, Tag::FocalLength)?;
    let density = number(exif, Tag::FocalPlaneXResolution)
        .or_else(|| number(exif, Tag::FocalPlaneYResolution))?;
    let unit = match exif.get_field(Tag::FocalPlaneResolutionUnit, In::PRIMARY) {
        // Exif 2.32, table 4: 2 (inches) unless stated.
        None => 25.4,
        Some(field) => match field.value.get_uint(0)? {
            2 => 25.4,
            3 => 10.0,
            // Beyond the standard, but in use.
            4 => 1.0,
            5 => 1e-3,
            _ => return None,
        },
    };
    // 0 says that there was none.
    let zoom = number(exif, Tag::DigitalZoomRatio).unwrap_or(1.0);
    Some(millimetres * density / unit * zoom)
}

/// By which factor the picture was resized since the camera wrote it; 1 if it did not say what it
/// wrote. `None` if the picture was cut.
fn resized_by(exif: &Exif, size: [f64; 2]) -> Option<f64> {
    let written = [Tag::PixelXDimension, Tag::PixelYDimension].map(|tag| number(exif, tag));
    let [Some(width), Some(height)] = written else {
        return Some(1.0);
    };
    // Programs that turn a photo may leave these as they were.
    let sorted = |[a, b]: [f64; 2]| [a.max(b), a.min(b)];
    let ([long, short], [was_long, was_short]) = (sorted(size), sorted([width, height]));
    let (factor, other) = (long / was_long, short / was_short);
    ((factor / other - 1.0).abs() <= ASPECT_TOLERANCE).then_some(factor)
}

/// The first number of a field; `None` unless it is positive and finite.
fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = &exif.get_field(tag, In::PRIMARY)?.value;
    let number = match value {
        Value::Rational(values) => values.first()?.to_f64(),
        Value::SRational(values) => values.first()?.to_f64(),
        Value::Float(values) => f64::from(*values.first()?),
        Value::Double(values) => *values.first()?,
        _ => f64::from(value.get_uint(0)?),
    };
    (number.is_finite() && number > 0.0).then_some(number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use exif::{Field, Rational, experimental::Writer};
    use image::{RgbImage, codecs::jpeg::JpegEncoder};
    use std::{fs, io::Cursor};

    fn rational(tag: Tag, num: u32, denom: u32) -> Field {
        field(tag, Value::Rational(vec![Rational { num, denom }]))
    }

    fn short(tag: Tag, value: u16) -> Field {
        field(tag, Value::Short(vec![value]))
    }

    fn field(tag: Tag, value: Value) -> Field {
        Field {
            tag,
            ifd_num: In::PRIMARY,
            value,
        }
    }

    /// What is found in a JPEG of this size with these fields.
    fn focal_in([width, height]: [u32; 2], fields: &[Field]) -> Option<f64> {
        let mut jpeg = Vec::new();
        let picture = RgbImage::new(width, height);
        JpegEncoder::new(&mut jpeg).encode_image(&picture).unwrap();
        let mut file = jpeg[..2].to_vec();
        if !fields.is_empty() {
            let mut writer = Writer::new();
            fields.iter().for_each(|field| writer.push_field(field));
            let mut exif = Cursor::new(Vec::new());
            writer.write(&mut exif, false).unwrap();
            let exif = exif.into_inner();
            file.extend([0xff, 0xe1]);
            file.extend((exif.len() as u16 + 8).to_be_bytes());
            file.extend(b"Exif\0\0");
            file.extend(exif);
        }
        file.extend(&jpeg[2..]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photo.jpg");
        fs::write(&path, file).unwrap();
        Photo::new("photo", path).exif_focal()
    }

    fn assert_focal(found: Option<f64>, want: f64) {
        let found = found.unwrap();
        assert!((found / want - 1.0).abs() < 1e-9, "{found}, not {want}");
    }

    #[test]
    fn an_equivalent_focal_length_has_the_same_diagonal_angle() {
        // 300x400 has a diagonal of 500.
        let equivalent = [short(Tag::FocalLengthIn35mmFilm, 26)];
        let want = 500.0 * 26.0 / (36.0f64 * 36.0 + 24.0 * 24.0).sqrt();
        assert_focal(focal_in([400, 300], &equivalent), want);
        assert_focal(focal_in([300, 400], &equivalent), want);
        let turned = [
            short(Tag::FocalLengthIn35mmFilm, 26),
            short(Tag::Orientation, 6),
            short(Tag::PixelXDimension, 4000),
            short(Tag::PixelYDimension, 3000),
        ];
        assert_focal(focal_in([400, 300], &turned), want);
    }

    #[test]
    fn a_focal_length_counts_with_the_density_of_the_sensor() {
        let lens = |unit, width, height| {
            [
                rational(Tag::FocalLength, 50, 10),
                rational(Tag::FocalPlaneXResolution, 2540, 1),
                short(Tag::FocalPlaneResolutionUnit, unit),
                short(Tag::PixelXDimension, width),
                short(Tag::PixelYDimension, height),
            ]
        };
        assert_focal(focal_in([400, 300], &lens(2, 400, 300)), 500.0);
        assert_focal(focal_in([400, 300], &lens(3, 400, 300)), 1270.0);
        // Halved since, and turned too.
        assert_focal(focal_in([400, 300], &lens(2, 800, 600)), 250.0);
        assert_focal(focal_in([300, 400], &lens(2, 800, 600)), 250.0);
        // Cut since.
        assert_eq!(focal_in([400, 300], &lens(2, 400, 400)), None);
        assert_eq!(focal_in([400, 300], &lens(9, 400, 300)), None);
        let zoomed = [
            rational(Tag::FocalLength, 5, 1),
            rational(Tag::FocalPlaneXResolution, 2540, 1),
            rational(Tag::DigitalZoomRatio, 2, 1),
        ];
        assert_focal(focal_in([400, 300], &zoomed), 1000.0);
    }

    #[test]
    fn what_is_missing_or_beyond_belief_is_none() {
        let size = [400, 300];
        assert_eq!(focal_in(size, &[]), None);
        assert_eq!(focal_in(size, &[short(Tag::Orientation, 6)]), None);
        for millimetres in [0, 1, 60_000] {
            let fields = [short(Tag::FocalLengthIn35mmFilm, millimetres)];
            assert_eq!(focal_in(size, &fields), None, "{millimetres}");
        }
        let divided_by_nothing = [
            rational(Tag::FocalLength, 5, 0),
            rational(Tag::FocalPlaneXResolution, 2540, 1),
        ];
        assert_eq!(focal_in(size, &divided_by_nothing), None);
        let text = [field(
            Tag::FocalLengthIn35mmFilm,
            Value::Ascii(vec![b"26".to_vec()]),
        )];
        assert_eq!(focal_in(size, &text), None);
        assert_eq!(Photo::new("none", "/nowhere.jpg").exif_focal(), None);
    }
}
