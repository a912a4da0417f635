//! What this machine has, and what this process has taken of it.
//!
//! Whether there is room for a piece of work:
//!
//! ```
//! use tid3r::machine::{Expense, available_memory, total_memory};
//!
//! let expense = Expense { seconds: 200.0, bytes: 3_200_000_000 };
//! assert_eq!(expense.to_string(), "about 3.3 min and 3.2 GB");
//! let (free, all) = (available_memory(), total_memory());
//! assert!(free <= all);
//! // Where the system does not say, it is tried.
//! if free.is_some_and(|free| free < expense.bytes) {
//!     println!("too little memory for {expense}");
//! }
//! ```

mod cgroup;
mod device;
mod pace;

pub use device::compute_on;
pub(crate) use device::{check_type, device, network_memory};
pub(crate) use pace::{Pace, Reached, seconds_to_load};

use serde::Serialize;
use std::{fmt, fs, path::Path};

/// What the program itself takes while a network runs, about.
pub(crate) const PROGRAM_BYTES: u64 = 60_000_000;

/// Memory that this process can still take without swapping, in bytes: what is free on the machine, or what
/// the limits of its container or batch job leave, if that is less. `None` where the system does not say.
pub fn available_memory() -> Option<u64> {
    let free = kilobytes("/proc/meminfo", "MemAvailable:");
    let left = cgroup::memory().map(|allowance| allowance.left);
    // `None` is less than any number, and so has to be left out.
    free.into_iter().chain(left).min()
}

/// Memory of the machine, in bytes; `None` where the system does not say.
pub fn total_memory() -> Option<u64> {
    kilobytes("/proc/meminfo", "MemTotal:")
}

/// Memory that a container or batch job limits this process to, in bytes; `None` where there is no limit.
pub fn memory_limit() -> Option<u64> {
    cgroup::memory().map(|allowance| allowance.limit)
}

/// Cores of the machine, whatever share of them this process may use; `None` where the system does not say.
pub fn cores() -> Option<usize> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let count = lines_of(&text, "processor").count();
    (count > 0).then_some(count)
}

/// What the processor calls itself; `None` where the system does not say.
pub fn processor() -> Option<String> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let name = lines_of(&text, "model name").next()?;
    Some(name.to_string()).filter(|name| !name.is_empty())
}

/// The values of the lines `NAME : VALUE` of `/proc/cpuinfo`.
fn lines_of<'a>(text: &'a str, name: &'a str) -> impl Iterator<Item = &'a str> {
    let pairs = text.lines().filter_map(|line| line.split_once(':'));
    let named = pairs.filter(move |(key, _)| key.trim_end() == name);
    named.map(|(_, value)| value.trim())
}

/// Bytes that can still be written to the file system on which `folder` is, or would be if it were made; `None`
/// where the system does not say.
pub fn free_space(folder: &Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let folder = std::path::absolute(folder).ok()?;
        let there = folder.ancestors().find(|folder| folder.exists())?;
        let system = rustix::fs::statvfs(there).ok()?;
        system.f_bavail.checked_mul(system.f_frsize)
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
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
        s if s < 9.95 => format!("{s:.1} s"),
        s if s < 99.5 => format!("{s:.0} s"),
        s if s < 570.0 => format!("{:.1} min", s / 60.0),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// "1 view", "5 views".
pub(crate) fn counted(count: usize, what: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} {what}{ending}")
}

/// What a piece of work takes of a machine, about.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Expense {
    /// Seconds.
    pub seconds: f64,
    /// Bytes at the most at a time.
    pub bytes: u64,
}

impl fmt::Display for Expense {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (seconds, bytes) = (readable_seconds(self.seconds), readable_bytes(self.bytes));
        write!(f, "about {seconds} and {bytes}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_are_readable() {
        assert_eq!(readable_bytes(2_650_000_000), "2.6 GB");
        assert_eq!(readable_bytes(51_400_000), "51 MB");
        assert_eq!(readable_seconds(3.44), "3.4 s");
        assert_eq!(readable_seconds(9.96), "10 s");
        assert_eq!(readable_seconds(42.4), "42 s");
        assert_eq!(readable_seconds(150.0), "2.5 min");
        assert_eq!(readable_seconds(601.0), "10 min");
        assert_eq!(readable_seconds(9000.0), "2.5 h");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_peak_is_at_least_what_is_held() {
        forget_peak_memory();
        let held = vec![1_u8; 64 << 20];
        assert!(peak_memory().unwrap() >= held.len() as u64);
        let available = available_memory().unwrap();
        assert!(available > 0 && available <= total_memory().unwrap());
    }

    #[test]
    fn lines_of_a_processor_are_told_apart() {
        let text = "processor\t: 0\nmodel name\t: A: B\nmodel\t\t: 2\n\nprocessor\t: 1\n";
        assert_eq!(lines_of(text, "processor").count(), 2);
        assert_eq!(lines_of(text, "model name").next(), Some("A: B"));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn space_is_that_of_the_nearest_folder_that_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let free = free_space(folder.path()).unwrap();
        assert!(free > 0);
        assert!(free_space(&folder.path().join("a/b")).is_some());
        assert!(cores().unwrap() > 0);
    }
}
