//! What the threads of a warp do together.

use super::line::Line;
use super::predicate::bits;
use crate::number::{Bf16, F16, Half};
use crate::program::{ComputeTogether, Op};
use crate::registers::{ALL, LANES, Mask, Registers, Two};
use crate::syntax::Operand;

impl Line<'_, '_> {
    fn together(
        members: u32,
        run: impl Fn(&mut Registers, Mask) -> Result<(), String> + Send + Sync + 'static,
    ) -> Op {
        Op::Together {
            members: Some(members),
            run: Box::new(run),
        }
    }

    pub(super) fn shuffle(&mut self) -> Option<Op> {
        self.require("sync")?;
        self.require("b32")?;
        let mode = self.one_of(&["up", "down", "bfly", "idx"])?;
        let (to, valid) = match self.operands.first()? {
            Operand::Pair(to, valid) => (
                self.result_register::<u32>(&Operand::Name(to))?,
                Some(self.predicate_named(valid)?),
            ),
            operand => (self.result_register::<u32>(operand)?, None),
        };
        let (a, by, limits) = (
            self.from::<u32>(1)?,
            self.from::<u32>(2)?,
            self.from::<u32>(3)?,
        );
        let members = self.from::<u32>(4)?;
        Some(Self::together(members, move |registers, mask| {
            let values = registers.get::<u32>(a);
            let (by, limits) = (registers.get::<u32>(by), registers.get::<u32>(limits));
            let (mut out, mut found) = (values, 0);
            for lane in (0..LANES as u32).filter(|lane| mask >> lane & 1 == 1) {
                let at = lane as usize;
                let (by, segment, clamp) = (by[at] & 31, limits[at] >> 8 & 31, limits[at] & 31);
                let (least, greatest) = (lane & segment, lane & segment | clamp & !segment);
                let (other, is_valid) = match mode {
                    "up" => (
                        lane.wrapping_sub(by),
                        lane as i32 - by as i32 >= greatest as i32,
                    ),
                    "down" => (lane + by, lane + by <= greatest),
                    "bfly" => (lane ^ by, lane ^ by <= greatest),
                    _ => (least | by & !segment, least | by & !segment <= greatest),
                };
                let other = if is_valid { other } else { lane };
                if mask >> other & 1 == 0 {
                    return Err(format!(
                        "thread {lane} of the warp reads from {other}, which does not take part"
                    ));
                }
                out[at] = values[other as usize];
                found |= u32::from(is_valid) << lane;
            }
            registers.set(to, &out, mask);
            if let Some(valid) = valid {
                registers.set_predicate(valid, found, mask);
            }
            Ok(())
        }))
    }

    pub(super) fn vote(&mut self, base: &str) -> Option<Op> {
        if base == "activemask" {
            self.require("b32")?;
            let to = self.to::<u32>(0)?;
            return Some(Op::Compute(Box::new(move |registers, mask| {
                registers.set(to, &[mask; LANES], mask)
            })));
        }
        self.require("sync")?;
        let mode = self.one_of(&["all", "any", "uni", "ballot"])?;
        self.kind()?;
        let (from, members) = (self.predicate(1)?, self.from::<u32>(2)?);
        if mode == "ballot" {
            let to = self.to::<u32>(0)?;
            return Some(Self::together(members, move |registers, mask| {
                registers.set(to, &[bits(registers, from) & mask; LANES], mask);
                Ok(())
            }));
        }
        let (to, _) = self.predicate(0)?;
        Some(Self::together(members, move |registers, mask| {
            let yes = bits(registers, from) & mask;
            let found = match mode {
                "all" => yes == mask,
                "any" => yes != 0,
                _ => yes == mask || yes == 0,
            };
            registers.set_predicate(to, if found { ALL } else { 0 }, mask);
            Ok(())
        }))
    }

    pub(super) fn reduce(&mut self) -> Option<Op> {
        self.require("sync")?;
        let kind = self.kind()?;
        let f: fn(u32, u32) -> u32 = match (self.words.pop()?, kind) {
            ("add", _) => u32::wrapping_add,
            ("min", "u32") => u32::min,
            ("max", "u32") => u32::max,
            ("min", "s32") => |a, b| (a as i32).min(b as i32) as u32,
            ("max", "s32") => |a, b| (a as i32).max(b as i32) as u32,
            ("and", _) => |a, b| a & b,
            ("or", _) => |a, b| a | b,
            ("xor", _) => |a, b| a ^ b,
            _ => return None,
        };
        let (to, a, members) = (
            self.to::<u32>(0)?,
            self.from::<u32>(1)?,
            self.from::<u32>(2)?,
        );
        Some(Self::together(members, move |registers, mask| {
            let values = registers.get::<u32>(a);
            let taking_part = values
                .iter()
                .enumerate()
                .filter(|&(lane, _)| mask >> lane & 1 == 1);
            let all = taking_part
                .map(|(_, &value)| value)
                .reduce(f)
                .unwrap_or_default();
            registers.set(to, &[all; LANES], mask);
            Ok(())
        }))
    }

    pub(super) fn barrier(&mut self) -> Option<Op> {
        self.take("cta");
        if self.take("warp") {
            self.require("sync")?;
            return Some(Self::together(self.from::<u32>(0)?, |_, _| Ok(())));
        }
        self.require("sync")?;
        self.take("aligned");
        let threads = if self.operands.len() > 1 {
            Some(self.from::<u32>(1)?)
        } else {
            None
        };
        Some(Op::Barrier {
            number: self.from::<u32>(0)?,
            threads,
        })
    }

    /// Of 16 x 16 and 16 x 8 numbers, or half as many, each register having two.
    pub(super) fn multiply_matrices(&mut self) -> Option<Op> {
        for word in ["sync", "aligned", "row", "col"] {
            self.require(word)?;
        }
        let depth = match self.one_of(&["m16n8k16", "m16n8k8"])? {
            "m16n8k16" => 16,
            _ => 8,
        };
        let run = match self.words[..] {
            ["f32", "f16", "f16", "f32"] => self.product::<F16>(depth)?,
            ["f32", "bf16", "bf16", "f32"] => self.product::<Bf16>(depth)?,
            _ => return None,
        };
        self.words.clear();
        Some(Op::Together { members: None, run })
    }

    fn product<H: Half>(&mut self, depth: usize) -> Option<ComputeTogether> {
        let mut registers = |operand: usize, count: usize, is_result: bool| -> Option<Vec<u32>> {
            let Operand::Vector(parts) = self.operands.get(operand)? else {
                return None;
            };
            let slot = |part| {
                if is_result {
                    self.result_register::<u32>(part)
                } else {
                    self.operand_register(part, false)
                }
            };
            let slots: Vec<u32> = parts.iter().map(slot).collect::<Option<_>>()?;
            (slots.len() == count).then_some(slots)
        };
        let to = registers(0, 4, true)?;
        let a = registers(1, depth / 4, false)?;
        let b = registers(2, depth / 8, false)?;
        let c = registers(3, 4, false)?;
        Some(Box::new(move |registers, mask| {
            if mask != ALL {
                return Err("a warp without all of its threads multiplies matrices".into());
            }
            let (mut left, mut right) = ([[0.0_f32; 16]; 16], [[0.0_f32; 8]; 16]);
            for (part, &slot) in a.iter().enumerate() {
                for (lane, Two(first, second)) in
                    registers.get::<Two<H>>(slot).into_iter().enumerate()
                {
                    let row = lane / 4 + 8 * (part % 2);
                    let column = lane % 4 * 2 + 8 * (part / 2);
                    left[row][column] = first.value();
                    left[row][column + 1] = second.value();
                }
            }
            for (part, &slot) in b.iter().enumerate() {
                for (lane, Two(first, second)) in
                    registers.get::<Two<H>>(slot).into_iter().enumerate()
                {
                    let row = lane % 4 * 2 + 8 * part;
                    right[row][lane / 4] = first.value();
                    right[row + 1][lane / 4] = second.value();
                }
            }
            let place =
                |part: usize, lane: usize| (lane / 4 + 8 * (part / 2), lane % 4 * 2 + part % 2);
            let mut sums = [[0.0_f32; 8]; 16];
            for (part, &slot) in c.iter().enumerate() {
                for (lane, value) in registers.get::<f32>(slot).into_iter().enumerate() {
                    let (row, column) = place(part, lane);
                    sums[row][column] = value;
                }
            }
            for (left, sums) in left.iter().zip(&mut sums) {
                for (&left, right) in left.iter().zip(&right).take(depth) {
                    for (sum, &right) in sums.iter_mut().zip(right) {
                        *sum += left * right;
                    }
                }
            }
            for (part, &slot) in to.iter().enumerate() {
                let values: [f32; LANES] = std::array::from_fn(|lane| {
                    let (row, column) = place(part, lane);
                    sums[row][column]
                });
                registers.set(slot, &values, ALL);
            }
            Ok(())
        }))
    }
}
