//! Predicates, a bit for each thread.

use super::line::{Line, integers};
use crate::number::{Bf16, F16, Half};
use crate::program::Op;
use crate::registers::{LANES, Lane, Registers};
use crate::syntax::Operand;

impl Line<'_, '_> {
    pub(super) fn logic(&mut self, base: &str) -> Option<Op> {
        let f: fn(u32, u32) -> u32 = match base {
            "and" => |a: u32, b: u32| a & b,
            "or" => |a, b| a | b,
            "xor" => |a, b| a ^ b,
            "not" => |a, _| !a,
            _ => return None,
        };
        let (to, _) = self.predicate(0)?;
        let a = self.predicate(1)?;
        let b = if base == "not" { a } else { self.predicate(2)? };
        Some(Op::Compute(Box::new(move |registers, mask| {
            let bits = f(bits(registers, a), bits(registers, b));
            registers.set_predicate(to, bits, mask);
        })))
    }

    pub(super) fn set_predicate(&mut self) -> Option<Op> {
        let compare = self.comparison()?;
        let join = self.one_of(&["and", "or", "xor"]);
        let (to, inverse) = match self.operands.first()? {
            Operand::Name(name) => (self.predicate_named(name)?, None),
            Operand::Pair(to, inverse) => (
                self.predicate_named(to)?,
                Some(self.predicate_named(inverse)?),
            ),
            _ => return None,
        };
        let other = if join.is_some() {
            Some(self.predicate(3)?)
        } else {
            None
        };
        Some(Op::Compute(Box::new(move |registers, mask| {
            let found = compare(registers);
            let joined = |found: u32| match (join, other.map(|other| bits(registers, other))) {
                (Some("and"), Some(other)) => found & other,
                (Some("or"), Some(other)) => found | other,
                (Some(_), Some(other)) => found ^ other,
                _ => found,
            };
            let (yes, no) = (joined(found), joined(!found));
            registers.set_predicate(to, yes, mask);
            if let Some(inverse) = inverse {
                registers.set_predicate(inverse, no, mask);
            }
        })))
    }

    /// A number for what is true, and 0 for what is not.
    pub(super) fn set(&mut self) -> Option<Op> {
        let compare = self.comparison()?;
        let yes: u32 = match self.kind()? {
            "u32" | "s32" => u32::MAX,
            "f32" => 1.0_f32.to_bits(),
            "f16" => F16::near(1.0).bits().into(),
            "bf16" => Bf16::near(1.0).bits().into(),
            _ => return None,
        };
        let to = self.to::<u32>(0)?;
        Some(Op::Compute(Box::new(move |registers, mask| {
            let found = compare(registers);
            let out = std::array::from_fn(|lane| if found >> lane & 1 == 1 { yes } else { 0 });
            registers.set::<u32>(to, &out, mask);
        })))
    }

    /// How the second operand compares with the third.
    fn comparison(&mut self) -> Option<Comparison> {
        let kind = self.kind()?;
        let flush = self.take("ftz");
        let word = self.words.first().copied()?;
        self.words.remove(0);
        // Whether less, equal, greater and what is no number are accepted.
        let (less, equal, greater, unordered) = match word {
            "eq" => (false, true, false, false),
            "ne" => (true, false, true, false),
            "lt" | "lo" => (true, false, false, false),
            "le" | "ls" => (true, true, false, false),
            "gt" | "hi" => (false, false, true, false),
            "ge" | "hs" => (false, true, true, false),
            "equ" => (false, true, false, true),
            "neu" => (true, false, true, true),
            "ltu" => (true, false, false, true),
            "leu" => (true, true, false, true),
            "gtu" => (false, false, true, true),
            "geu" => (false, true, true, true),
            "num" => (true, true, true, false),
            "nan" => (false, false, false, true),
            _ => return None,
        };
        macro_rules! compared {
            ($T:ty, $value:expr) => {{
                let (a, b) = (self.from::<$T>(1)?, self.from::<$T>(2)?);
                Some(Box::new(move |registers: &Registers| {
                    let (a, b) = (registers.words::<$T>(a), registers.words::<$T>(b));
                    let mut found = 0;
                    for lane in 0..LANES {
                        let (a, b) = (($value)(<$T>::read(a[lane])), ($value)(<$T>::read(b[lane])));
                        // Without branches, so that all are compared at once.
                        let any = (a < b) & less | (a == b) & equal | (a > b) & greater;
                        #[allow(clippy::eq_op, reason = "only NaN differs from itself")]
                        let nan = ((a != a) | (b != b)) & unordered;
                        found |= u32::from(any | nan) << lane;
                    }
                    found
                }))
            }};
        }
        match kind {
            "f32" => compared!(f32, |x: f32| if flush && x.abs() < f32::MIN_POSITIVE {
                0.0
            } else {
                x
            }),
            "f64" => compared!(f64, |x: f64| x),
            "f16" => compared!(F16, F16::value),
            "bf16" => compared!(Bf16, Bf16::value),
            _ => integers!(kind, T => compared!(T, |x: T| x)),
        }
    }
}

type Comparison = Box<dyn Fn(&Registers) -> u32 + Send + Sync>;

/// A predicate, negated if that is so.
pub(super) fn bits(registers: &Registers, (slot, negate): (u32, bool)) -> u32 {
    registers.predicate(slot) ^ if negate { u32::MAX } else { 0 }
}
