//! Numbers of one type as those of another.

use super::float::saturated;
use super::line::{Line, of_type, one};
use crate::number::{Bf16, F16, Half, Round, odd_whole, to_f32, to_whole};
use crate::program::{Op, Place};
use crate::registers::{Lane, Two};

/// `$body` with `$T` as the type of whole numbers that `$kind` names.
macro_rules! whole {
    ($kind:expr, $T:ident => $body:expr) => {
        of_type!(
            $kind,
            ["u8" | "b8" => u8, "s8" => i8, "u16" | "b16" => u16, "s16" => i16, "u32" | "b32" => u32, "s32" => i32,
             "u64" | "b64" => u64, "s64" => i64],
            $T => $body
        )
    };
}

/// What becomes of a number, as an instruction says.
#[derive(Clone, Copy)]
struct Manner {
    round: Round,
    /// Rounded to a whole number.
    is_whole: bool,
    flush: bool,
    saturate: bool,
    is_positive: bool,
}

impl Manner {
    fn input(self, x: f32) -> f64 {
        f64::from(if self.flush && x.abs() < f32::MIN_POSITIVE {
            0.0_f32.copysign(x)
        } else {
            x
        })
    }

    /// The value before it is rounded.
    fn value(self, x: f64) -> f64 {
        let x = if self.is_whole {
            to_whole(x, self.round)
        } else {
            x
        };
        let x = if self.is_positive && x < 0.0 { 0.0 } else { x };
        match self.saturate {
            true if x > 0.0 => x.min(1.0),
            true => 0.0,
            false => x,
        }
    }
}

impl Line<'_, '_> {
    pub(super) fn convert(&mut self) -> Option<Op> {
        let from = self.kind()?;
        let to = self.kind()?;
        let whole_rounding = self.one_of(&["rni", "rzi", "rmi", "rpi"]);
        let round = match whole_rounding {
            Some("rni") => Round::Nearest,
            Some("rzi") => Round::Zero,
            Some("rmi") => Round::Down,
            Some(_) => Round::Up,
            None => self.rounding().unwrap_or(Round::Nearest),
        };
        let manner = Manner {
            round,
            is_whole: whole_rounding.is_some(),
            flush: self.take("ftz"),
            saturate: self.take("sat"),
            is_positive: self.take("relu"),
        };
        let is_float = |kind: &str| matches!(kind, "f16" | "bf16" | "f32" | "f64");
        match (to, from) {
            ("f16x2", "f32") => self.convert_two::<F16>(manner),
            ("bf16x2", "f32") => self.convert_two::<Bf16>(manner),
            _ if is_float(to) && is_float(from) => self.float_to_float(to, from, manner),
            _ if is_float(to) => {
                whole!(from, T => self.whole_to_float::<T>(to, |x| x as i128, round))
            }
            _ if is_float(from) => {
                whole!(to, T => self.float_to_whole::<T>(from, manner, |x| x as T))
            }
            _ if manner.saturate => whole!(from, S => whole!(to, T => {
                self.convert_with(|x: S| (x as i128).clamp(T::MIN as i128, T::MAX as i128) as T)
            })),
            _ => whole!(from, S => whole!(to, T => self.convert_with(|x: S| x as T))),
        }
    }

    /// Registers may be larger than what is in them.
    fn convert_with<A: Lane, R: Lane>(
        &mut self,
        f: impl Fn(A) -> R + Send + Sync + 'static,
    ) -> Option<Op> {
        let [to, from] = self.operands else {
            return None;
        };
        let (to, from) = (self.register(to), self.register(from));
        match (to, from) {
            (_, Some(Place { slot, wide: true })) if size_of::<A::Word>() == 4 => {
                let to = self.to::<R>(0)?;
                Some(one(to, slot, move |x: u64| f(A::narrow(x))))
            }
            (Some(Place { slot, wide: true }), _) if size_of::<R::Word>() == 4 => {
                let from = self.from::<A>(1)?;
                Some(one(slot, from, move |x: A| f(x).wide()))
            }
            _ => self.unary(f),
        }
    }

    /// The first number is the upper half.
    fn convert_two<H: Half>(&mut self, manner: Manner) -> Option<Op> {
        let convert = move |x: f32| H::of(manner.value(manner.input(x)), manner.round);
        let is_plain = manner.round == Round::Nearest
            && !manner.is_positive
            && !manner.saturate
            && !manner.flush;
        if is_plain {
            return self.binary(|a: f32, b: f32| Two(H::near(b), H::near(a)));
        }
        self.binary(move |a: f32, b: f32| Two(convert(b), convert(a)))
    }

    fn float_to_float(&mut self, to: &str, from: &str, manner: Manner) -> Option<Op> {
        let Manner {
            round,
            is_whole,
            flush,
            saturate,
            is_positive,
        } = manner;
        if round == Round::Nearest && !is_whole && !flush && !saturate && !is_positive {
            match (to, from) {
                ("f32", "f16") => return self.unary(F16::value),
                ("f32", "bf16") => return self.unary(Bf16::value),
                ("f16", "f32") => return self.unary(F16::near),
                ("bf16", "f32") => return self.unary(Bf16::near),
                _ => {}
            }
        }
        macro_rules! from {
            ($A:ty, $value:expr) => {
                match to {
                    "f16" => self.unary(move |x: $A| F16::of(manner.value($value(x)), round)),
                    "bf16" => self.unary(move |x: $A| Bf16::of(manner.value($value(x)), round)),
                    "f32" => self.unary(move |x: $A| {
                        let result = to_f32(manner.value($value(x)), round);
                        manner.input(if saturate { saturated(result) } else { result }) as f32
                    }),
                    _ => self.unary(move |x: $A| manner.value($value(x))),
                }
            };
        }
        match from {
            "f16" => from!(F16, |x: F16| f64::from(x.value())),
            "bf16" => from!(Bf16, |x: Bf16| f64::from(x.value())),
            "f32" => from!(f32, |x| manner.input(x)),
            _ => from!(f64, |x: f64| x),
        }
    }

    fn whole_to_float<A: Lane>(
        &mut self,
        to: &str,
        whole: fn(A) -> i128,
        round: Round,
    ) -> Option<Op> {
        match to {
            "f16" => self.convert_with(move |x: A| F16::of(odd_whole(whole(x)), round)),
            "bf16" => self.convert_with(move |x: A| Bf16::of(odd_whole(whole(x)), round)),
            "f32" => self.convert_with(move |x: A| to_f32(odd_whole(whole(x)), round)),
            _ if round == Round::Nearest => self.convert_with(move |x: A| whole(x) as f64),
            _ => None,
        }
    }

    /// What is no number is 0, or the highest bit in 64 bits.
    fn float_to_whole<R: Lane>(
        &mut self,
        from: &str,
        manner: Manner,
        whole: fn(f64) -> R,
    ) -> Option<Op> {
        // What does not fit becomes the nearest that does.
        let is_long = size_of::<R::Word>() == 8;
        let convert = move |x: f64| {
            if x.is_nan() && is_long {
                R::narrow(1 << 63)
            } else {
                whole(to_whole(x, manner.round))
            }
        };
        match from {
            "f16" => self.convert_with(move |x: F16| convert(x.value().into())),
            "bf16" => self.convert_with(move |x: Bf16| convert(x.value().into())),
            "f32" => self.convert_with(move |x: f32| convert(manner.input(x))),
            _ => self.convert_with(convert),
        }
    }

    /// Addresses of a space as those of any, and back.
    pub(super) fn convert_address(&mut self) -> Option<Op> {
        let base = |space: &str| match space {
            "shared" => Some(crate::warp::SHARED),
            "local" => Some(crate::warp::LOCAL),
            "global" | "const" => Some(0),
            _ => None,
        };
        self.require("u64")?;
        let to = self.take("to");
        let space = self.words.pop()?;
        let base = base(space.split("::").next()?)?;
        self.unary(move |address: u64| {
            if to {
                address.wrapping_sub(base)
            } else {
                address.wrapping_add(base)
            }
        })
    }

    pub(super) fn is_in_space(&mut self) -> Option<Op> {
        let space = self.words.pop()?;
        let region = match space.split("::").next()? {
            "shared" => crate::warp::SHARED,
            "local" => crate::warp::LOCAL,
            "global" => 0,
            _ => return None,
        };
        let ((to, _), from) = (self.predicate(0)?, self.from::<u64>(1)?);
        Some(Op::Compute(Box::new(move |registers, mask| {
            let addresses = registers.get::<u64>(from);
            let found = addresses
                .iter()
                .enumerate()
                .fold(0, |found, (lane, address)| {
                    found | u32::from(address & crate::warp::REGION == region) << lane
                });
            registers.set_predicate(to, found, mask);
        })))
    }
}
