//! With the feature `cuda`, compiles the kernels for GPUs to PTX. That of compute capability 8.0 is for all later GPUs, too:
//! their driver compiles it further.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Files in `kernels`.
const KERNELS: [&str; 2] = ["attention", "unfold"];

fn main() -> Result<(), String> {
    println!("cargo::rerun-if-changed=build.rs");
    if env::var_os("CARGO_FEATURE_CUDA").is_none() {
        return Ok(());
    }
    for variable in ["NVCC", "CUDA_HOME"] {
        println!("cargo::rerun-if-env-changed={variable}");
    }
    let of_toolkit = || Some(Path::new(&env::var_os("CUDA_HOME")?).join("bin/nvcc"));
    let nvcc = env::var_os("NVCC").map(PathBuf::from).or_else(of_toolkit);
    let nvcc = nvcc.unwrap_or_else(|| "nvcc".into());
    let folder = env::var_os("OUT_DIR").ok_or("cargo says no OUT_DIR")?;
    KERNELS
        .iter()
        .try_for_each(|name| compile(&nvcc, Path::new(&folder), name))
}

fn compile(nvcc: &Path, folder: &Path, name: &str) -> Result<(), String> {
    let source = Path::new("kernels").join(name).with_extension("cu");
    println!("cargo::rerun-if-changed={}", source.display());
    let status = Command::new(nvcc)
        .args(["--ptx", "-arch=compute_80", "-std=c++17", "-O3", "-o"])
        .arg(folder.join(name).with_extension("ptx"))
        .arg(&source)
        .status();
    match status {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{} {}: {status}", nvcc.display(), source.display())),
        Err(error) => Err(format!(
            "{} does not run ({error}): CUDA's compiler is needed, NVCC or CUDA_HOME say where it is (scripts/cuda fetches it)",
            nvcc.display()
        )),
    }
}
