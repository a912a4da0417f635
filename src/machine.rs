//! What this machine has, and what this process has taken of it.

use std::fs;

/// What the program itself takes while a network runs, about.
pub(crate) const PROGRAM_BYTES: u64 = 60_000_000;

/// Memory that programs can still take without swapping, in bytes; `None` where the system does not
/// say.
pub fn available_memory() -> Option<u64> {
    kilobytes("/proc/meminfo", "MemAvailable:")
}

/// The most memory that this process has had at once, in bytes, mapped files included, since it began
/// or since [`forget_peak_memory`]; `None` where the system does not say.
pub fn peak_memory() -> Option<u64> {
    kilobytes("/proc/self/status", "VmHWM:")
}

/// Lets [`peak_memory`] begin anew, where the system can do that.
pub fn forget_peak_memory() {
    // 5 is the code for just that; elsewhere the file is not there, and peaks are of the whole run.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// The number of kilobytes in the line of `file` that begins with `name`, as bytes.
fn kilobytes(file: &str, name: &str) -> Option<u64> {
    let text = fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let number: u64 = line.split_whitespace().next()?.parse().ok()?;
    number.checked_mul(1024)
}

/// `bytes` for people, in GB or MB.
pub fn readable_bytes(bytes: u64) -> String {
    let bytes = bytes as f64;
    if bytes >= 1e9 {
        format!("{:.1} GB", bytes / 1e9)
    } else {
        format!("{:.0} MB", bytes / 1e6)
    }
}

/// `seconds` for people.
pub fn readable_seconds(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// "1 view", "5 views".
pub(crate) fn counted(count: usize, what: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} {what}{ending}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_are_readable() {
        assert_eq!(readable_bytes(2_650_000_000), "2.6 GB");
        assert_eq!(readable_bytes(51_400_000), "51 MB");
        assert_eq!(readable_seconds(42.4), "42 s");
        assert_eq!(readable_seconds(150.0), "2 min");
        assert_eq!(readable_seconds(9000.0), "2.5 h");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_peak_is_at_least_what_is_held() {
        forget_peak_memory();
        let held = vec![1_u8; 64 << 20];
        assert!(peak_memory().unwrap() >= held.len() as u64);
        assert!(available_memory().unwrap() > 0);
    }
}
