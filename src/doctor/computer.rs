use super::{Finding, Part, State};
use crate::machine::{
    available_memory, cores, free_space, memory_limit, processor, readable_bytes, total_memory,
};
use std::path::Path;
use tid3r_models::nn::cpu::Isa;
use tid3r_weights_convert::Places;

/// Memory with which little can be done: less than a network takes with some photos.
const LITTLE_MEMORY: u64 = 2_000_000_000;
/// Room on a disk that a scene with some pictures can take.
const LITTLE_SPACE: u64 = 2_000_000_000;

/// Processor, threads, memory and disks.
pub(super) fn findings(places: &Places) -> Vec<Finding> {
    let mut findings = vec![cpu(), threads(cores(), rayon::current_num_threads())];
    if let Some(available) = available_memory() {
        findings.push(memory(total_memory(), memory_limit(), available));
    }
    let here = std::env::current_dir().ok();
    findings.extend(here.and_then(|folder| disk("disk, here", &folder)));
    let models = places.models().or(places.cache());
    findings.extend(models.and_then(|folder| disk("disk, weights", folder)));
    findings
}

fn finding(name: &'static str, state: State, text: impl Into<String>) -> Finding {
    Finding::new(Part::Machine, name, state, text)
}

/// The processor and the kernels that it will run.
fn cpu() -> Finding {
    let name = processor().unwrap_or_else(|| format!("a processor of {}", std::env::consts::ARCH));
    let available = Isa::available();
    match Isa::current() {
        Ok(current) => {
            let lacking = Isa::features().into_iter().filter(|(_, there)| !there);
            let lacking: Vec<_> = lacking.map(|(feature, _)| feature).collect();
            let found = kernels(&name, current.name(), available[0].name(), &lacking);
            if cfg!(debug_assertions) {
                let text = format!("{}; this tid3r was built without optimisation", found.text);
                return finding("cpu", State::Slow, text)
                    .fix("build it with `cargo build --release`");
            }
            found
        }
        Err(error) => {
            let problem = error.to_string();
            let problem = problem.lines().next().unwrap_or_default();
            finding("cpu", State::Broken, format!("{name}: {problem}"))
                .fix(format!("unset {}", Isa::VARIABLE))
        }
    }
}

fn kernels(name: &str, current: &str, best: &str, lacking: &[&str]) -> Finding {
    let with = format!("{name}, {current} kernels");
    if current != best {
        let text = format!("{with}, by {}; {best} would be faster", Isa::VARIABLE);
        return finding("cpu", State::Slow, text).fix(format!("unset {}", Isa::VARIABLE));
    }
    let lacking = lacking.join(", ");
    match best {
        "avx512bf16" => finding("cpu", State::Ok, format!("{with}, the fastest there are")),
        "avx512" => finding(
            "cpu",
            State::Ok,
            format!("{with}; --dtype bf16 saves memory, but no time ({lacking} is missing)"),
        ),
        "avx2" => finding(
            "cpu",
            State::Slow,
            format!("{with}: networks take 2 to 3 times as long as with AVX-512"),
        ),
        _ => finding(
            "cpu",
            State::Slow,
            format!(
                "{with}: networks take many times as long as with AVX2 ({lacking} are missing)"
            ),
        ),
    }
}

fn threads(cores: Option<usize>, threads: usize) -> Finding {
    match cores {
        Some(cores) if threads < cores => finding(
            "threads",
            State::Slow,
            format!("{threads}, and the machine has {cores} cores"),
        )
        .fix("give --threads, unset RAYON_NUM_THREADS, or allow the container or batch job more cores"),
        Some(cores) => finding("threads", State::Ok, format!("{threads}, on {cores} cores")),
        None => finding("threads", State::Ok, threads.to_string()),
    }
}

fn memory(total: Option<u64>, limit: Option<u64>, available: u64) -> Finding {
    let mut text = format!("{} available", readable_bytes(available));
    if let Some(total) = total {
        text += &format!(" of {}", readable_bytes(total));
    }
    // Limits above what there is are no limits.
    let limit = limit.filter(|&limit| total.is_none_or(|total| limit < total));
    if let Some(limit) = limit {
        text += &format!(
            ", limited to {} (container or batch job)",
            readable_bytes(limit)
        );
    }
    if available >= LITTLE_MEMORY {
        return finding("memory", State::Ok, text);
    }
    finding(
        "memory",
        State::Slow,
        format!("{text}: runs will be made to fit, or refused"),
    )
    .fix(match limit {
        Some(_) => "allow the container or batch job more memory",
        None => "close other programs; weights of --dtype f16 or bf16 take half of f32",
    })
}

fn disk(name: &'static str, folder: &Path) -> Option<Finding> {
    let free = free_space(folder)?;
    let text = format!("{} free at {}", readable_bytes(free), folder.display());
    Some(match free < LITTLE_SPACE {
        false => finding(name, State::Ok, text),
        true => finding(name, State::Missing, format!("only {text}")).fix("make room"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fewer_threads_than_cores_are_slow() {
        assert_eq!(threads(Some(8), 8).state, State::Ok);
        assert_eq!(threads(None, 1).state, State::Ok);
        let few = threads(Some(64), 2);
        assert_eq!(few.state, State::Slow);
        assert_eq!(few.text, "2, and the machine has 64 cores");
        assert!(few.fix.unwrap().contains("container"));
    }

    #[test]
    fn limits_below_what_there_is_are_told() {
        const GB: u64 = 1_000_000_000;
        let plenty = memory(Some(16 * GB), Some(64 * GB), 12 * GB);
        assert_eq!(plenty.text, "12.0 GB available of 16.0 GB");
        assert_eq!(plenty.state, State::Ok);
        let limited = memory(Some(16 * GB), Some(2 * GB), GB);
        assert_eq!(limited.state, State::Slow);
        assert!(limited.text.contains("limited to 2.0 GB"), "{limited:?}");
        assert!(limited.fix.unwrap().contains("container"));
        assert!(memory(None, None, GB).fix.unwrap().contains("close"));
    }

    #[test]
    fn kernels_that_are_not_the_best_are_slow() {
        assert_eq!(
            kernels("x", "avx512bf16", "avx512bf16", &[]).state,
            State::Ok
        );
        let chosen = kernels("x", "avx2", "avx512", &["avx512bf16"]);
        assert_eq!(chosen.state, State::Slow);
        assert_eq!(chosen.fix.unwrap(), "unset TID3R_CPU");
        assert_eq!(
            kernels("x", "avx2", "avx2", &["avx512f"]).state,
            State::Slow
        );
        assert_eq!(
            kernels("x", "portable", "portable", &["avx2"]).state,
            State::Slow
        );
    }
}
