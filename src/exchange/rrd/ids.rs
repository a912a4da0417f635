//! What Rerun tells recordings, chunks, rows and entities apart by.

use super::protobuf::Message;
use sha2::{Digest, Sha256};

/// A number that no other row or chunk has, in any recording: viewers keep decoded pictures by it. Rerun's are of
/// the time and of chance. These are of the recording's id and a count, and of no time, so that the same
/// contents give the same file. Of rows for one component of one entity, the highest counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tuid(u64);

/// What viewers show as the time of a recording, in nanoseconds since 1970.
const TIME: u64 = 0;

impl Tuid {
    /// All ids of a recording, in order.
    pub(super) fn all(recording: &str) -> impl Iterator<Item = Self> {
        let digest: [u8; 32] = Sha256::digest(recording).into();
        let first = u64::from_be_bytes(std::array::from_fn(|byte| digest[byte]));
        // One bit less leaves room to count.
        (first >> 1..).map(Self)
    }

    /// As tables have it.
    pub(super) fn bytes(self) -> [u8; 16] {
        (u128::from(TIME) << 64 | u128::from(self.0)).to_be_bytes()
    }

    /// As metadata have it.
    pub(super) fn of_chunk(self) -> String {
        format!("chunk_{TIME:016X}{:016x}", self.0)
    }

    /// As messages have it.
    pub(super) fn message(self) -> Message {
        Message::default().fixed64(1, TIME).fixed64(2, self.0)
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
        let id = Tuid(0xabcd);
        assert_eq!(id.of_chunk(), "chunk_0000000000000000000000000000abcd");
        assert_eq!(id.bytes()[14..], [0xab, 0xcd]);
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
