//! Floating point numbers. What a GPU computes approximately is computed as well as possible here.

use super::line::{Line, of_type};
use crate::number::{Bf16, F16, Half, Round, add_f64, fma_f32, to_f32};
use crate::program::Op;
use crate::registers::{Lane, Two};

/// What a result of f32 goes through, as an instruction says.
#[derive(Clone, Copy)]
struct Manner {
    round: Round,
    flush: bool,
    saturate: bool,
}

impl Manner {
    fn input(self, x: f32) -> f32 {
        if self.flush && x.abs() < f32::MIN_POSITIVE {
            0.0_f32.copysign(x)
        } else {
            x
        }
    }

    fn output(self, x: f32) -> f32 {
        let x = self.input(x);
        if self.saturate { saturated(x) } else { x }
    }
}

/// Between 0 and 1; what is no number is 0.
pub(super) fn saturated(x: f32) -> f32 {
    if x > 0.0 { x.min(1.0) } else { 0.0 }
}

macro_rules! least_and_greatest {
    ($($min:ident, $max:ident, $type:ty;)*) => {
        $(
            /// Of one number and what is none, the number; -0 is less than 0.
            fn $min(a: $type, b: $type) -> $type {
                if a < b || b.is_nan() || a == b && a.is_sign_negative() { a } else { b }
            }

            fn $max(a: $type, b: $type) -> $type {
                if a > b || b.is_nan() || a == b && a.is_sign_positive() { a } else { b }
            }
        )*
    };
}

least_and_greatest! {
    min_f32, max_f32, f32;
    min_f64, max_f64, f64;
}

/// Halves are computed one or two at a time.
trait Halves: Lane {
    type Of: Half;
    fn each(self, b: Self, c: Self, f: impl Fn(Self::Of, Self::Of, Self::Of) -> Self::Of) -> Self;
}

macro_rules! halves {
    ($($type:ty),*) => {
        $(
            impl Halves for $type {
                type Of = $type;
                fn each(self, b: Self, c: Self, f: impl Fn($type, $type, $type) -> $type) -> Self {
                    f(self, b, c)
                }
            }

            impl Halves for Two<$type> {
                type Of = $type;
                fn each(self, b: Self, c: Self, f: impl Fn($type, $type, $type) -> $type) -> Self {
                    Two(f(self.0, b.0, c.0), f(self.1, b.1, c.1))
                }
            }
        )*
    };
}

halves!(F16, Bf16);

impl Line<'_, '_> {
    pub(super) fn float(&mut self, base: &str) -> Option<Op> {
        if base == "testp" {
            return self.test();
        }
        match self.kind()? {
            "f32" => self.float_32(base),
            "f64" => self.float_64(base),
            kind => of_type!(
                kind,
                ["f16" => F16, "bf16" => Bf16, "f16x2" => Two<F16>, "bf16x2" => Two<Bf16>],
                T => self.half::<T>(base)
            ),
        }
    }

    /// Takes a rounding, if there is one.
    pub(super) fn rounding(&mut self) -> Option<Round> {
        Some(match self.one_of(&["rn", "rz", "rm", "rp"])? {
            "rn" => Round::Nearest,
            "rz" => Round::Zero,
            "rm" => Round::Down,
            _ => Round::Up,
        })
    }

    fn float_32(&mut self, base: &str) -> Option<Op> {
        let manner = Manner {
            round: self.rounding().unwrap_or(Round::Nearest),
            flush: self.take("ftz"),
            saturate: self.take("sat"),
        };
        let Manner { round, .. } = manner;
        macro_rules! unary {
            ($f:expr) => {
                self.unary(move |a: f32| manner.output($f(manner.input(a))))
            };
        }
        macro_rules! binary {
            ($f:expr) => {
                self.binary(move |a: f32, b: f32| {
                    manner.output($f(manner.input(a), manner.input(b)))
                })
            };
        }
        let is_nearest = round == Round::Nearest;
        match base {
            "add" if is_nearest => binary!(|a, b| a + b),
            "sub" if is_nearest => binary!(|a, b| a - b),
            "mul" if is_nearest => binary!(|a, b| a * b),
            "add" => binary!(|a, b| fma_f32(a, 1.0, b, round)),
            "sub" => binary!(|a, b: f32| fma_f32(a, 1.0, -b, round)),
            "mul" => binary!(|a, b| to_f32(f64::from(a) * f64::from(b), round)),
            "fma" | "mad" if is_nearest => self.ternary(move |a: f32, b: f32, c: f32| {
                manner.output(manner.input(a).mul_add(manner.input(b), manner.input(c)))
            }),
            "fma" | "mad" => self.ternary(move |a: f32, b: f32, c: f32| {
                manner.output(fma_f32(
                    manner.input(a),
                    manner.input(b),
                    manner.input(c),
                    round,
                ))
            }),
            "div" if is_nearest => {
                let _ = self.take("full") || self.take("approx");
                binary!(|a, b| a / b)
            }
            "min" | "max" => {
                let keeps_nan = self.take("NaN");
                let f = if base == "min" { min_f32 } else { max_f32 };
                binary!(
                    move |a: f32, b: f32| if keeps_nan && (a.is_nan() || b.is_nan()) {
                        f32::NAN
                    } else {
                        f(a, b)
                    }
                )
            }
            "abs" => unary!(f32::abs),
            "neg" => unary!(|a: f32| -a),
            "copysign" => self.binary(|a: f32, b: f32| b.copysign(a)),
            _ => {
                if !is_nearest {
                    return None;
                }
                self.take("approx");
                match base {
                    "rcp" => unary!(f32::recip),
                    "sqrt" => unary!(f32::sqrt),
                    "rsqrt" => unary!(|a: f32| f64::from(a).sqrt().recip() as f32),
                    "sin" => unary!(f32::sin),
                    "cos" => unary!(f32::cos),
                    "lg2" => unary!(f32::log2),
                    "ex2" => unary!(f32::exp2),
                    "tanh" => unary!(f32::tanh),
                    _ => None,
                }
            }
        }
    }

    fn float_64(&mut self, base: &str) -> Option<Op> {
        match self.rounding() {
            None | Some(Round::Nearest) => {}
            Some(round) if base == "add" => return self.binary(move |a, b| add_f64(a, b, round)),
            Some(_) => return None,
        }
        match base {
            "add" => self.binary(|a: f64, b: f64| a + b),
            "sub" => self.binary(|a: f64, b: f64| a - b),
            "mul" => self.binary(|a: f64, b: f64| a * b),
            "div" => self.binary(|a: f64, b: f64| a / b),
            "fma" | "mad" => self.ternary(f64::mul_add),
            "min" => self.binary(min_f64),
            "max" => self.binary(max_f64),
            "abs" => self.unary(f64::abs),
            "neg" => self.unary(|a: f64| -a),
            "copysign" => self.binary(|a: f64, b: f64| b.copysign(a)),
            "sqrt" => self.unary(f64::sqrt),
            "rcp" | "rsqrt" => {
                // The approximate ones have the upper half of a number's bits.
                let is_short = self.take("approx");
                self.take("ftz");
                let shorten = move |x: f64| {
                    if is_short {
                        f64::from_bits(x.to_bits() & !0xffff_ffff)
                    } else {
                        x
                    }
                };
                let is_root = base == "rsqrt";
                self.unary(move |a: f64| {
                    shorten(if is_root { a.sqrt().recip() } else { a.recip() })
                })
            }
            _ => None,
        }
    }

    fn half<T: Halves>(&mut self, base: &str) -> Option<Op> {
        self.take("rn");
        macro_rules! unary {
            ($f:expr) => {
                self.unary(|a: T| a.each(a, a, |a, _, _| T::Of::near($f(a.value()))))
            };
        }
        macro_rules! binary {
            ($f:expr) => {
                self.binary(|a: T, b: T| {
                    a.each(b, b, |a, b, _| T::Of::near($f(a.value(), b.value())))
                })
            };
        }
        match base {
            // f32 has so many bits that rounding twice is as good as once.
            "add" => binary!(|a, b| a + b),
            "sub" => binary!(|a, b| a - b),
            "mul" => binary!(|a, b| a * b),
            "fma" => {
                let is_positive = self.take("relu");
                self.ternary(move |a: T, b: T, c: T| {
                    a.each(b, c, |a, b, c| {
                        let sum = a.fma(b, c);
                        if is_positive && sum.value() < 0.0 {
                            T::Of::near(0.0)
                        } else {
                            sum
                        }
                    })
                })
            }
            "min" | "max" => {
                let keeps_nan = self.take("NaN");
                let f = if base == "min" { min_f32 } else { max_f32 };
                self.binary(move |a: T, b: T| {
                    a.each(b, b, |a, b, _| {
                        let (a, b) = (a.value(), b.value());
                        T::Of::near(if keeps_nan && (a.is_nan() || b.is_nan()) {
                            f32::NAN
                        } else {
                            f(a, b)
                        })
                    })
                })
            }
            "abs" => self.unary(|a: T| a.each(a, a, |a, _, _| T::Of::from_bits(a.bits() & 0x7fff))),
            "neg" => self.unary(|a: T| a.each(a, a, |a, _, _| T::Of::from_bits(a.bits() ^ 0x8000))),
            "ex2" | "tanh" => {
                self.take("approx");
                self.take("ftz");
                if base == "ex2" {
                    unary!(f32::exp2)
                } else {
                    unary!(f32::tanh)
                }
            }
            _ => None,
        }
    }

    fn test(&mut self) -> Option<Op> {
        let kind = self.kind()?;
        let word = self.words.pop()?;
        macro_rules! tested {
            ($T:ty) => {{
                let f: fn($T) -> bool = match word {
                    "finite" => <$T>::is_finite,
                    "infinite" => <$T>::is_infinite,
                    "number" => |a| !a.is_nan(),
                    "notanumber" => <$T>::is_nan,
                    "normal" => <$T>::is_normal,
                    "subnormal" => <$T>::is_subnormal,
                    _ => return None,
                };
                let ((to, _), from) = (self.predicate(0)?, self.from::<$T>(1)?);
                Some(Op::Compute(Box::new(move |registers, mask| {
                    let values = registers.get::<$T>(from);
                    let found = values
                        .iter()
                        .enumerate()
                        .fold(0, |found, (lane, &a)| found | u32::from(f(a)) << lane);
                    registers.set_predicate(to, found, mask);
                })))
            }};
        }
        match kind {
            "f32" => tested!(f32),
            "f64" => tested!(f64),
            _ => None,
        }
    }
}
