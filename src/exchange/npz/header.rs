//! The header of an `.npy` file: NumPy's format as its `numpy.lib.format` describes it, for plain arrays of
//! floating-point numbers.

use std::io::Read;

/// NumPy's own headers for arrays of a few axes take 118 or 246 bytes.
const LONGEST: usize = 1024;
/// Headers end at a multiple of this.
const ALIGNMENT: usize = 64;
const MAGIC: &[u8; 6] = b"\x93NUMPY";

/// The type of an array's numbers, the lowest byte first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

impl Number {
    /// Its size.
    pub fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn description(self) -> &'static str {
        match self {
            Self::F32 => "<f4",
            Self::F64 => "<f8",
        }
    }
}

/// What an array is, apart from its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Its length along each axis.
    pub shape: Vec<usize>,
    /// The type of its numbers.
    pub number: Number,
    /// Whether the first axis is the one along which neighbours in memory lie, rather than the last.
    pub fortran_order: bool,
}

impl Header {
    /// Of an array whose last axis is the one along which neighbours lie.
    pub fn new(shape: &[usize], number: Number) -> Self {
        Self {
            shape: shape.to_vec(),
            number,
            fortran_order: false,
        }
    }

    /// How many bytes the values take; `None` if that is more than can be counted.
    pub fn value_bytes(&self) -> Option<u64> {
        let mut sides = self.shape.iter().map(|&side| side as u64);
        sides.try_fold(self.number.bytes() as u64, u64::checked_mul)
    }

    /// The header of a file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let sides: Vec<String> = self.shape.iter().map(usize::to_string).collect();
        // A tuple of one has a comma.
        let comma = if sides.len() == 1 { "," } else { "" };
        let text = format!(
            "{{'descr': '{}', 'fortran_order': {}, 'shape': ({}{comma}), }}",
            self.number.description(),
            if self.fortran_order { "True" } else { "False" },
            sides.join(", "),
        );
        let before = MAGIC.len() + 4;
        let end = (before + text.len() + 1).next_multiple_of(ALIGNMENT);
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend(((end - before) as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.resize(end - 1, b' ');
        bytes.push(b'\n');
        bytes
    }

    /// Reads the header of a file, and says how many bytes it has.
    ///
    /// # Errors
    /// What is wrong, as in "the array `depths` ...".
    pub fn read(reader: &mut impl Read) -> Result<(Self, usize), String> {
        let damaged = |error: std::io::Error| format!("has a damaged header ({error})");
        let mut start = [0; 10];
        reader.read_exact(&mut start).map_err(damaged)?;
        if !start.starts_with(MAGIC) {
            return Err("is no array of NumPy's".into());
        }
        let mut before = start.len();
        let mut length = usize::from(u16::from_le_bytes([start[8], start[9]]));
        // From version 2 on, the length has four bytes.
        if start[6] > 1 {
            let mut rest = [0; 2];
            reader.read_exact(&mut rest).map_err(damaged)?;
            before += rest.len();
            length |= usize::from(u16::from_le_bytes(rest)) << 16;
        }
        if length > LONGEST {
            return Err(format!(
                "has a header of {length} bytes, which no plain array needs"
            ));
        }
        let mut text = vec![0; length];
        reader.read_exact(&mut text).map_err(damaged)?;
        let text = str::from_utf8(&text).map_err(|_| "has a damaged header (it is no text)")?;
        Ok((Self::parse(text)?, before + length))
    }

    /// A dictionary as Python writes it, of three entries in any order.
    fn parse(text: &str) -> Result<Self, String> {
        const DAMAGED: &str = "has a damaged header (its entries are not those of a plain array)";
        let inside = text.trim().strip_prefix('{').ok_or(DAMAGED)?;
        let mut rest = inside.strip_suffix('}').ok_or(DAMAGED)?.trim();
        let (mut number, mut fortran_order, mut shape) = (None, None, None);
        while !rest.is_empty() {
            let (key, after) = quoted(rest).ok_or(DAMAGED)?;
            let value = after.trim_start().strip_prefix(':').ok_or(DAMAGED)?;
            let value = value.trim_start();
            rest = match key {
                "descr" => {
                    let (name, after) = quoted(value).ok_or("is not a plain array of numbers")?;
                    let numbers = [Number::F32, Number::F64];
                    let known = numbers
                        .into_iter()
                        .find(|known| known.description() == name);
                    number = Some(known.ok_or_else(|| {
                        format!("holds numbers of the type '{name}', not '<f4' or '<f8'")
                    })?);
                    after
                }
                "fortran_order" => {
                    let end = value.find(',').unwrap_or(value.len());
                    let (word, after) = value.split_at(end);
                    fortran_order = Some(match word.trim_end() {
                        "True" => true,
                        "False" => false,
                        _ => return Err(DAMAGED.into()),
                    });
                    after
                }
                "shape" => {
                    let tuple = value.strip_prefix('(').ok_or(DAMAGED)?;
                    let (sides, after) = tuple.split_once(')').ok_or(DAMAGED)?;
                    shape = Some(sides_of(sides)?);
                    after
                }
                _ => return Err(DAMAGED.into()),
            };
            rest = rest.trim_start();
            rest = match rest.strip_prefix(',') {
                Some(after) => after.trim_start(),
                None if rest.is_empty() => rest,
                None => return Err(DAMAGED.into()),
            };
        }
        match (number, fortran_order, shape) {
            (Some(number), Some(fortran_order), Some(shape)) => Ok(Self {
                shape,
                number,
                fortran_order,
            }),
            _ => Err(DAMAGED.into()),
        }
    }
}

/// The text in quotation marks that `text` begins with, and what is behind it.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let mark = text.chars().next().filter(|mark| "'\"".contains(*mark))?;
    text[1..].split_once(mark)
}

/// The numbers in a tuple.
fn sides_of(text: &str) -> Result<Vec<usize>, String> {
    let text = text.trim();
    let text = text.strip_suffix(',').unwrap_or(text);
    if text.is_empty() {
        return Ok(Vec::new());
    }
    let side = |text: &str| {
        text.trim()
            .parse()
            .map_err(|_| "has an impossible shape".into())
    };
    text.split(',').map(side).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Header, String> {
        Header::parse(text)
    }

    #[test]
    fn headers_are_numpys_byte_for_byte() {
        // NumPy 1.26: np.save of zeros((480, 640), float32), and of asfortranarray(zeros((2, 3))).
        let first = "{'descr': '<f4', 'fortran_order': False, 'shape': (480, 640), }";
        let second = "{'descr': '<f8', 'fortran_order': True, 'shape': (2, 3), }";
        let mut fortran = Header::new(&[2, 3], Number::F64);
        fortran.fortran_order = true;
        for (header, text) in [
            (Header::new(&[480, 640], Number::F32), first),
            (fortran, second),
        ] {
            let wanted = format!("{text:117}\n");
            let bytes = header.to_bytes();
            assert_eq!(&bytes[..10], b"\x93NUMPY\x01\x00v\x00");
            assert_eq!(bytes[10..], *wanted.as_bytes());
            let (read, length) = Header::read(&mut &*bytes).unwrap();
            assert_eq!((read, length), (header, 128));
        }
        let one = Header::new(&[7], Number::F32).to_bytes();
        assert!(String::from_utf8_lossy(&one).contains("(7,)"));
        assert_eq!(Header::read(&mut &*one).unwrap().0.shape, [7]);
    }

    #[test]
    fn entries_come_in_any_order_and_style() {
        let plain = Header::new(&[2, 3], Number::F32);
        for text in [
            "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3)}",
            "{\"shape\":(2,3,),\"fortran_order\":False ,\"descr\":\"<f4\"}\n",
            " { 'fortran_order' : False , 'descr' : '<f4' , 'shape' : ( 2 , 3 ) , } \n",
        ] {
            assert_eq!(parse(text).as_ref(), Ok(&plain), "{text}");
        }
        assert_eq!(
            parse("{'descr': '<f8', 'fortran_order': False, 'shape': ()}").unwrap(),
            Header::new(&[], Number::F64)
        );
    }

    #[test]
    fn what_is_no_header_is_refused() {
        for text in [
            "",
            "{}",
            "{'descr': '<f4'}",
            "{'descr': '<f4' 'fortran_order': False, 'shape': (2, 3)}",
            "{'descr': '<f4', 'fortran_order': 0, 'shape': (2, 3)}",
            "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3}",
            "{'descr': '<f4', 'fortran_order': False, 'shape': (2, -3)}",
            "{'descr': '<f4', 'fortran_order': False, 'shape': (0x2, 3)}",
            "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999,)}",
            "{'descr': [('x', '<f4')], 'fortran_order': False, 'shape': (2, 3)}",
            "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), 'more': 1}",
            "{\u{e9}: 1}",
        ] {
            assert!(parse(text).is_err(), "{text}");
        }
        let vast = format!("({0}, {0}, {0})", u64::MAX);
        let text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {vast}}}");
        assert_eq!(parse(&text).unwrap().value_bytes(), None);
    }

    #[test]
    fn headers_longer_than_any_array_needs_are_not_read() {
        let long = b"\x93NUMPY\x02\x00\xff\xff\xff\xff";
        let message = Header::read(&mut &long[..]).unwrap_err();
        assert!(message.contains("4294967295 bytes"), "{message}");
        assert!(Header::read(&mut &b"\x93NUM"[..]).is_err());
        assert!(Header::read(&mut &[0; 200][..]).is_err());
    }
}
