//! Where in a file the numbers of a tensor are, and how they are read.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};

use half::{bf16, f16};
use safetensors::Dtype;

/// Bytes that are read at a time: the memory that reading a tensor takes, whatever its size.
const CHUNK: usize = 1 << 20;

/// The most dimensions a tensor can have.
pub(crate) const MOST_DIMENSIONS: usize = 16;

/// A tensor in a file: uncompressed, little-endian, its elements at fixed distances.
#[derive(Clone, Debug)]
pub(crate) struct StoredTensor {
    dtype: Dtype,
    shape: Vec<usize>,
    /// Distances in elements between neighbours along each dimension.
    strides: Vec<usize>,
    /// Byte of the file at which the first element is.
    start: u64,
    elements: usize,
    /// Elements from the first to the last, both included.
    extent: usize,
}

impl StoredTensor {
    /// A tensor of `shape`, row-major, that starts at byte `start`; `None` if its size overflows or it
    /// has too many dimensions.
    pub(crate) fn row_major(dtype: Dtype, shape: Vec<usize>, start: u64) -> Option<Self> {
        let mut strides = vec![1; shape.len()];
        let mut inner = 1_usize;
        for (stride, &size) in strides.iter_mut().zip(&shape).rev() {
            *stride = inner;
            inner = inner.checked_mul(size)?;
        }
        Self::strided(dtype, shape, strides, start)
    }

    /// A tensor of `shape` with as many `strides`; `None` if a size overflows or it has too many
    /// dimensions.
    pub(crate) fn strided(
        dtype: Dtype,
        shape: Vec<usize>,
        strides: Vec<usize>,
        start: u64,
    ) -> Option<Self> {
        if shape.len() > MOST_DIMENSIONS {
            return None;
        }
        let elements = shape.iter().copied().try_fold(1, usize::checked_mul)?;
        elements.checked_mul(dtype.bitsize())?;
        let last = shape
            .iter()
            .zip(&strides)
            .try_fold(0_usize, |sum, (&size, &stride)| {
                sum.checked_add(size.saturating_sub(1).checked_mul(stride)?)
            });
        let extent = if elements == 0 {
            0
        } else {
            last?.checked_add(1)?
        };
        extent.checked_mul(dtype.bitsize())?;
        Some(Self {
            dtype,
            shape,
            strides,
            start,
            elements,
            extent,
        })
    }

    pub(crate) fn dtype(&self) -> Dtype {
        self.dtype
    }

    pub(crate) fn shape(&self) -> &[usize] {
        &self.shape
    }

    pub(crate) fn elements(&self) -> usize {
        self.elements
    }

    /// Bytes from the first element to the end of the last.
    pub(crate) fn extent_bytes(&self) -> usize {
        self.extent * self.element_bytes()
    }

    fn element_bytes(&self) -> usize {
        self.dtype.bitsize() / 8
    }

    fn is_row_major(&self) -> bool {
        let mut inner = 1;
        self.shape
            .iter()
            .zip(&self.strides)
            .rev()
            .all(|(&size, &stride)| {
                let fits = size == 1 || stride == inner;
                inner *= size;
                fits
            })
    }

    /// Reads the elements in row-major order and hands them over, as many at a time as suits.
    ///
    /// A tensor whose elements are not in that order in the file is read whole first.
    pub(crate) fn read<E>(
        &self,
        file: &File,
        read_error: impl Fn(io::Error) -> E,
        mut take: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut file = file;
        file.seek(SeekFrom::Start(self.start))
            .map_err(&read_error)?;
        let size = self.element_bytes();
        if self.elements == 0 {
            return Ok(());
        }
        if self.is_row_major() {
            let mut buffer = vec![0; CHUNK.min(self.elements * size)];
            let mut left = self.elements * size;
            while left > 0 {
                let part = &mut buffer[..CHUNK.min(left)];
                file.read_exact(part).map_err(&read_error)?;
                take(part)?;
                left -= part.len();
            }
            return Ok(());
        }
        let mut bytes = Vec::new();
        let wanted = self.extent_bytes();
        file.take(wanted as u64)
            .read_to_end(&mut bytes)
            .map_err(&read_error)?;
        if bytes.len() < wanted {
            return Err(read_error(io::ErrorKind::UnexpectedEof.into()));
        }
        let mut part = Vec::with_capacity(CHUNK);
        let mut index = vec![0; self.shape.len()];
        let mut offset = 0;
        for _ in 0..self.elements {
            part.extend_from_slice(&bytes[offset * size..][..size]);
            if part.len() >= CHUNK {
                take(&part)?;
                part.clear();
            }
            for (i, (&n, &stride)) in self.shape.iter().zip(&self.strides).enumerate().rev() {
                index[i] += 1;
                offset += stride;
                if index[i] < n {
                    break;
                }
                index[i] = 0;
                offset -= n * stride;
            }
        }
        take(&part)
    }
}

/// Whether elements of this type are real numbers that a network can be made of.
pub(crate) fn is_float(dtype: Dtype) -> bool {
    matches!(dtype, Dtype::F64 | Dtype::F32 | Dtype::F16 | Dtype::BF16)
}

/// Calls `each` with the elements in `bytes`, which are of the float type `dtype`, rounded to f32:
/// what is too large for it becomes infinite.
pub(crate) fn widen(dtype: Dtype, bytes: &[u8], mut each: impl FnMut(f32)) {
    fn all<const N: usize>(bytes: &[u8], each: impl FnMut([u8; N])) {
        bytes.as_chunks().0.iter().copied().for_each(each);
    }
    match dtype {
        Dtype::F64 => all(bytes, |b| each(f64::from_le_bytes(b) as f32)),
        Dtype::F16 => all(bytes, |b| each(f16::from_le_bytes(b).to_f32())),
        Dtype::BF16 => all(bytes, |b| each(bf16::from_le_bytes(b).to_f32())),
        _ => all(bytes, |b| each(f32::from_le_bytes(b))),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    /// A file with the bytes 0, 1, 2, ..
    fn counting(count: u8) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&(0..count).collect::<Vec<_>>()).unwrap();
        file
    }

    fn read(tensor: &StoredTensor, file: &File) -> io::Result<Vec<u8>> {
        let mut all = Vec::new();
        tensor.read(
            file,
            |e| e,
            |part| {
                all.extend_from_slice(part);
                Ok(())
            },
        )?;
        Ok(all)
    }

    #[test]
    fn elements_come_in_row_major_order_whatever_their_order_in_the_file() {
        let file = counting(24);
        let plain = StoredTensor::row_major(Dtype::U8, vec![2, 3], 5).unwrap();
        assert_eq!(read(&plain, &file).unwrap(), [5, 6, 7, 8, 9, 10]);
        let transposed = StoredTensor::strided(Dtype::U8, vec![2, 3], vec![1, 2], 5).unwrap();
        assert_eq!(read(&transposed, &file).unwrap(), [5, 7, 9, 6, 8, 10]);
        // Columns 1 and 3 of a 2 x 5 matrix of 16-bit numbers.
        let columns = StoredTensor::strided(Dtype::U16, vec![2, 2], vec![5, 2], 2).unwrap();
        assert_eq!(read(&columns, &file).unwrap(), [2, 3, 6, 7, 12, 13, 16, 17]);
        let repeated = StoredTensor::strided(Dtype::U8, vec![3], vec![0], 4).unwrap();
        assert_eq!(
            (repeated.extent_bytes(), read(&repeated, &file).unwrap()),
            (1, vec![4; 3])
        );
        let scalar = StoredTensor::row_major(Dtype::U8, vec![], 3).unwrap();
        assert_eq!(read(&scalar, &file).unwrap(), [3]);
        let empty = StoredTensor::row_major(Dtype::U8, vec![4, 0], 3).unwrap();
        assert!(read(&empty, &file).unwrap().is_empty());
    }

    #[test]
    fn a_file_that_ends_too_early_is_an_error() {
        let file = counting(6);
        for strides in [vec![3, 1], vec![1, 4]] {
            let tensor = StoredTensor::strided(Dtype::U8, vec![2, 3], strides, 1).unwrap();
            assert!(read(&tensor, &file).is_err());
        }
    }

    #[test]
    fn sizes_that_overflow_are_none() {
        let huge = usize::MAX / 2;
        assert!(StoredTensor::row_major(Dtype::F32, vec![huge, 3], 0).is_none());
        assert!(StoredTensor::row_major(Dtype::F32, vec![huge], 0).is_none());
        assert!(StoredTensor::strided(Dtype::F32, vec![3], vec![huge], 0).is_none());
        assert!(StoredTensor::strided(Dtype::F32, vec![2], vec![huge], 0).is_none());
    }

    #[test]
    fn every_float_type_becomes_f32() {
        let widened = |dtype, bytes: &[u8]| {
            let mut values = Vec::new();
            widen(dtype, bytes, |value| values.push(value));
            values
        };
        assert_eq!(widened(Dtype::F32, &1.5_f32.to_le_bytes()), [1.5]);
        assert_eq!(
            widened(Dtype::F64, &1e300_f64.to_le_bytes()),
            [f32::INFINITY]
        );
        assert_eq!(
            widened(Dtype::F16, &f16::from_f32(-0.25).to_le_bytes()),
            [-0.25]
        );
        assert_eq!(widened(Dtype::BF16, &[0x80, 0x3f, 0, 0xc0]), [1.0, -2.0]);
    }
}
