use super::{Finding, Part, State};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Where systems and containers have the driver's library, besides the folders of `LD_LIBRARY_PATH`.
const FOLDERS: [&str; 6] = [
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/lib/wsl/lib",
    "/usr/local/nvidia/lib64",
];
const LIBRARY: &str = "libcuda.so.1";

/// GPUs, their driver, and whether this build has any use for them.
pub(super) fn finding() -> Finding {
    let paths = std::env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
    let paths = std::env::split_paths(&paths).filter(|path| path.is_absolute());
    let mut folders = paths.chain(FOLDERS.map(PathBuf::from));
    let library = folders.find(|folder| folder.join(LIBRARY).exists());
    finding_of(Path::new("/proc/driver/nvidia"), library.is_some())
}

fn finding_of(driver: &Path, has_library: bool) -> Finding {
    let finding = |state, text: String| Finding::new(Part::Machine, "gpu", state, text);
    let version = fs::read_to_string(driver.join("version"));
    let version = version.ok().and_then(|text| version_in(&text));
    let names = names_in(&driver.join("gpus"));
    let unused = "this build computes on the processor";
    if version.is_none() && names.is_empty() {
        return finding(State::Ok, format!("none of NVIDIA's found; {unused}"));
    }
    let mut text = match &names[..] {
        [] => "GPUs of NVIDIA".to_string(),
        names => names.join(", "),
    };
    if let Some(version) = version {
        text += &format!(", driver {version}");
    }
    if !has_library {
        text += &format!(", without {LIBRARY}");
    }
    finding(State::Slow, format!("{text}: not used, {unused}"))
}

/// The driver's version, of `NVRM version: NVIDIA UNIX .. Module  550.54.15  ..`.
fn version_in(text: &str) -> Option<String> {
    let line = text.lines().find(|line| line.starts_with("NVRM version"))?;
    let is_version = |word: &&str| {
        word.contains('.')
            && word
                .split('.')
                .all(|part| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit()))
    };
    line.split_whitespace().find(is_version).map(str::to_string)
}

/// What the GPUs call themselves.
fn names_in(gpus: &Path) -> Vec<String> {
    let entries = fs::read_dir(gpus).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    let name = |path: PathBuf| {
        let text = fs::read_to_string(path.join("information")).ok()?;
        let line = text.lines().find_map(|line| line.strip_prefix("Model:"))?;
        Some(line.trim().to_string())
    };
    paths.into_iter().filter_map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_driver_and_its_gpus_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let nothing = finding_of(folder.path(), false);
        assert_eq!(nothing.state, State::Ok);
        assert!(nothing.text.contains("none"), "{nothing:?}");
        let version = "NVRM version: NVIDIA UNIX Open Kernel Module for x86_64  570.86.15  Release Build\n\
                       GCC version:  gcc version 12.3.0\n";
        fs::write(folder.path().join("version"), version).unwrap();
        let gpu = folder.path().join("gpus/0000:07:00.0");
        fs::create_dir_all(&gpu).unwrap();
        fs::write(gpu.join("information"), "Model: \t\t NVIDIA H100\nIRQ: 1\n").unwrap();
        let found = finding_of(folder.path(), false);
        assert_eq!(found.state, State::Slow);
        assert!(
            found
                .text
                .starts_with("NVIDIA H100, driver 570.86.15, without libcuda.so.1: not used"),
            "{found:?}"
        );
    }
}
