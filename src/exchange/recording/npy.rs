//! One array of an `.npz` archive, read with care: the file may be damaged or made to do harm.

use npyz::{DType, NpyFile, NpyHeader, Order, npz::NpzArchive};
use std::io::{BufReader, Read, Seek};

/// NumPy's own headers for plain arrays of three axes take 118 or 246 bytes.
const HEADER_LIMIT: usize = 1024;
/// A product of numbers with this many decimal digits in all fits 64 bits.
const DIGITS_LIMIT: usize = 19;
/// What deflate can shrink zeros by, at most (zlib's technical notes).
const DEFLATE_LIMIT: u64 = 1032;

/// What an array is, before its values are read.
pub(super) struct ArrayHeader {
    /// Along each of the three axes.
    pub(super) shape: [usize; 3],
    double: bool,
    fortran: bool,
}

/// An array of float32 or float64 with three axes, its header read and checked.
pub(super) struct Array<R> {
    pub(super) header: ArrayHeader,
    npy: NpyHeader,
    values: R,
}

impl<'a> Array<BufReader<Box<dyn Read + 'a>>> {
    /// Errors are what is wrong, as in "the array `depths` ...".
    pub(super) fn open<S: Read + Seek>(
        npz: &'a mut NpzArchive<S>,
        name: &str,
    ) -> Result<Self, String> {
        if !npz.array_names().any(|found| found == name) {
            let found: Vec<&str> = npz.array_names().take(10).collect();
            return Err(format!("is missing (there are: {})", found.join(", ")));
        }
        let entry = npz
            .zip_archive()
            .by_name(&npyz::npz::file_name_from_array_name(name))
            .map_err(|error| format!("cannot be unpacked ({error})"))?;
        let (bytes, packed_bytes) = (entry.size(), entry.compressed_size());
        let mut values = BufReader::new(Box::new(entry) as Box<dyn Read>);
        let header_bytes = read_header(&mut values)?;
        let npy = NpyHeader::from_reader(&*header_bytes)
            .map_err(|error| format!("has a damaged header ({error})"))?;
        let header = ArrayHeader::check(&npy)?;
        let value_bytes = if header.double { 8 } else { 4 };
        let expected = header
            .shape
            .iter()
            .try_fold(value_bytes, |bytes: u64, &side| {
                bytes.checked_mul(side as u64)
            });
        let expected = expected.and_then(|values| values.checked_add(header_bytes.len() as u64));
        if expected != Some(bytes) || bytes / DEFLATE_LIMIT > packed_bytes {
            return Err(format!(
                "does not have the values that its shape {:?} needs",
                header.shape
            ));
        }
        Ok(Self {
            header,
            npy,
            values,
        })
    }

    /// Hands every value with its index to `take`, in the order in which they are stored.
    pub(super) fn read(mut self, mut take: impl FnMut([usize; 3], f64)) -> Result<(), String> {
        let [a, b, c] = self.header.shape;
        let fortran = self.header.fortran;
        let mut hand = |(place, value): (usize, f64)| {
            let index = if fortran {
                [place % a, place / a % b, place / a / b]
            } else {
                [place / c / b, place / c % b, place % c]
            };
            take(index, value);
        };
        let damaged = |error: std::io::Error| format!("is damaged ({error})");
        let file = NpyFile::with_header(self.npy, &mut self.values);
        if self.header.double {
            let values = file.data::<f64>().map_err(|error| error.to_string())?;
            for (place, value) in values.enumerate() {
                hand((place, value.map_err(damaged)?));
            }
        } else {
            let values = file.data::<f32>().map_err(|error| error.to_string())?;
            for (place, value) in values.enumerate() {
                hand((place, f64::from(value.map_err(damaged)?)));
            }
        }
        // The archive's checksum is compared at the end of the entry.
        match self.values.read(&mut [0]).map_err(damaged)? {
            0 => Ok(()),
            _ => Err("has more values than its shape needs".into()),
        }
    }
}

impl ArrayHeader {
    fn check(npy: &NpyHeader) -> Result<Self, String> {
        let double = match &npy.dtype() {
            DType::Plain(dtype) if dtype.to_string() == "<f4" => false,
            DType::Plain(dtype) if dtype.to_string() == "<f8" => true,
            other => {
                return Err(format!(
                    "holds numbers of the type {}, not '<f4' or '<f8'",
                    other.descr()
                ));
            }
        };
        let shape: Option<Vec<usize>> = npy
            .shape()
            .iter()
            .map(|&side| side.try_into().ok())
            .collect();
        let shape = shape.and_then(|shape| <[usize; 3]>::try_from(shape).ok());
        Ok(Self {
            shape: shape
                .ok_or_else(|| format!("has the shape {:?}, not three axes", npy.shape()))?,
            double,
            fortran: npy.order() == Order::Fortran,
        })
    }
}

/// The bytes of an `.npy` header, checked to be harmless to [`NpyHeader::from_reader`], which
/// multiplies the sides of the shape unchecked, follows brackets as deep as they go, and makes room
/// for as many bytes as the header says it has.
fn read_header(reader: &mut impl Read) -> Result<Vec<u8>, String> {
    let damaged = |error: std::io::Error| format!("has a damaged header ({error})");
    let mut bytes = vec![0; 10];
    reader.read_exact(&mut bytes).map_err(damaged)?;
    let mut length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    // From version 2 on, the length has four bytes.
    if bytes[6] > 1 {
        bytes.resize(12, 0);
        reader.read_exact(&mut bytes[10..]).map_err(damaged)?;
        length |= usize::from(u16::from_le_bytes([bytes[10], bytes[11]])) << 16;
    }
    if length > HEADER_LIMIT {
        return Err(format!(
            "has a header of {length} bytes, which no plain array needs"
        ));
    }
    let start = bytes.len();
    bytes.resize(start + length, 0);
    reader.read_exact(&mut bytes[start..]).map_err(damaged)?;
    let text = &bytes[start..];
    let count = |wanted: fn(&u8) -> bool| text.iter().filter(|byte| wanted(byte)).count();
    let hexadecimal = text.windows(2).any(|pair| pair.eq_ignore_ascii_case(b"0x"));
    if count(u8::is_ascii_digit) > DIGITS_LIMIT || hexadecimal {
        return Err("has an impossible shape".into());
    }
    // One for the header itself, one for the shape.
    if count(|byte| b"([{".contains(byte)) > 2 {
        return Err("is not a plain array of numbers".into());
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Cursor, Write};

    fn npy(header: &str, values: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(values);
        bytes
    }

    fn header(dtype: &str, fortran: bool, shape: &str) -> String {
        let fortran = if fortran { "True" } else { "False" };
        format!("{{'descr': '{dtype}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n")
    }

    fn archive(npy: &[u8]) -> Vec<u8> {
        let mut writer = npyz::npz::NpzWriter::new(Cursor::new(Vec::new()));
        let zip = writer.zip_writer();
        zip.start_file("x.npy", Default::default()).unwrap();
        zip.write_all(npy).unwrap();
        zip.finish().unwrap().into_inner()
    }

    /// Index and value of every element, sorted by index; or what is wrong.
    fn read(archive: &[u8]) -> Result<Vec<([usize; 3], f64)>, String> {
        let mut npz = NpzArchive::new(Cursor::new(archive)).unwrap();
        let mut values = Vec::new();
        Array::open(&mut npz, "x")?.read(|index, value| values.push((index, value)))?;
        values.sort_by_key(|(index, _)| *index);
        Ok(values)
    }

    fn counting(fortran: bool) -> Vec<f32> {
        // numpy: arange(12).reshape(2, 3, 2), its memory in either order.
        let c: Vec<f32> = (0..12u8).map(f32::from).collect();
        let fortran_order = [0, 6, 2, 8, 4, 10, 1, 7, 3, 9, 5, 11];
        if fortran {
            fortran_order.iter().map(|&i| c[i]).collect()
        } else {
            c
        }
    }

    #[test]
    fn both_orders_and_both_precisions_give_the_same_values() {
        for fortran in [false, true] {
            let values = counting(fortran);
            let single: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
            let double: Vec<u8> = values
                .iter()
                .flat_map(|&x| f64::from(x).to_le_bytes())
                .collect();
            for (dtype, bytes) in [("<f4", single), ("<f8", double)] {
                let found =
                    read(&archive(&npy(&header(dtype, fortran, "(2, 3, 2)"), &bytes))).unwrap();
                assert_eq!(found.len(), 12);
                for (want, ([i, j, k], value)) in found.into_iter().enumerate() {
                    assert_eq!(want, i * 6 + j * 2 + k);
                    assert_eq!(want as f64, value, "{dtype} {fortran}");
                }
            }
        }
    }

    #[test]
    fn what_is_no_array_of_floats_with_three_axes_is_refused() {
        for (dtype, shape, word) in [
            ("<f2", "(1, 1, 1)", "f2"),
            (">f4", "(1, 1, 1)", ">f4"),
            ("<i4", "(1, 1, 1)", "i4"),
            ("|O", "(1, 1, 1)", "O"),
            ("<f4", "(1, 1)", "three axes"),
            ("<f4", "()", "three axes"),
        ] {
            let message = read(&archive(&npy(&header(dtype, false, shape), &[0; 4]))).unwrap_err();
            assert!(message.contains(word), "{message}");
        }
    }

    #[test]
    fn headers_made_to_do_harm_are_refused() {
        let nested = format!("{{'descr': {}'<f4'", "[".repeat(900));
        for text in [
            header("<f4", false, "(4294967296, 4294967296, 4294967296)"),
            header("<f4", false, "(0xffffffffff, 0Xffffffffff, 0xffffffffff)"),
            header("<f4", false, "(100000, 100000, 100000)"),
            header("<f4", false, "(1, 1, 2)"),
            header("<f4", false, "(0, 1, 1)"),
            nested,
            String::new(),
            "{}".into(),
            "\u{0}".repeat(2000),
        ] {
            assert!(read(&archive(&npy(&text, &[0; 4]))).is_err(), "{text}");
        }
        let long = b"\x93NUMPY\x02\x00\xff\xff\xff\xff";
        assert!(
            read(&archive(long))
                .unwrap_err()
                .contains("4294967295 bytes")
        );
        assert!(read(&archive(b"\x93NUM")).is_err());
    }

    #[test]
    fn a_damaged_value_is_noticed_and_a_missing_array_named() {
        let text = header("<f4", false, "(1, 1, 2)");
        let mut bytes = archive(&npy(&text, &[0; 8]));
        assert!(read(&bytes).is_ok());
        let at = bytes.len() / 2;
        bytes[at - 40..at].fill(0x55);
        assert!(read(&bytes).is_err());
        let mut npz = NpzArchive::new(Cursor::new(archive(b""))).unwrap();
        let message = Array::open(&mut npz, "depths").err().unwrap();
        assert_eq!(message, "is missing (there are: x)");
    }
}
