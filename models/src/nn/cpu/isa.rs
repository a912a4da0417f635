//! Which instructions the kernels use.

use std::fmt;
use std::sync::OnceLock;

use candle_core::{Device, Error, Result};

#[cfg(target_arch = "x86_64")]
use super::simd::{Avx2, Avx512};
use super::simd::{Portable, Simd};
use crate::ComputeType;

/// An instruction set that this CPU has.
///
/// The field is private and values come from [`Self::available`] only, so that whoever holds one
/// knows that its instructions exist here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(Kind);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    #[cfg(target_arch = "x86_64")]
    Avx512 {
        bf16: bool,
    },
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Portable,
}

/// Work that is written once for all instruction sets.
///
/// Implementations of `run`, and what it calls with `simd`, must be `#[inline(always)]`: only what
/// is inlined into the dispatching function is compiled with the instructions it enables.
pub(super) trait Task {
    type Output;

    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

impl Isa {
    /// Names the instruction set to use in place of the best one, or is `candle` for none.
    pub const VARIABLE: &str = "TID3R_CPU";

    /// The features that instruction sets need, and whether this CPU has them. A virtual machine may hide any of them.
    pub fn features() -> Vec<(&'static str, bool)> {
        #[cfg(target_arch = "x86_64")]
        {
            macro_rules! detected {
                ($($name:tt),+) => { vec![$(($name, is_x86_feature_detected!($name))),+] };
            }
            detected!(
                "avx2",
                "fma",
                "f16c",
                "avx512f",
                "avx512dq",
                "avx512bw",
                "avx512bf16"
            )
        }
        #[cfg(not(target_arch = "x86_64"))]
        Vec::new()
    }

    /// Those that this CPU has, best first. The last, portable Rust, is everywhere.
    pub fn available() -> Vec<Self> {
        let mut found = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            let features = Self::features();
            let has =
                |names: &[&'static str]| names.iter().all(|&name| features.contains(&(name, true)));
            if has(&["avx512f", "avx512dq", "avx2", "fma"]) {
                if has(&["avx512bf16", "avx512bw"]) {
                    found.push(Self(Kind::Avx512 { bf16: true }));
                }
                found.push(Self(Kind::Avx512 { bf16: false }));
            }
            if has(&["avx2", "fma", "f16c"]) {
                found.push(Self(Kind::Avx2));
            }
        }
        found.push(Self(Kind::Portable));
        found
    }

    /// The one to use: the best one, or what [`Self::VARIABLE`] names. Looked up once.
    ///
    /// # Errors
    ///
    /// If the variable names none, or one that this CPU lacks.
    pub fn current() -> Result<Self> {
        static CURRENT: OnceLock<std::result::Result<Isa, String>> = OnceLock::new();
        CURRENT
            .get_or_init(|| Self::named(std::env::var(Self::VARIABLE).ok().as_deref()))
            .clone()
            .map_err(Error::Msg)
    }

    fn named(name: Option<&str>) -> std::result::Result<Self, String> {
        let available = Self::available();
        let found = match name {
            None | Some("" | CANDLE) => available.first(),
            Some(name) => available.iter().find(|isa| isa.name() == name),
        };
        found.copied().ok_or_else(|| {
            let names: Vec<&str> = available.iter().map(|isa| isa.name()).collect();
            format!(
                "{} is {}; on this CPU it can be {}, or {CANDLE}",
                Self::VARIABLE,
                name.unwrap_or_default(),
                names.join(", ")
            )
        })
    }

    /// As in [`Self::VARIABLE`].
    pub fn name(self) -> &'static str {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 { bf16: true } => "avx512bf16",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 { bf16: false } => "avx512",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            Kind::Portable => "portable",
        }
    }

    /// Rows and columns of the tile of a product that is summed in registers.
    pub(super) fn tile(self) -> (usize, usize) {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 { .. } => (Avx512::<false>::MR, Avx512::<false>::NR),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => (Avx2::MR, Avx2::NR),
            Kind::Portable => (Portable::MR, Portable::NR),
        }
    }

    /// Does `task` with these instructions.
    pub(super) fn run<T: Task>(self, task: T) -> T::Output {
        match self.0 {
            // SAFETY: a value of `Isa` is proof that the CPU has the instructions.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 { .. } => unsafe { with_avx512(task) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => unsafe { with_avx2(task) },
            Kind::Portable => task.run(Portable),
        }
    }
}

/// What [`Isa::VARIABLE`] is if layers shall compute with candle's operations. They are slow on a CPU, but they are what
/// GPUs do.
const CANDLE: &str = "candle";

/// Whether this project's kernels compute with what is on `device`, and not candle's operations.
pub(crate) fn kernels_fit(device: &Device) -> bool {
    static WANTED: OnceLock<bool> = OnceLock::new();
    let wanted = || std::env::var(Isa::VARIABLE).as_deref() != Ok(CANDLE);
    device.is_cpu() && *WANTED.get_or_init(wanted)
}

impl Isa {
    /// Whether pairs of bf16 are multiplied faster than numbers of f32.
    fn multiplies_pairs(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        return self.0 == Kind::Avx512 { bf16: true };
        #[cfg(not(target_arch = "x86_64"))]
        return false;
    }

    /// As [`Self::run`], for a task that multiplies or rounds pairs of bf16.
    pub(super) fn run_pairs<T: Task>(self, task: T) -> T::Output {
        match self.0 {
            // SAFETY: a value of `Isa` is proof that the CPU has the instructions.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 { bf16: true } => unsafe { with_avx512_bf16(task) },
            _ => self.run(task),
        }
    }
}

impl ComputeType {
    /// Whether this processor multiplies pairs of bf16 to compute with this type, which takes about half the time.
    ///
    /// # Errors
    ///
    /// If the environment asks for an instruction set that this CPU lacks.
    pub fn is_in_pairs_here(self) -> Result<bool> {
        Ok(self.in_pairs(Isa::current()?))
    }

    /// Whether kernels of this instruction set multiply pairs of bf16 to compute with this type.
    pub(in crate::nn) fn in_pairs(self, isa: Isa) -> bool {
        self == Self::Bf16 && isa.multiplies_pairs()
    }
}

impl fmt::Display for Isa {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
fn with_avx512<T: Task>(task: T) -> T::Output {
    // SAFETY: the features are enabled in this function, so its caller has made sure of them.
    task.run(unsafe { Avx512::<false>::assume() })
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512bf16,avx2,fma")]
fn with_avx512_bf16<T: Task>(task: T) -> T::Output {
    // SAFETY: as above.
    task.run(unsafe { Avx512::<true>::assume() })
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,f16c")]
fn with_avx2<T: Task>(task: T) -> T::Output {
    // SAFETY: as above.
    task.run(unsafe { Avx2::assume() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_looked_up() {
        for isa in Isa::available() {
            assert_eq!(Isa::named(Some(isa.name())), Ok(isa));
        }
        assert_eq!(Isa::named(None), Ok(Isa::available()[0]));
        assert_eq!(Isa::named(Some(CANDLE)), Ok(Isa::available()[0]));
        let message = Isa::named(Some("sse9")).unwrap_err();
        assert!(message.contains("sse9") && message.contains("portable"));
    }
}
