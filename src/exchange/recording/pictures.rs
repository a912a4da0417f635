use crate::{Error, Map, Result, photos::unreadable};
use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageFormat, ImageReader,
    codecs::pnm::{PnmDecoder, SampleEncoding},
    metadata::Orientation,
};
use std::{
    fs::File,
    io::{BufReader, Read},
    path::Path,
};

/// Sides above this are taken for damage.
pub(super) const SIDE_LIMIT: u32 = 16384;
/// What depth cameras write where they see nothing (0) or nothing that fits 16 bits.
pub(super) const NO_DEPTH: [u16; 2] = [0, u16::MAX];

/// What the header of a picture says.
pub(super) struct PictureHeader {
    /// Width and height of the pixels as stored.
    pub(super) size: [u32; 2],
    /// How they are to be turned to be upright.
    pub(super) orientation: Orientation,
    colour: ExtendedColorType,
}

impl PictureHeader {
    /// Reads no pixels.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let mut decoder = decoder(path)?;
        let (width, height) = decoder.dimensions();
        if width == 0 || height == 0 || width.max(height) > SIDE_LIMIT {
            return Err(Error::file(
                path,
                format!("is {width}x{height} pixels large"),
                format!("give pictures of 1 to {SIDE_LIMIT} pixels a side"),
            ));
        }
        let orientation = decoder.orientation();
        Ok(Self {
            size: [width, height],
            orientation: orientation.map_err(|error| unreadable(path, &error))?,
            colour: decoder.original_color_type(),
        })
    }

    /// Of the pixels of a larger file, which has them as the sensor does.
    pub(super) fn of_sensor(size: [u32; 2]) -> Self {
        Self {
            size,
            orientation: Orientation::NoTransforms,
            colour: ExtendedColorType::Rgb8,
        }
    }

    /// Reads no pixels; refuses what cannot be a depth image.
    pub(super) fn read_depth(path: &Path) -> Result<Self> {
        let header = Self::read(path)?;
        if header.colour != ExtendedColorType::L16 {
            return Err(Error::file(
                path,
                format!(
                    "is no depth image: its pixels are {:?}, not 16-bit grey",
                    header.colour
                ),
                "give 16-bit greyscale PNG or PGM files, not pictures made for looking at",
            ));
        }
        Ok(header)
    }
}

fn open(path: &Path) -> Result<ImageReader<BufReader<File>>> {
    ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(Error::io("read", path))
}

fn decoder(path: &Path) -> Result<impl ImageDecoder> {
    open(path)?
        .into_decoder()
        .map_err(|error| unreadable(path, &error))
}

/// The depth of a 16-bit picture with so many units per length; 0 where there is none.
pub(super) fn read_depth(path: &Path, units_per_length: f64) -> Result<Map<f32>> {
    let reader = open(path)?;
    let units = if reader.format() == Some(ImageFormat::Pnm) {
        read_pgm(path, reader.into_inner())?
    } else {
        let decoded = DynamicImage::from_decoder(decoder(path)?);
        match decoded.map_err(|error| unreadable(path, &error))? {
            DynamicImage::ImageLuma16(picture) => {
                Map::new(picture.width(), picture.height(), picture.into_raw())
            }
            _ => None,
        }
    };
    let units = units.ok_or_else(|| {
        Error::file(
            path,
            "is cut short or no 16-bit picture",
            "give whole 16-bit greyscale PNG or binary PGM files",
        )
    })?;
    Ok(units.map(|units| {
        if NO_DEPTH.contains(units) {
            0.0
        } else {
            (f64::from(*units) / units_per_length) as f32
        }
    }))
}

/// The values of a binary PGM as they stand in the file; `image` would stretch them so that the
/// maximum in the header becomes 65535.
fn read_pgm(path: &Path, reader: BufReader<File>) -> Result<Option<Map<u16>>> {
    let decoder = PnmDecoder::new(reader).map_err(|error| unreadable(path, &error))?;
    if decoder.subtype().sample_encoding() != SampleEncoding::Binary {
        return Ok(None);
    }
    let (width, height) = decoder.dimensions();
    let (reader, _) = decoder.into_inner();
    let bytes_expected = 2 * u64::from(width) * u64::from(height);
    let mut bytes = Vec::new();
    reader
        .take(bytes_expected)
        .read_to_end(&mut bytes)
        .map_err(Error::io("read", path))?;
    let values = bytes
        .as_chunks::<2>()
        .0
        .iter()
        .copied()
        .map(u16::from_be_bytes);
    Ok(Map::new(width, height, values.collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn written(name: &str, bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    #[test]
    fn pgm_is_big_endian() {
        let (_folder, path) = written("1.pgm", b"P5 # mm\n3 1 65535\n\x07\xd0\x00\x00\xff\xff");
        assert_eq!(PictureHeader::read_depth(&path).unwrap().size, [3, 1]);
        let depth = read_depth(&path, 1000.0).unwrap();
        assert_eq!(depth.values(), [2.0, 0.0, 0.0]);
    }

    #[test]
    fn pgm_is_not_stretched_to_its_maximum() {
        for largest in [256, 4095, 10000, 65534_u16] {
            let mut bytes = format!("P5 {} 1 {largest}\n", u32::from(largest) + 1).into_bytes();
            bytes.extend((0..=largest).flat_map(u16::to_be_bytes));
            let (_folder, path) = written("1.pgm", &bytes);
            let depth = read_depth(&path, 1.0).unwrap();
            let want: Vec<f32> = (0..=largest).map(f32::from).collect();
            assert!(depth.values() == want, "{largest}");
        }
    }

    #[test]
    fn png_keeps_its_sixteen_bits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("1.png");
        let picture = image::ImageBuffer::<image::Luma<u16>, _>::from_vec(2, 1, vec![5000, 65534]);
        picture.unwrap().save(&path).unwrap();
        let depth = read_depth(&path, 5000.0).unwrap();
        assert_eq!(depth.values(), [1.0, 65534.0 / 5000.0]);
    }

    #[test]
    fn what_is_no_depth_image_is_refused_by_its_header() {
        let rgb = image::RgbImage::new(2, 2);
        let grey = image::GrayImage::new(2, 2);
        for picture in [DynamicImage::from(rgb), DynamicImage::from(grey)] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("1.png");
            picture.save(&path).unwrap();
            let message = PictureHeader::read_depth(&path).err().unwrap().to_string();
            assert!(message.contains("16-bit"), "{message}");
        }
        for bytes in [
            &b""[..],
            b"hello",
            b"P5 2 2 65535",
            b"P5 99999 99999 65535\n\0\0",
        ] {
            let (_folder, path) = written("1.png", bytes);
            let read = PictureHeader::read_depth(&path).and_then(|_| read_depth(&path, 1.0));
            assert!(read.is_err(), "{bytes:?}");
        }
    }

    #[test]
    fn a_truncated_depth_image_is_refused() {
        let (_folder, path) = written("1.pgm", b"P5 2 2 65535\n\0\x01\0\x01\0");
        assert!(read_depth(&path, 1.0).is_err());
    }
}
