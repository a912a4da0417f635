//! Memory.

use super::Name;
use super::line::{Line, of_type};
use crate::number::{Bf16, F16, Half};
use crate::program::{Access, Change, Op, Place};
use crate::registers::{Lane, Two};
use crate::syntax::{Operand, Space, bytes_of};

/// Words about caches and the order in which others see memory: here, all of it is seen at once.
const CACHING: [&str; 22] = [
    "ca",
    "cg",
    "cs",
    "lu",
    "cv",
    "wb",
    "wt",
    "nc",
    "volatile",
    "relaxed",
    "acquire",
    "release",
    "acq_rel",
    "weak",
    "cta",
    "gpu",
    "sys",
    "L2::64B",
    "L2::128B",
    "L2::256B",
    "L1::no_allocate",
    "L1::evict_last",
];

impl Line<'_, '_> {
    fn space(&mut self) -> Space {
        match self.one_of(&["global", "shared", "shared::cta", "local", "param", "const"]) {
            Some("global" | "const") => Space::Global,
            Some("local") => Space::Local,
            Some("param") => Space::Param,
            Some(_) => Space::Shared,
            None => Space::Generic,
        }
    }

    fn access(&mut self, space: Space, operand: usize, bytes: usize) -> Option<Access> {
        let Operand::Address(base, offset) = self.operands.get(operand)? else {
            return None;
        };
        let mut access = Access {
            space,
            address: Place {
                slot: 0,
                wide: true,
            },
            offset: *offset,
            bytes,
            signed: false,
            registers: Vec::new(),
        };
        access.address = match &**base {
            Operand::Name(name) => match self.compiler.find(name)? {
                Name::Register(place) => place,
                name => {
                    // Parameters of functions are variables of callers.
                    if let (Name::Local(_), Space::Param) = (name, space) {
                        access.space = Space::Local;
                    }
                    Place {
                        slot: self.operand_register(base, true)?,
                        wide: true,
                    }
                }
            },
            base => Place {
                slot: self.operand_register(base, true)?,
                wide: true,
            },
        };
        Some(access)
    }

    /// An access of the registers in an operand, by the words that are left.
    fn access_registers(
        &mut self,
        address: usize,
        registers: usize,
        is_load: bool,
    ) -> Option<Access> {
        let space = self.space();
        let kind = self.kind()?;
        let count = match self.one_of(&["v2", "v4"]) {
            Some("v2") => 2,
            Some(_) => 4,
            None => 1,
        };
        self.words.retain(|word| !CACHING.contains(word));
        let bytes = bytes_of(&format!(".{kind}"))?;
        let mut access = self.access(space, address, bytes)?;
        access.signed = kind.starts_with('s');
        let operand = self.operands.get(registers)?;
        let parts = match operand {
            Operand::Vector(parts) => &parts[..],
            _ => std::slice::from_ref(operand),
        };
        if parts.len() != count {
            return None;
        }
        access.registers = parts
            .iter()
            .map(|part| self.accessed(part, bytes, is_load))
            .collect::<Option<_>>()?;
        Some(access)
    }

    /// Registers may be larger than what is in memory.
    fn accessed(&mut self, operand: &Operand, bytes: usize, is_load: bool) -> Option<Place> {
        match operand {
            Operand::Name("_") if is_load => Some(self.compiler.register(bytes == 8)),
            Operand::Name(name) if matches!(self.compiler.find(name), Some(Name::Register(_))) => {
                self.register(operand)
                    .filter(|place| place.wide || bytes < 8)
            }
            _ if is_load => None,
            _ => Some(Place {
                slot: self.operand_register(operand, bytes == 8)?,
                wide: bytes == 8,
            }),
        }
    }

    pub(super) fn load(&mut self) -> Option<Op> {
        self.access_registers(1, 0, true).map(Op::Load)
    }

    pub(super) fn store(&mut self) -> Option<Op> {
        self.access_registers(0, 1, false).map(Op::Store)
    }

    pub(super) fn atomic(&mut self, has_result: bool) -> Option<Op> {
        let space = self.space();
        let kind = self.kind()?;
        self.take("noftz");
        self.words.retain(|word| !CACHING.contains(word));
        let change = self.words.pop()?;
        let bytes = bytes_of(&format!(".{kind}"))?;
        let first = usize::from(has_result);
        let mut at = self.access(space, first, bytes)?;
        if has_result {
            let operand = self.operands.first()?;
            at.registers.push(self.accessed(operand, bytes, true)?);
        }
        let operand = |line: &mut Self, index: usize| {
            let operand = line.operands.get(first + index)?;
            line.accessed(operand, bytes, false)
        };
        let operands = [Some(operand(self, 1)?), operand(self, 2)];
        if (change == "cas") != operands[1].is_some() {
            return None;
        }
        Some(Op::Atomic {
            at,
            operands,
            change: changed(change, kind)?,
        })
    }

    pub(super) fn copy_later(&mut self) -> Option<Op> {
        self.require("async")?;
        if self.take("commit_group") {
            return Some(Op::CommitCopies);
        }
        if self.take("wait_all") {
            return Some(Op::WaitForCopies(None));
        }
        if self.take("wait_group") {
            return Some(Op::WaitForCopies(Some(self.number(0)? as usize)));
        }
        let small = self.one_of(&["ca", "cg"])? == "ca";
        let _ = self.take("shared") || self.take("shared::cta");
        self.require("global")?;
        self.words.retain(|word| !CACHING.contains(word));
        let bytes = self.number(2)? as usize;
        if bytes != 16 && !(small && matches!(bytes, 4 | 8)) {
            return None;
        }
        let given = if self.operands.len() > 3 {
            Some(self.from::<u32>(3)?)
        } else {
            None
        };
        let (to, from) = (
            self.access(Space::Shared, 0, bytes)?,
            self.access(Space::Global, 1, bytes)?,
        );
        Some(Op::CopyLater { to, from, given })
    }

    pub(super) fn load_matrices(&mut self) -> Option<Op> {
        for word in ["sync", "aligned", "m8n8", "b16"] {
            self.require(word)?;
        }
        let count = match self.one_of(&["x1", "x2", "x4"])? {
            "x1" => 1,
            "x2" => 2,
            _ => 4,
        };
        let transposed = self.take("trans");
        let space = self.space();
        let mut at = self.access(space, 1, 16)?;
        let operand = self.operands.first()?;
        let parts = match operand {
            Operand::Vector(parts) => &parts[..],
            _ => std::slice::from_ref(operand),
        };
        at.registers = parts
            .iter()
            .map(|part| self.register(part).filter(|place| !place.wide))
            .collect::<Option<_>>()?;
        (at.registers.len() == count).then_some(Op::LoadMatrices { at, transposed })
    }
}

/// What an atomic instruction makes of what is in memory.
fn changed(change: &str, kind: &str) -> Option<Change> {
    fn of<T: Lane>(f: impl Fn(T, T, T) -> T + Send + Sync + 'static) -> Option<Change> {
        Some(Box::new(move |old, b, c| {
            f(T::narrow(old), T::narrow(b), T::narrow(c)).wide()
        }))
    }
    fn half<H: Half>(a: H, b: H) -> H {
        H::near(a.value() + b.value())
    }
    match (change, kind) {
        ("add", "f32") => of(|a: f32, b, _| a + b),
        ("add", "f64") => of(|a: f64, b, _| a + b),
        ("add", "f16") => of(|a: F16, b, _| half(a, b)),
        ("add", "bf16") => of(|a: Bf16, b, _| half(a, b)),
        ("add", "f16x2") => of(|a: Two<F16>, b: Two<F16>, _| Two(half(a.0, b.0), half(a.1, b.1))),
        ("add", "bf16x2") => {
            of(|a: Two<Bf16>, b: Two<Bf16>, _| Two(half(a.0, b.0), half(a.1, b.1)))
        }
        _ => of_type!(
            kind,
            ["b16" => u16, "u32" | "b32" => u32, "s32" => i32, "u64" | "b64" => u64, "s64" => i64],
            T => match change {
                "add" => of(|a: T, b: T, _| a.wrapping_add(b)),
                "min" => of(|a: T, b: T, _| a.min(b)),
                "max" => of(|a: T, b: T, _| a.max(b)),
                "and" => of(|a: T, b: T, _| a & b),
                "or" => of(|a: T, b: T, _| a | b),
                "xor" => of(|a: T, b: T, _| a ^ b),
                "exch" => of(|_: T, b: T, _| b),
                "cas" => of(|a: T, b: T, c: T| if a == b { c } else { a }),
                "inc" => of(|a: T, b: T, _| if a >= b { 0 } else { a + 1 }),
                "dec" => of(|a: T, b: T, _| if a == 0 || a > b { b } else { a - 1 }),
                _ => None,
            }
        ),
    }
}
