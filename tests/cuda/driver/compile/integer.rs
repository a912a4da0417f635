//! Whole numbers and bits.

use super::line::{Line, integers, of_type};
use crate::program::{CARRY, Op};
use crate::registers::{LANES, Lane, Registers};

impl Line<'_, '_> {
    pub(super) fn integer(&mut self, base: &str) -> Option<Op> {
        if self.words == ["pred"] {
            self.words.clear();
            return self.logic(base);
        }
        if self.words.contains(&"cc") || matches!(base, "addc" | "subc" | "madc") {
            return self.with_carry(base);
        }
        // What is not for whole numbers is left as it is.
        let &kind = self.words.last()?;
        if !matches!(
            kind,
            "b16" | "u16" | "s16" | "b32" | "u32" | "s32" | "b64" | "u64" | "s64"
        ) {
            return None;
        }
        self.kind();
        match base {
            "add" => integers!(kind, T => self.binary(T::wrapping_add)),
            "sub" => integers!(kind, T => self.binary(T::wrapping_sub)),
            "mul" | "mad" => self.multiply(base == "mad", kind),
            "div" => {
                integers!(kind, T => self.binary(|a: T, b: T| if b == 0 { !0 } else { a.wrapping_div(b) }))
            }
            "rem" => {
                integers!(kind, T => self.binary(|a: T, b: T| if b == 0 { a } else { a.wrapping_rem(b) }))
            }
            "min" => integers!(kind, T => self.binary(|a: T, b: T| a.min(b))),
            "max" => integers!(kind, T => self.binary(|a: T, b: T| a.max(b))),
            "abs" => of_type!(
                kind, ["s16" => i16, "s32" => i32, "s64" => i64], T => self.unary(T::wrapping_abs)
            ),
            "neg" => integers!(kind, T => self.unary(T::wrapping_neg)),
            "not" => integers!(kind, T => self.unary(|a: T| !a)),
            "cnot" => integers!(kind, T => self.unary(|a: T| T::from(a == 0))),
            "and" => integers!(kind, T => self.binary(|a: T, b: T| a & b)),
            "or" => integers!(kind, T => self.binary(|a: T, b: T| a | b)),
            "xor" => integers!(kind, T => self.binary(|a: T, b: T| a ^ b)),
            "sad" => {
                integers!(kind, T => self.ternary(|a: T, b: T, c: T| c.wrapping_add(a.max(b).wrapping_sub(a.min(b)))))
            }
            "popc" => of_type!(kind, ["b32" => u32, "b64" => u64], T => self.unary(T::count_ones)),
            "clz" => {
                of_type!(kind, ["b32" => u32, "b64" => u64], T => self.unary(T::leading_zeros))
            }
            "brev" => {
                of_type!(kind, ["b32" => u32, "b64" => u64], T => self.unary(T::reverse_bits))
            }
            "bfind" => self.find_bit(kind),
            "shl" | "shr" => self.shift(base == "shl", kind),
            "shf" => self.funnel(),
            "bfe" => self.extract(kind),
            "bfi" => self.insert(kind),
            "prmt" => self.permute(),
            "lop3" => self.any_logic(),
            _ => None,
        }
    }

    fn multiply(&mut self, adds: bool, kind: &str) -> Option<Op> {
        if self.take("wide") {
            macro_rules! wide {
                ($narrow:ty, $wide:ty) => {
                    if adds {
                        self.ternary(|a: $narrow, b: $narrow, c: $wide| {
                            (a as $wide * b as $wide).wrapping_add(c)
                        })
                    } else {
                        self.binary(|a: $narrow, b: $narrow| a as $wide * b as $wide)
                    }
                };
            }
            return match kind {
                "u16" => wide!(u16, u32),
                "s16" => wide!(i16, i32),
                "u32" => wide!(u32, u64),
                "s32" => wide!(i32, i64),
                _ => None,
            };
        }
        if self.take("hi") {
            return integers!(kind, T => {
                // Of a product that does not fit, the bits in question are right, too.
                let high = |a: T, b: T| ((a as i128).wrapping_mul(b as i128) >> T::BITS) as T;
                if adds {
                    self.ternary(move |a: T, b: T, c: T| high(a, b).wrapping_add(c))
                } else {
                    self.binary(high)
                }
            });
        }
        self.require("lo")?;
        if adds {
            integers!(kind, T => self.ternary(|a: T, b: T, c: T| a.wrapping_mul(b).wrapping_add(c)))
        } else {
            integers!(kind, T => self.binary(T::wrapping_mul))
        }
    }

    /// Sums whose carry is kept or taken.
    fn with_carry(&mut self, base: &str) -> Option<Op> {
        let (keeps, takes) = (self.take("cc"), base.ends_with('c'));
        let high = self.take("hi");
        self.take("lo");
        let (operands, negate) = match base.trim_end_matches('c') {
            "add" => (2, false),
            "sub" => (2, true),
            "mad" => (3, false),
            _ => return None,
        };
        of_type!(self.kind()?, ["u32" | "s32" | "b32" => u32, "u64" | "s64" | "b64" => u64], T => {
            let (to, a, b) = (self.to::<T>(0)?, self.from::<T>(1)?, self.from::<T>(2)?);
            let c = if operands == 3 { Some(self.from::<T>(3)?) } else { None };
            Some(Op::Compute(Box::new(move |registers: &mut Registers, mask| {
                let before = if takes { registers.predicate(CARRY) } else { 0 };
                let (a, b) = (registers.get::<T>(a), registers.get::<T>(b));
                let c = c.map(|c| registers.get::<T>(c));
                let (mut out, mut after) = ([0; LANES], 0);
                for lane in 0..LANES {
                    let (left, right) = match &c {
                        Some(c) => {
                            let product = a[lane] as u128 * b[lane] as u128;
                            ((if high { product >> T::BITS } else { product }) as T, c[lane])
                        }
                        None => (a[lane], b[lane]),
                    };
                    let carry = (before >> lane & 1) as T;
                    let (sum, over) = if negate { left.overflowing_sub(right) } else { left.overflowing_add(right) };
                    let (sum, again) = if negate { sum.overflowing_sub(carry) } else { sum.overflowing_add(carry) };
                    out[lane] = sum;
                    after |= u32::from(over || again) << lane;
                }
                registers.set(to, &out, mask);
                if keeps {
                    registers.set_predicate(CARRY, after, mask);
                }
            })))
        })
    }

    fn shift(&mut self, left: bool, kind: &str) -> Option<Op> {
        integers!(kind, T => {
            let (to, a, by) = (self.to::<T>(0)?, self.from::<T>(1)?, self.from::<u32>(2)?);
            Some(Op::Compute(Box::new(move |registers: &mut Registers, mask| {
                let (a, by) = (registers.words::<T>(a), registers.words::<u32>(by));
                let mut shifted = [T::default(); LANES];
                for lane in 0..LANES {
                    let (a, by) = (T::read(a[lane]), by[lane]);
                    shifted[lane] = match (left, by >= T::BITS) {
                        (true, false) => a << by,
                        (false, false) => a >> by,
                        // What is left of a signed number is its sign.
                        (false, true) if T::MIN != 0 => a >> (T::BITS - 1),
                        _ => 0,
                    };
                }
                registers.set(to, &shifted, mask);
            })))
        })
    }

    /// Of the 64 bits of two registers, 32.
    fn funnel(&mut self) -> Option<Op> {
        let left = self.one_of(&["l", "r"])? == "l";
        let wraps = self.one_of(&["wrap", "clamp"])? == "wrap";
        self.ternary(move |low: u32, high: u32, by: u32| {
            let both = u64::from(high) << 32 | u64::from(low);
            let by = if wraps { by & 31 } else { by.min(32) };
            if left {
                (both << by >> 32) as u32
            } else {
                (both >> by) as u32
            }
        })
    }

    fn find_bit(&mut self, kind: &str) -> Option<Op> {
        let as_shift = self.take("shiftamt");
        of_type!(kind, ["u32" => u32, "s32" => i32, "u64" => u64, "s64" => i64], T => {
            self.unary(move |a: T| {
                // Of a negative number, the highest 0.
                let zeros = (if a < T::from(false) { !a } else { a }).leading_zeros();
                match (zeros == T::BITS, as_shift) {
                    (true, _) => u32::MAX,
                    (false, true) => zeros,
                    (false, false) => T::BITS - 1 - zeros,
                }
            })
        })
    }

    fn extract(&mut self, kind: &str) -> Option<Op> {
        of_type!(kind, ["u32" => u32, "s32" => i32, "u64" => u64, "s64" => i64], T => {
            self.ternary(|a: T, at: u32, length: u32| {
                let (at, length) = (at & 0xff, length & 0xff);
                if length == 0 {
                    return 0;
                }
                // Beyond the highest bit, there is the sign.
                let end = (at + length).min(T::BITS);
                if at >= T::BITS {
                    return if a < T::from(false) { !0 } else { 0 };
                }
                a << (T::BITS - end) >> (T::BITS - end + at)
            })
        })
    }

    fn insert(&mut self, kind: &str) -> Option<Op> {
        of_type!(kind, ["b32" => u32, "b64" => u64], T => {
            let (to, a) = (self.to::<T>(0)?, self.from::<T>(1)?);
            let (b, at, length) = (self.from::<T>(2)?, self.from::<u32>(3)?, self.from::<u32>(4)?);
            Some(Op::Compute(Box::new(move |registers: &mut Registers, mask| {
                let (a, b) = (registers.get::<T>(a), registers.get::<T>(b));
                let (at, length) = (registers.get::<u32>(at), registers.get::<u32>(length));
                let out: [T; LANES] = std::array::from_fn(|lane| {
                    let (at, length) = (at[lane] & 0xff, length[lane] & 0xff);
                    let ones = if length >= T::BITS { T::MAX } else { (1 << length) - 1 };
                    let place = ones.checked_shl(at).unwrap_or(0);
                    b[lane] & !place | a[lane].checked_shl(at).unwrap_or(0) & place
                });
                registers.set(to, &out, mask);
            })))
        })
    }

    /// Four bytes of two registers.
    fn permute(&mut self) -> Option<Op> {
        self.ternary(|a: u32, b: u32, choice: u32| {
            let both = u64::from(b) << 32 | u64::from(a);
            (0..4).fold(0, |out, byte| {
                let choice = choice >> (4 * byte);
                let found = (both >> (8 * (choice & 7))) as u8;
                let found = if choice & 8 == 0 {
                    found
                } else {
                    ((found as i8) >> 7) as u8
                };
                out | u32::from(found) << (8 * byte)
            })
        })
    }

    fn any_logic(&mut self) -> Option<Op> {
        let table = self.number(4)? as u32;
        self.ternary(move |a: u32, b: u32, c: u32| {
            (0..8)
                .filter(|case| table >> case & 1 == 1)
                .fold(0, |out, case| {
                    let of = |bits: u32, bit: u32| if case & bit == 0 { !bits } else { bits };
                    out | of(a, 4) & of(b, 2) & of(c, 1)
                })
        })
    }
}
