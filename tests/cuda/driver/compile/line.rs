//! One instruction: its words and its operands.

use super::{Compiler, Name, Value};
use crate::program::{Op, Place, is_wide};
use crate::registers::{ALL, LANES, Lane};
use crate::syntax::{Number, Operand};

/// One instruction. What is known of its words after the first is taken from them: what is left makes it unknown.
pub(super) struct Line<'c, 'a> {
    pub(super) compiler: &'c mut Compiler<'a>,
    pub(super) operands: &'a [Operand],
    pub(super) words: Vec<&'static str>,
}

impl Line<'_, '_> {
    pub(super) fn op(&mut self, base: &str) -> Option<Op> {
        match base {
            "mov" => self.mov(),
            "cvt" => self.convert(),
            "cvta" => self.convert_address(),
            "isspacep" => self.is_in_space(),
            "setp" => self.set_predicate(),
            "set" => self.set(),
            "selp" => self.select(),
            "ld" | "ldu" => self.load(),
            "st" => self.store(),
            "atom" | "red" => self.atomic(base == "atom"),
            "cp" => self.copy_later(),
            "ldmatrix" => self.load_matrices(),
            "mma" => self.multiply_matrices(),
            "shfl" => self.shuffle(),
            "vote" | "activemask" => self.vote(base),
            "redux" => self.reduce(),
            "bar" | "barrier" => self.barrier(),
            "membar" | "fence" => {
                self.words.clear();
                Some(Op::Nothing)
            }
            "bra" => {
                self.take("uni");
                self.jump_target(0).map(Op::Jump)
            }
            "brx" => self.jump_to(),
            "ret" | "exit" => {
                self.take("uni");
                let is_called = base == "ret" && self.compiler.ends.len() > 1;
                Some(if is_called {
                    Op::Jump(*self.compiler.ends.last()?)
                } else {
                    Op::Exit
                })
            }
            "trap" => Some(Op::Trap),
            _ => self.integer(base).or_else(|| self.float(base)),
        }
    }

    pub(super) fn jump_target(&mut self, operand: usize) -> Option<u32> {
        match self.operands.get(operand)? {
            Operand::Name(name) => self.compiler.find_label(name),
            _ => None,
        }
    }

    pub(super) fn jump_to(&mut self) -> Option<Op> {
        self.require("idx")?;
        self.take("uni");
        let Operand::Name(table) = self.operands.get(1)? else {
            return None;
        };
        let labels = self
            .compiler
            .scopes
            .iter()
            .rev()
            .find_map(|scope| scope.targets.get(table))?
            .clone();
        let places = labels
            .iter()
            .map(|label| self.compiler.find_label(label))
            .collect::<Option<_>>()?;
        Some(Op::JumpTo {
            number: self.from::<u32>(0)?,
            places,
        })
    }

    /// Whether `word` is there.
    pub(super) fn take(&mut self, word: &str) -> bool {
        let at = self.words.iter().position(|&other| other == word);
        at.map(|at| self.words.remove(at)).is_some()
    }

    pub(super) fn require(&mut self, word: &str) -> Option<()> {
        self.take(word).then_some(())
    }

    /// The first word, if it is one of these.
    pub(super) fn one_of(&mut self, words: &[&'static str]) -> Option<&'static str> {
        let at = self.words.iter().position(|word| words.contains(word))?;
        Some(self.words.remove(at))
    }

    /// The last word, which is a type.
    pub(super) fn kind(&mut self) -> Option<&'static str> {
        self.words.pop()
    }

    pub(super) fn register(&mut self, operand: &Operand) -> Option<Place> {
        match operand {
            Operand::Name("_") => None,
            Operand::Name(name) => match self.compiler.find(name)? {
                Name::Register(place) => Some(place),
                _ => None,
            },
            _ => None,
        }
    }

    /// The register that a result of type `T` goes to.
    pub(super) fn to<T: Lane>(&mut self, operand: usize) -> Option<u32> {
        let operand = self.operands.get(operand)?;
        self.result_register::<T>(operand)
    }

    pub(super) fn result_register<T: Lane>(&mut self, operand: &Operand) -> Option<u32> {
        if matches!(operand, Operand::Name("_")) {
            return Some(self.compiler.register(is_wide::<T>()).slot);
        }
        self.register(operand)
            .filter(|place| place.wide == is_wide::<T>())
            .map(|place| place.slot)
    }

    /// The register that an operand of type `T` is in.
    pub(super) fn from<T: Lane>(&mut self, operand: usize) -> Option<u32> {
        let operand = self.operands.get(operand)?;
        self.operand_register(operand, is_wide::<T>())
    }

    pub(super) fn operand_register(&mut self, operand: &Operand, wide: bool) -> Option<u32> {
        let value = match operand {
            Operand::Number(Number::Whole(value)) => *value as u64,
            Operand::Number(Number::F32(bits)) if !wide => (*bits).into(),
            Operand::Number(Number::F64(bits)) if wide => *bits,
            Operand::Number(_) => return None,
            Operand::Name(name) => match self.compiler.find(name)? {
                Name::Register(place) if place.wide == wide => return Some(place.slot),
                Name::Parameter(offset) | Name::Local(offset) | Name::Shared(offset) => {
                    offset as u64
                }
                Name::DynamicShared => {
                    return Some(self.compiler.constant(Value::DynamicShared, wide).slot);
                }
                Name::Global(address) if wide => address,
                _ => return None,
            },
            _ => return None,
        };
        let value = if wide { value } else { u64::from(value as u32) };
        Some(self.compiler.constant(Value::Number(value), wide).slot)
    }

    /// A whole number that is written out.
    pub(super) fn number(&self, operand: usize) -> Option<i128> {
        match self.operands.get(operand)? {
            Operand::Number(Number::Whole(value)) => Some(*value),
            _ => None,
        }
    }

    /// A predicate's register, and whether it is negated.
    pub(super) fn predicate(&mut self, operand: usize) -> Option<(u32, bool)> {
        let (name, negate) = match self.operands.get(operand)? {
            Operand::Name(name) => (name, false),
            Operand::Not(name) => (name, true),
            Operand::Number(Number::Whole(value)) => {
                let bits = Value::Number(if *value == 0 { 0 } else { ALL.into() });
                return Some((self.compiler.constant(bits, false).slot, false));
            }
            _ => return None,
        };
        self.predicate_named(name).map(|slot| (slot, negate))
    }

    pub(super) fn predicate_named(&mut self, name: &str) -> Option<u32> {
        if name == "_" {
            return Some(self.compiler.register(false).slot);
        }
        match self.compiler.find(name)? {
            Name::Predicate(slot) => Some(slot),
            _ => None,
        }
    }

    pub(super) fn unary<A: Lane, R: Lane>(
        &mut self,
        f: impl Fn(A) -> R + Send + Sync + 'static,
    ) -> Option<Op> {
        Some(one(self.to::<R>(0)?, self.from::<A>(1)?, f))
    }

    pub(super) fn binary<A: Lane, R: Lane>(
        &mut self,
        f: impl Fn(A, A) -> R + Send + Sync + 'static,
    ) -> Option<Op> {
        let (to, a, b) = (self.to::<R>(0)?, self.from::<A>(1)?, self.from::<A>(2)?);
        Some(Op::Compute(Box::new(move |registers, mask| {
            let (a, b) = (registers.words::<A>(a), registers.words::<A>(b));
            let mut out = [R::default(); LANES];
            for lane in 0..LANES {
                out[lane] = f(A::read(a[lane]), A::read(b[lane]));
            }
            registers.set(to, &out, mask);
        })))
    }

    /// Of operands of any types.
    pub(super) fn ternary<A: Lane, B: Lane, C: Lane, R: Lane>(
        &mut self,
        f: impl Fn(A, B, C) -> R + Send + Sync + 'static,
    ) -> Option<Op> {
        let (to, a, b, c) = (
            self.to::<R>(0)?,
            self.from::<A>(1)?,
            self.from::<B>(2)?,
            self.from::<C>(3)?,
        );
        Some(Op::Compute(Box::new(move |registers, mask| {
            let (a, b, c) = (
                registers.words::<A>(a),
                registers.words::<B>(b),
                registers.words::<C>(c),
            );
            let mut out = [R::default(); LANES];
            for lane in 0..LANES {
                out[lane] = f(A::read(a[lane]), B::read(b[lane]), C::read(c[lane]));
            }
            registers.set(to, &out, mask);
        })))
    }
}

pub(super) fn one<A: Lane, R: Lane>(
    to: u32,
    a: u32,
    f: impl Fn(A) -> R + Send + Sync + 'static,
) -> Op {
    Op::Compute(Box::new(move |registers, mask| {
        let a = registers.words::<A>(a);
        let mut out = [R::default(); LANES];
        for lane in 0..LANES {
            out[lane] = f(A::read(a[lane]));
        }
        registers.set(to, &out, mask);
    }))
}

/// `$body` with `$T` as the type that `$kind` names.
macro_rules! of_type {
    ($kind:expr, [$($name:pat => $type:ty),*], $T:ident => $body:expr) => {
        match $kind {
            $($name => {
                type $T = $type;
                $body
            })*
            _ => None,
        }
    };
}

macro_rules! integers {
    ($kind:expr, $T:ident => $body:expr) => {
        crate::compile::line::of_type!(
            $kind,
            ["u16" | "b16" => u16, "s16" => i16, "u32" | "b32" => u32, "s32" => i32, "u64" | "b64" => u64, "s64" => i64],
            $T => $body
        )
    };
}

pub(super) use {integers, of_type};
