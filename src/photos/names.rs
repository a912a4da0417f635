//! The order and the endings of photo files.

/// Endings of photos, in lower case.
pub(crate) const PHOTO_ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "ppm", "pgm"];

/// A part of a name; see [`natural_key`].
#[derive(PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Chunk {
    /// A run of digits without its leading zeros, the shorter being the smaller.
    Number(usize, String),
    /// What stands between digits.
    Text(String),
}

/// A key that sorts runs of digits by their value: 9 before 10.
pub(crate) fn natural_key(name: &str) -> Vec<Chunk> {
    name.as_bytes()
        .chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit())
        .map(|run| {
            // Cutting at ASCII digits cuts between characters.
            let text = String::from_utf8_lossy(run);
            if run[0].is_ascii_digit() {
                let digits = text.trim_start_matches('0');
                Chunk::Number(digits.len(), digits.to_string())
            } else {
                Chunk::Text(text.into_owned())
            }
        })
        .collect()
}
