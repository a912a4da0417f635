use super::{Finding, Part, State};
use std::{
    fs,
    path::{Path, PathBuf},
};
use tid3r_models::device::missing_for_cuda;

/// GPUs, their driver, and whether this build has any use for them.
pub(super) fn finding() -> Finding {
    finding_of(
        Path::new("/proc/driver/nvidia"),
        cfg!(feature = "cuda"),
        missing_for_cuda(),
    )
}

/// What the `driver` says, and what the build with CUDA, if it is one, misses.
fn finding_of(driver: &Path, has_cuda: bool, missing: Option<String>) -> Finding {
    let finding = |state, text: String| Finding::new(Part::Machine, "gpu", state, text);
    let version = fs::read_to_string(driver.join("version"));
    let version = version.ok().and_then(|text| version_in(&text));
    let names = names_in(&driver.join("gpus"));
    if version.is_none() && names.is_empty() && (missing.is_some() || !has_cuda) {
        let missing = missing.unwrap_or_default();
        return finding(State::Ok, format!("none of NVIDIA's found; {missing}"));
    }
    let mut text = match &names[..] {
        [] => "GPUs of NVIDIA".to_string(),
        names => names.join(", "),
    };
    if let Some(version) = version {
        text += &format!(", driver {version}");
    }
    match missing {
        None => finding(State::Ok, format!("{text}: used with --device cuda")),
        Some(missing) if has_cuda => finding(State::Missing, format!("{text}: not used, {missing}"))
            .fix("install NVIDIA's driver, and cuBLAS and cuRAND of CUDA 13; LD_LIBRARY_PATH names folders of libraries"),
        Some(missing) => finding(State::Slow, format!("{text}: not used, {missing}"))
            .fix("use the build for CUDA (`scripts/cuda` in the sources)"),
    }
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
        let lacks = || Some("not found: libcuda".to_string());
        let nothing = finding_of(folder.path(), true, lacks());
        assert_eq!(nothing.state, State::Ok);
        assert!(nothing.text.contains("none"), "{nothing:?}");
        let version = "NVRM version: NVIDIA UNIX Open Kernel Module for x86_64  570.86.15  Release Build\n\
                       GCC version:  gcc version 12.3.0\n";
        fs::write(folder.path().join("version"), version).unwrap();
        let gpu = folder.path().join("gpus/0000:07:00.0");
        fs::create_dir_all(&gpu).unwrap();
        fs::write(gpu.join("information"), "Model: \t\t NVIDIA H100\nIRQ: 1\n").unwrap();
        let found = finding_of(folder.path(), true, None);
        assert_eq!(found.state, State::Ok);
        let text = "NVIDIA H100, driver 570.86.15: used with --device cuda";
        assert_eq!(found.text, text);
        let found = finding_of(folder.path(), true, lacks());
        assert_eq!(found.state, State::Missing);
        assert!(found.text.ends_with("not used, not found: libcuda"));
        let found = finding_of(folder.path(), false, lacks());
        assert_eq!(found.state, State::Slow);
        assert!(found.fix.is_some());
    }
}
