//! Numbers on the command line, checked when they are read: clap's value parsers.
//!
//! ```
//! use tid3r::parameters;
//!
//! assert_eq!(parameters::memory("1.5GB"), Ok(1_500_000_000));
//! assert_eq!(parameters::share("0.25"), Ok(0.25));
//! assert_eq!(parameters::share("25"), Err("a number from 0 to 1 is wanted".into()));
//!
//! #[derive(clap::Parser)]
//! struct Options {
//!     #[arg(long, value_parser = parameters::positive)]
//!     focal: f64,
//! }
//! let parsed = |focal| <Options as clap::Parser>::try_parse_from(["program", "--focal", focal]);
//! assert_eq!(parsed("500").unwrap().focal, 500.0);
//! assert!(parsed("0").is_err());
//! ```

/// A number that is neither infinite nor NaN.
///
/// # Errors
/// What is wrong with the text, as all functions here.
pub fn finite(text: &str) -> Result<f64, String> {
    let number: f64 = text
        .trim()
        .parse()
        .map_err(|_| format!("'{text}' is not a number"))?;
    let checked = number.is_finite().then_some(number);
    checked.ok_or_else(|| "a finite number is wanted".into())
}

/// A number above 0.
///
/// # Errors
/// As [`finite`].
pub fn positive(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    let checked = (number > 0.0).then_some(number);
    checked.ok_or_else(|| "a number above 0 is wanted".into())
}

/// A number that is 0 or more.
///
/// # Errors
/// As [`finite`].
pub fn not_negative(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    let checked = (number >= 0.0).then_some(number);
    checked.ok_or_else(|| "a number that is not negative is wanted".into())
}

/// [`not_negative`] in single precision.
///
/// # Errors
/// As [`finite`].
pub fn not_negative_f32(text: &str) -> Result<f32, String> {
    let number = not_negative(text)? as f32;
    let checked = number.is_finite().then_some(number);
    checked.ok_or_else(|| "a smaller number is wanted".into())
}

/// A number from 0 to 1.
///
/// # Errors
/// As [`finite`].
pub fn share(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    let checked = (0.0..=1.0).contains(&number).then_some(number);
    checked.ok_or_else(|| "a number from 0 to 1 is wanted".into())
}

/// A percentage, from 0 to 100.
///
/// # Errors
/// As [`finite`].
pub fn percentage(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    let checked = (0.0..=100.0).contains(&number).then_some(number);
    checked.ok_or_else(|| "a number from 0 to 100 is wanted".into())
}

/// A factor from 0.001 to 1000.
///
/// # Errors
/// As [`finite`].
pub fn factor(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    let checked = (1e-3..=1e3).contains(&number).then_some(number);
    checked.ok_or_else(|| "a factor from 0.001 to 1000 is wanted".into())
}

/// A distance, a coordinate or an angle: at most a million either way.
///
/// # Errors
/// As [`finite`].
pub fn coordinate(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    let checked = (number.abs() <= 1e6).then_some(number);
    checked.ok_or_else(|| "a million is the most".into())
}

/// `N` coordinates with commas between.
///
/// # Errors
/// As [`finite`].
pub fn coordinates<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers = text
        .split(',')
        .map(coordinate)
        .collect::<Result<Vec<_>, _>>()?;
    numbers
        .try_into()
        .map_err(|_| format!("{N} numbers with commas between are wanted"))
}

/// An amount of memory, in bytes: a number with a unit, as in `8GB`, `6.5GiB` or `500MB`.
///
/// # Errors
/// As [`finite`].
pub fn memory(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic() || c == ' ');
    let unit: f64 = match text[digits.len()..].trim().to_ascii_lowercase().as_str() {
        "kb" => 1e3,
        "mb" | "m" => 1e6,
        "gb" | "g" => 1e9,
        "kib" => 1024.0,
        "mib" => 1_048_576.0,
        "gib" => 1_073_741_824.0,
        _ => {
            return Err(format!(
                "'{text}' is no amount of memory, such as 8GB or 500MB"
            ));
        }
    };
    let bytes = positive(digits)? * unit;
    let checked = (bytes < 1e18).then_some(bytes as u64);
    checked.ok_or_else(|| "less memory is wanted".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_of_memory_have_units() {
        assert_eq!(memory("8GB"), Ok(8_000_000_000));
        assert_eq!(memory(" 1.5 gib "), Ok(1_610_612_736));
        assert_eq!(memory("500m"), Ok(500_000_000));
        for text in ["8", "GB", "-1GB", "8 apples", "", "1e40GB"] {
            assert!(memory(text).is_err(), "{text}");
        }
    }

    #[test]
    fn ranges_end_where_they_say() {
        assert_eq!(finite(" -1.5"), Ok(-1.5));
        assert!(finite("nan").is_err() && finite("1e999").is_err() && finite("").is_err());
        assert!(positive("0").is_err() && positive("1e-9").is_ok());
        assert!(not_negative("0").is_ok() && not_negative("-1e-9").is_err());
        assert!(not_negative_f32("1e39").is_err() && not_negative_f32("1e38").is_ok());
        assert!(percentage("100").is_ok() && percentage("100.1").is_err());
        assert!(share("1").is_ok() && share("1.01").is_err() && share("-0.01").is_err());
    }
}
