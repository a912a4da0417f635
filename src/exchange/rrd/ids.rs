//! What Rerun tells recordings, chunks, rows and entities apart by.

use super::protobuf::Message;
use sha2::{Digest, Sha256};

/// A number of 128 bits that no other row or chunk has, in any recording: viewers keep decoded pictures by it.
/// Rerun's are of the time and of chance; these are of the recording's id and a count, so that the same
/// contents give the same file. Of rows for one component of one entity, the highest counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tuid {
    high: u64,
    low: u64,
}

impl Tuid {
    /// All ids of a recording, in order.
    pub(super) fn all(recording: &str) -> impl Iterator<Item = Self> {
        let digest: [u8; 32] = Sha256::digest(recording).into();
        // One bit less: the first is a time to Rerun, the second counts up.
        let number = |k: usize| {
            let bytes = std::array::from_fn(|byte| digest[8 * k + byte]);
            u64::from_be_bytes(bytes) >> 1
        };
        let (high, low) = (number(0), number(1));
        (low..).map(move |low| Self { high, low })
    }

    /// As tables have it.
    pub(super) fn bytes(self) -> [u8; 16] {
        (u128::from(self.high) << 64 | u128::from(self.low)).to_be_bytes()
    }

    /// As metadata have it.
    pub(super) fn of_chunk(self) -> String {
        format!("chunk_{:016X}{:016x}", self.high, self.low)
    }

    /// As messages have it.
    pub(super) fn message(self) -> Message {
        Message::default()
            .fixed64(1, self.high)
            .fixed64(2, self.low)
    }
}

/// A path as Rerun writes it: `/scene/old\ chair`.
pub(super) fn entity_path(parts: &[String]) -> String {
    match parts {
        [] => "/".into(),
        parts => parts
            .iter()
            .map(|part| format!("/{}", escaped(part)))
            .collect(),
    }
}

/// A part of a path in which letters, digits and `_-.` stand for themselves.
fn escaped(part: &str) -> String {
    let mut text = String::new();
    for c in part.chars() {
        match c {
            '_' | '-' | '.' => text.push(c),
            c if c.is_alphanumeric() => text.push(c),
            c if c.is_ascii_punctuation() || c == ' ' => text.extend(['\\', c]),
            // There are four digits and no more: the rest is taken as it is.
            c if u32::from(c) <= 0xffff => text += &format!("\\u{{{:04X}}}", u32::from(c)),
            c => text.push(c),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_in_order_and_of_their_recording() {
        let ids: Vec<Tuid> = Tuid::all("a").take(3).collect();
        assert!(ids.is_sorted_by(|a, b| a.bytes() < b.bytes()));
        assert_eq!(Tuid::all("a").next(), Some(ids[0]));
        assert_ne!(Tuid::all("b").next(), Some(ids[0]));
        let id = Tuid {
            high: 0xab,
            low: 0xcd,
        };
        assert_eq!(id.of_chunk(), "chunk_00000000000000AB00000000000000cd");
        assert_eq!((id.bytes()[7], id.bytes()[15]), (0xab, 0xcd));
    }

    #[test]
    fn paths_are_escaped() {
        let path = |parts: &[&str]| {
            entity_path(&parts.iter().map(|&part| part.into()).collect::<Vec<_>>())
        };
        assert_eq!(path(&[]), "/");
        assert_eq!(
            path(&["scene", "grüner Sessel/2"]),
            "/scene/grüner\\ Sessel\\/2"
        );
        assert_eq!(path(&["a\\b", "x_1-2.3"]), "/a\\\\b/x_1-2.3");
        assert_eq!(path(&["\u{7}€🛋"]), "/\\u{0007}\\u{20AC}🛋");
    }
}
