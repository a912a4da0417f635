//! Writing and reading files so that nobody ever meets half of one.

use crate::{Error, Map, Result};
use image::RgbImage;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Serialize, de::DeserializeOwned};
use std::{
    collections::HashMap,
    fs,
    io::{self, BufWriter, Write},
    path::Path,
};
use tempfile::NamedTempFile;

/// What names of unfinished files begin with; left behind only by a killed process.
pub const TEMPORARY_PREFIX: &str = ".tid3r-unfinished-";

/// Writes a file under a temporary name beside it and renames it when it is whole.
///
/// # Errors
/// When the folder cannot be created or written to.
pub fn write_atomically(
    path: &Path,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<()> {
    let mut writer = BufWriter::new(unfinished(path)?);
    content(&mut writer)
        .and_then(|()| writer.flush())
        .map_err(Error::io("write", path))?;
    let file = writer
        .into_inner()
        .map_err(|error| Error::io("write", path)(error.into_error()))?;
    finish(file, path)
}

/// A file under a temporary name beside `path`, which is gone again if it is dropped before it is whole.
///
/// # Errors
/// When the folder cannot be created or written to.
pub(crate) fn unfinished(path: &Path) -> Result<NamedTempFile> {
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY_PREFIX);
    // Temporary files are private by default; these become ordinary ones.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder
        .tempfile_in(folder)
        .map_err(Error::io("write", path))
}

/// Renames an unfinished file, which is whole now, to `path`.
///
/// # Errors
/// When that cannot be done.
pub(crate) fn finish(file: NamedTempFile, path: &Path) -> Result<()> {
    file.as_file()
        .sync_all()
        .map_err(Error::io("write", path))?;
    file.persist(path)
        .map_err(|error| Error::io("write", path)(error.error))?;
    Ok(())
}

/// Writes a value as indented JSON.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    write_atomically(path, |writer| {
        serde_json::to_writer_pretty(&mut *writer, value)?;
        writer.write_all(b"\n")
    })
}

/// Reads a file; `remedy` is the advice when there is none.
///
/// # Errors
/// When the file cannot be read.
pub(crate) fn read(path: &Path, remedy: &str) -> Result<Vec<u8>> {
    fs::read(path).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => Error::file(path, "is missing", remedy),
        _ => Error::io("read", path)(error),
    })
}

/// Reads a JSON file; `remedy` is the advice when it is missing or does not hold what it should.
///
/// # Errors
/// When the file cannot be read or does not hold a `T`.
pub fn read_json<T: DeserializeOwned>(path: &Path, remedy: &str) -> Result<T> {
    let text = read(path, remedy)?;
    serde_json::from_slice(&text)
        .map_err(|error| Error::file(path, format!("is not what it should be ({error})"), remedy))
}

/// Writes a picture as PNG.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_png(path: &Path, image: &RgbImage) -> Result<()> {
    encode_png(
        path,
        image,
        image.dimensions(),
        image::ExtendedColorType::Rgb8,
    )
}

/// Writes a picture as PNG, with texts (keyword and words, ASCII) that programs show as its properties.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_png_with_text(path: &Path, image: &RgbImage, texts: &[(&str, String)]) -> Result<()> {
    let encode = |writer: &mut dyn Write| -> Result<(), png::EncodingError> {
        let mut encoder = png::Encoder::new(writer, image.width(), image.height());
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        for (keyword, words) in texts {
            encoder.add_text_chunk((*keyword).to_string(), words.clone())?;
        }
        let mut writer = encoder.write_header()?;
        writer.write_image_data(image.as_raw())?;
        writer.finish()
    };
    write_atomically(path, |writer| encode(writer).map_err(io::Error::other))
}

/// Writes a map of yes and no as a black and white PNG (white: yes).
///
/// # Errors
/// As [`write_atomically`].
pub fn write_mask_png(path: &Path, mask: &Map<bool>) -> Result<()> {
    let grey: Vec<u8> = mask
        .values()
        .iter()
        .map(|&yes| if yes { 255 } else { 0 })
        .collect();
    encode_png(
        path,
        &grey,
        (mask.width(), mask.height()),
        image::ExtendedColorType::L8,
    )
}

/// Writes labels as a grey PNG of 16 bits; labels above 65535 become 0, none.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_label_png(path: &Path, labels: &Map<u32>) -> Result<()> {
    let values = labels.values().iter();
    // The encoder takes 16-bit values in the machine's own order.
    let bytes = values.flat_map(|&label| u16::try_from(label).unwrap_or(0).to_ne_bytes());
    encode_png(
        path,
        &bytes.collect::<Vec<_>>(),
        (labels.width(), labels.height()),
        image::ExtendedColorType::L16,
    )
}

fn encode_png(
    path: &Path,
    pixels: &[u8],
    (width, height): (u32, u32),
    colour: image::ExtendedColorType,
) -> Result<()> {
    use image::{ImageEncoder, codecs::png::PngEncoder};
    write_atomically(path, |writer| {
        PngEncoder::new(writer)
            .write_image(pixels, width, height, colour)
            .map_err(io::Error::other)
    })
}

/// A type that maps on disk can hold.
pub trait Element: Copy {
    /// The type's name in safetensors.
    const DTYPE: Dtype;
    /// Appends the little-endian bytes.
    fn write(self, bytes: &mut Vec<u8>);
    /// The value of exactly as many bytes as the type has.
    fn read(bytes: &[u8]) -> Self;
}

impl Element for f32 {
    const DTYPE: Dtype = Dtype::F32;
    fn write(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }
    fn read(bytes: &[u8]) -> Self {
        Self::from_le_bytes(std::array::from_fn(|k| bytes[k]))
    }
}

impl Element for u32 {
    const DTYPE: Dtype = Dtype::U32;
    fn write(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }
    fn read(bytes: &[u8]) -> Self {
        Self::from_le_bytes(std::array::from_fn(|k| bytes[k]))
    }
}

impl Element for bool {
    const DTYPE: Dtype = Dtype::BOOL;
    fn write(self, bytes: &mut Vec<u8>) {
        bytes.push(self.into());
    }
    fn read(bytes: &[u8]) -> Self {
        bytes[0] != 0
    }
}

/// The little-endian bytes of a map's values.
pub fn bytes_of<T: Element>(map: &Map<T>) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(map.len() * T::DTYPE.bitsize() / 8);
    for &value in map.values() {
        value.write(&mut bytes);
    }
    bytes
}

/// Writes maps of one frame as a safetensors file, each a (height, width) tensor under its name,
/// with a `recipe` (what the maps were made from) in the metadata.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_maps<T: Element>(
    path: &Path,
    maps: &[(impl AsRef<str>, &Map<T>)],
    recipe: &str,
) -> Result<()> {
    let bytes: Vec<Vec<u8>> = maps.iter().map(|(_, map)| bytes_of(map)).collect();
    let broken = |error: safetensors::SafeTensorError| {
        Error::file(
            path,
            format!("cannot be encoded ({error})"),
            "report this as a defect",
        )
    };
    let views = maps
        .iter()
        .zip(&bytes)
        .map(|((name, map), bytes)| {
            let shape = vec![map.height() as usize, map.width() as usize];
            Ok((
                name.as_ref(),
                TensorView::new(T::DTYPE, shape, bytes).map_err(broken)?,
            ))
        })
        .collect::<Result<Vec<_>>>()?;
    let metadata = HashMap::from([("recipe".to_string(), recipe.to_string())]);
    let file = safetensors::serialize(views, Some(metadata)).map_err(broken)?;
    write_atomically(path, |writer| writer.write_all(&file))
}

/// Maps of one frame, in memory.
pub struct MapFile<'a> {
    path: &'a Path,
    remedy: &'a str,
    bytes: Vec<u8>,
}

impl<'a> MapFile<'a> {
    /// Reads a file that [`write_maps`] wrote; `remedy` is the advice when it is damaged or
    /// missing.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn open(path: &'a Path, remedy: &'a str) -> Result<Self> {
        let bytes = read(path, remedy)?;
        Ok(Self {
            path,
            remedy,
            bytes,
        })
    }

    /// What the maps were made from; `None` for a file that is damaged.
    pub fn recipe(&self) -> Option<String> {
        let (_, metadata) = SafeTensors::read_metadata(&self.bytes).ok()?;
        SafeTensors::deserialize(&self.bytes).ok()?;
        metadata.metadata().as_ref()?.get("recipe").cloned()
    }

    /// Whether there is a map of this name, in a file that is not damaged.
    pub fn holds(&self, name: &str) -> bool {
        SafeTensors::deserialize(&self.bytes).is_ok_and(|file| file.tensor(name).is_ok())
    }

    /// One of the maps.
    ///
    /// # Errors
    /// When the file is damaged or holds no such map of this type.
    pub fn map<T: Element>(&self, name: &str) -> Result<Map<T>> {
        let damaged = |problem: String| Error::file(self.path, problem, self.remedy);
        let file = SafeTensors::deserialize(&self.bytes)
            .map_err(|error| damaged(format!("is damaged ({error})")))?;
        let tensor = file
            .tensor(name)
            .map_err(|error| damaged(format!("lacks the map '{name}' ({error})")))?;
        let &[height, width] = tensor.shape() else {
            return Err(damaged(format!(
                "holds '{name}' with {} axes, not 2",
                tensor.shape().len()
            )));
        };
        if tensor.dtype() != T::DTYPE {
            return Err(damaged(format!(
                "holds '{name}' as {:?}, not {:?}",
                tensor.dtype(),
                T::DTYPE
            )));
        }
        let values = tensor
            .data()
            .chunks_exact(T::DTYPE.bitsize() / 8)
            .map(T::read)
            .collect();
        u32::try_from(width)
            .ok()
            .zip(u32::try_from(height).ok())
            .and_then(|(width, height)| Map::new(width, height, values))
            .ok_or_else(|| damaged(format!("holds '{name}' with an impossible size")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_survive_the_disk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/maps.safetensors");
        let depth = Map::from_fn(3, 2, |x, y| x as f32 + 0.5 * y as f32);
        write_maps(&path, &[("depth", &depth)], "recipe").unwrap();
        let file = MapFile::open(&path, "start over").unwrap();
        assert_eq!(file.map::<f32>("depth").unwrap(), depth);
        assert_eq!(file.recipe().as_deref(), Some("recipe"));
        let message = file.map::<u32>("depth").unwrap_err().to_string();
        assert!(
            message.contains("F32") && message.contains("start over"),
            "{message}"
        );
        assert!(
            file.map::<f32>("other")
                .unwrap_err()
                .to_string()
                .contains("lacks")
        );
        assert_eq!(
            fs::read_dir(path.parent().unwrap()).unwrap().count(),
            1,
            "nothing left over"
        );
    }

    #[test]
    fn damaged_files_are_errors_whatever_the_damage() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("maps.safetensors");
        write_maps(&path, &[("v", &Map::filled(4, 4, true))], "").unwrap();
        let whole = fs::read(&path).unwrap();
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            let file = MapFile::open(&path, "start over").unwrap();
            assert!(
                file.map::<bool>("v").is_err() && file.recipe().is_none(),
                "{length}"
            );
        }
        fs::write(&path, [0xff; 64]).unwrap();
        assert!(MapFile::open(&path, "").unwrap().map::<bool>("v").is_err());
    }

    #[test]
    fn a_failed_write_leaves_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_atomically(&path, |writer| writer.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |writer| {
            writer.write_all(b"new")?;
            Err(io::Error::other("full"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(
            fs::read_dir(folder.path()).unwrap().count(),
            1,
            "nothing left over"
        );
    }
}
