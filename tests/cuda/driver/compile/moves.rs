//! What goes from register to register as it is.

use super::line::{Line, of_type};
use super::predicate::bits;
use crate::program::Op;
use crate::registers::{LANES, Lane, Registers};
use crate::syntax::Operand;

impl Line<'_, '_> {
    pub(super) fn mov(&mut self) -> Option<Op> {
        let kind = self.kind()?;
        if kind == "pred" {
            let ((to, _), from) = (self.predicate(0)?, self.predicate(1)?);
            return Some(Op::Compute(Box::new(move |registers, mask| {
                let bits = bits(registers, from);
                registers.set_predicate(to, bits, mask);
            })));
        }
        match self.operands {
            [Operand::Vector(to), from] => self.unpack(kind, to, from),
            [to, Operand::Vector(from)] => self.pack(kind, to, from),
            _ => of_type!(
                kind,
                ["b16" | "u16" | "s16" | "f16" | "bf16" => u16, "b32" | "u32" | "s32" | "f32" | "f16x2" | "bf16x2" => u32,
                 "b64" | "u64" | "s64" | "f64" => u64],
                T => self.unary(|a: T| a)
            ),
        }
    }

    fn unpack(&mut self, kind: &str, to: &[Operand], from: &Operand) -> Option<Op> {
        let bytes = if kind == "b64" { 8 } else { 4 };
        let from = self.operand_register(from, bytes == 8)?;
        let bits = 8 * bytes / to.len() as u32;
        let to: Vec<u32> = to
            .iter()
            .map(|part| self.result_register::<u32>(part))
            .collect::<Option<_>>()?;
        Some(Op::Compute(Box::new(move |registers, mask| {
            let whole = wide(registers, from, bytes == 8);
            for (part, &to) in to.iter().enumerate() {
                let ones = u32::MAX >> (32 - bits);
                registers.set(
                    to,
                    &whole.map(|whole| (whole >> (bits * part as u32)) as u32 & ones),
                    mask,
                );
            }
        })))
    }

    fn pack(&mut self, kind: &str, to: &Operand, from: &[Operand]) -> Option<Op> {
        let bytes = if kind == "b64" { 8 } else { 4 };
        let bits = 8 * bytes / from.len() as u32;
        let from: Vec<u32> = from
            .iter()
            .map(|part| self.operand_register(part, false))
            .collect::<Option<_>>()?;
        let to = if bytes == 8 {
            self.result_register::<u64>(to)?
        } else {
            self.result_register::<u32>(to)?
        };
        Some(Op::Compute(Box::new(move |registers, mask| {
            let mut whole = [0_u64; LANES];
            for (part, &from) in from.iter().enumerate() {
                let ones = u32::MAX >> (32 - bits);
                for (whole, &from) in whole.iter_mut().zip(registers.words::<u32>(from)) {
                    *whole |= u64::from(from & ones) << (bits * part as u32);
                }
            }
            if bytes == 8 {
                registers.set(to, &whole, mask);
            } else {
                registers.set(to, &whole.map(|whole| whole as u32), mask);
            }
        })))
    }

    pub(super) fn select(&mut self) -> Option<Op> {
        of_type!(
            self.kind()?,
            ["b16" | "u16" | "s16" | "f16" | "bf16" => u16, "b32" | "u32" | "s32" | "f32" | "f16x2" | "bf16x2" => u32,
             "b64" | "u64" | "s64" | "f64" => u64],
            T => {
                let (to, a, b) = (self.to::<T>(0)?, self.from::<T>(1)?, self.from::<T>(2)?);
                let chosen = self.predicate(3)?;
                Some(Op::Compute(Box::new(move |registers: &mut Registers, mask| {
                    let chosen = bits(registers, chosen);
                    let (a, b) = (registers.words::<T>(a), registers.words::<T>(b));
                    let mut out = [T::default(); LANES];
                    for lane in 0..LANES {
                        out[lane] = T::read(if chosen >> lane & 1 == 1 { a[lane] } else { b[lane] });
                    }
                    registers.set(to, &out, mask);
                })))
            }
        )
    }
}

/// A register of any size.
fn wide(registers: &Registers, slot: u32, is_wide: bool) -> [u64; LANES] {
    if is_wide {
        registers.get::<u64>(slot)
    } else {
        registers.get::<u32>(slot).map(u64::from)
    }
}
