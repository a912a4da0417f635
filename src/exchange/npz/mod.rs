//! NumPy's archives, `.npz`: ZIP files of arrays.
//!
//! Arrays of single and double precision are read and written; values pass as f64, which holds both exactly.

mod header;

pub use header::{Header, Number};

use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use zip::{ZipArchive, ZipWriter, result::ZipError, write::SimpleFileOptions};

/// What deflate can shrink zeros by, at most (zlib's technical notes).
const DEFLATE_LIMIT: u64 = 1032;
/// Names that are listed where one is missing.
const NAMES: usize = 10;

/// An archive that is read with care: it may be damaged or made to do harm.
pub struct NpzReader<R> {
    zip: ZipArchive<R>,
    /// Bytes of the archive.
    length: u64,
}

impl<R: Read + Seek> NpzReader<R> {
    /// # Errors
    /// When it is no ZIP file.
    pub fn new(mut reader: R) -> Result<Self, ZipError> {
        let length = reader.seek(SeekFrom::End(0))?;
        let zip = ZipArchive::new(reader)?;
        Ok(Self { zip, length })
    }

    /// The array called `name`, its header read and checked.
    ///
    /// # Errors
    /// What is wrong, as in "the array `depths` ...".
    pub fn array(&mut self, name: &str) -> Result<Array<impl Read>, String> {
        let Some(index) = self.zip.index_for_name(&file_name(name)) else {
            let names = self.zip.file_names().filter_map(Result::ok);
            let names = names.filter_map(|name| name.strip_suffix(".npy").map(str::to_string));
            let found: Vec<String> = names.take(NAMES).collect();
            return Err(format!("is missing (there are: {})", found.join(", ")));
        };
        let entry = self.zip.by_index(index);
        let entry = entry.map_err(|error| format!("cannot be unpacked ({error})"))?;
        let (bytes, packed_bytes) = (entry.size(), entry.compressed_size());
        let mut values = BufReader::new(entry);
        let (header, header_bytes) = Header::read(&mut values)?;
        let expected = header.value_bytes();
        let expected = expected.and_then(|values| values.checked_add(header_bytes as u64));
        // The directory may lie about both sizes.
        let is_there = packed_bytes <= self.length && bytes / DEFLATE_LIMIT <= packed_bytes;
        if expected != Some(bytes) || !is_there {
            return Err(format!(
                "does not have the values that its shape {:?} needs",
                header.shape
            ));
        }
        Ok(Array { header, values })
    }
}

/// An array whose values have not been read yet.
#[derive(Debug)]
pub struct Array<R> {
    /// What it is.
    pub header: Header,
    values: R,
}

impl<R: Read> Array<R> {
    /// Hands every value to `take`, in the order in which they are stored, with its place among all if the last axis
    /// runs fastest.
    ///
    /// # Errors
    /// When it is damaged, as in "the array `depths` ...".
    pub fn read(mut self, mut take: impl FnMut(usize, f64)) -> Result<(), String> {
        let damaged = |error: io::Error| format!("is damaged ({error})");
        let shape = &self.header.shape;
        let count: usize = shape.iter().product();
        let mut bytes = [0; 8];
        for stored in 0..count {
            let value = match self.header.number {
                Number::F32 => {
                    let mut bytes = [0; 4];
                    self.values.read_exact(&mut bytes).map_err(damaged)?;
                    f64::from(f32::from_le_bytes(bytes))
                }
                Number::F64 => {
                    self.values.read_exact(&mut bytes).map_err(damaged)?;
                    f64::from_le_bytes(bytes)
                }
            };
            let place = match self.header.fortran_order {
                true => last_axis_fastest(stored, shape),
                false => stored,
            };
            take(place, value);
        }
        // The archive's checksum is compared at the end of the entry.
        match self.values.read(&mut [0]).map_err(damaged)? {
            0 => Ok(()),
            _ => Err("has more values than its shape needs".into()),
        }
    }
}

/// The place of an element with the last axis running fastest, which is the `stored`-th with the first one doing so.
fn last_axis_fastest(mut stored: usize, shape: &[usize]) -> usize {
    let mut stride: usize = shape.iter().product();
    let mut place = 0;
    for &side in shape {
        stride /= side;
        place += stored % side * stride;
        stored /= side;
    }
    place
}

/// An archive that is being written. The same arrays make the same bytes.
pub struct NpzWriter<W: Write + Seek>(ZipWriter<W>);

impl<W: Write + Seek> NpzWriter<W> {
    /// Without arrays.
    pub fn new(out: W) -> Self {
        Self(ZipWriter::new(out))
    }

    /// Adds an array; its values come in the order that `header` says.
    ///
    /// # Errors
    /// When it cannot be written, or there are more or fewer values than the header says.
    pub fn add(
        &mut self,
        name: &str,
        header: &Header,
        values: impl IntoIterator<Item = f64>,
    ) -> io::Result<()> {
        let mut bytes = header.to_bytes();
        let start = bytes.len();
        for value in values {
            match header.number {
                Number::F32 => bytes.extend((value as f32).to_le_bytes()),
                Number::F64 => bytes.extend(value.to_le_bytes()),
            }
        }
        if header.value_bytes() != Some((bytes.len() - start) as u64) {
            return Err(io::Error::other(
                "an array's values are not as many as its shape needs",
            ));
        }
        // Without a time, which would make each file another.
        let options = SimpleFileOptions::default().last_modified_time(zip::DateTime::default());
        self.0.start_file(file_name(name), options)?;
        self.0.write_all(&bytes)
    }

    /// Writes the directory, and gives back what was written to.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(self) -> io::Result<W> {
        Ok(self.0.finish()?)
    }
}

fn file_name(array: &str) -> String {
    format!("{array}.npy")
}

#[cfg(test)]
mod tests;
