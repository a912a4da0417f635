//! Numbers of 16 bits, and roundings that Rust does not have.

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Round {
    Nearest,
    Zero,
    Down,
    Up,
}

/// Numbers of fewer bits than f64.
struct Format {
    /// Bits of the fraction.
    fraction: i32,
    /// The exponent of the least normal number.
    least: i32,
    max: f64,
}

const AS_F16: Format = Format {
    fraction: 10,
    least: -14,
    max: 65504.0,
};
const AS_BF16: Format = Format {
    fraction: 7,
    least: -126,
    max: f32::from_bits(0x7f7f_0000) as f64,
};
const AS_F32: Format = Format {
    fraction: 23,
    least: -126,
    max: f32::MAX as f64,
};

fn power_of_2(exponent: i32) -> f64 {
    f64::from_bits(((exponent + 1023) as u64) << 52)
}

pub(crate) fn to_whole(x: f64, round: Round) -> f64 {
    match round {
        Round::Nearest => x.round_ties_even(),
        Round::Zero => x.trunc(),
        Round::Down => x.floor(),
        Round::Up => x.ceil(),
    }
}

fn rounded(x: f64, to: &Format, round: Round) -> f64 {
    if x == 0.0 || !x.is_finite() {
        return x;
    }
    let exponent = ((x.to_bits() >> 52 & 0x7ff) as i32 - 1023).max(to.least);
    let step = power_of_2(exponent - to.fraction);
    let result = to_whole(x / step, round) * step;
    if result.abs() <= to.max {
        return result.copysign(x);
    }
    let stays = match round {
        Round::Nearest => false,
        Round::Zero => true,
        Round::Down => x > 0.0,
        Round::Up => x < 0.0,
    };
    if stays {
        to.max.copysign(x)
    } else {
        f64::INFINITY.copysign(x)
    }
}

pub(crate) fn to_f32(x: f64, round: Round) -> f32 {
    match round {
        Round::Nearest => x as f32,
        _ => rounded(x, &AS_F32, round) as f32,
    }
}

/// The sum, whose last bit is 1 if it is not exact: rounded to fewer bits, it is what the exact sum is rounded to.
pub(crate) fn odd_sum(a: f64, b: f64) -> f64 {
    let (sum, error) = sum_and_error(a, b);
    toward(sum, error)
}

/// The nearest to a sum, and what it lacks.
fn sum_and_error(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let of_b = sum - a;
    (sum, (a - (sum - of_b)) + (b - of_b))
}

pub(crate) fn add_f64(a: f64, b: f64, round: Round) -> f64 {
    let (sum, error) = sum_and_error(a, b);
    match round {
        Round::Down if error < 0.0 => sum.next_down(),
        Round::Up if error > 0.0 => sum.next_up(),
        Round::Zero if error < 0.0 && sum > 0.0 => sum.next_down(),
        Round::Zero if error > 0.0 && sum < 0.0 => sum.next_up(),
        _ => sum,
    }
}

/// `x`, which is `error` less than the exact value.
fn toward(x: f64, error: f64) -> f64 {
    let bits = x.to_bits();
    let wrong = error != 0.0 && error.is_finite() && x.is_finite() && bits & 1 == 0;
    let step = if (error > 0.0) == (x > 0.0) {
        1_u64
    } else {
        u64::MAX
    };
    f64::from_bits(if wrong { bits.wrapping_add(step) } else { bits })
}

/// A whole number, with a last bit as in [`odd_sum`].
pub(crate) fn odd_whole(x: i128) -> f64 {
    let near = x as f64;
    toward(near, (x - near as i128) as f64)
}

pub(crate) fn fma_f32(a: f32, b: f32, c: f32, round: Round) -> f32 {
    match round {
        Round::Nearest => a.mul_add(b, c),
        _ => to_f32(odd_sum(f64::from(a) * f64::from(b), c.into()), round),
    }
}

/// Numbers of 16 bits.
pub(crate) trait Half: Copy + Default + 'static {
    fn from_bits(bits: u16) -> Self;
    fn bits(self) -> u16;
    fn value(self) -> f32;
    fn near(x: f32) -> Self;
    fn of(x: f64, round: Round) -> Self;

    /// Of a value that is exact or has an odd last bit.
    fn near_odd(x: f64) -> Self {
        let near = x as f32;
        let bits = near.to_bits();
        let wrong = f64::from(near) != x && near.is_finite() && bits & 1 == 0;
        let step = if x.abs() > f64::from(near.abs()) {
            1
        } else {
            u32::MAX
        };
        Self::near(f32::from_bits(if wrong {
            bits.wrapping_add(step)
        } else {
            bits
        }))
    }

    fn fma(self, b: Self, c: Self) -> Self {
        Self::near_odd(odd_sum(
            f64::from(self.value()) * f64::from(b.value()),
            c.value().into(),
        ))
    }
}

#[derive(Clone, Copy, Default)]
pub(crate) struct F16(pub(crate) u16);

#[derive(Clone, Copy, Default)]
pub(crate) struct Bf16(pub(crate) u16);

impl Half for F16 {
    fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    fn bits(self) -> u16 {
        self.0
    }

    fn value(self) -> f32 {
        let sign = u32::from(self.0 & 0x8000) << 16;
        let magnitude = u32::from(self.0 & 0x7fff) << 13;
        let special = if self.0 & 0x7c00 == 0x7c00 {
            0x7f80_0000
        } else {
            0
        };
        // 2^112 is what exponents differ by; the product is exact for subnormal numbers, too.
        let scaled = f32::from_bits(magnitude) * f32::from_bits(0x7780_0000);
        f32::from_bits((scaled.to_bits() | special) | sign)
    }

    fn near(x: f32) -> Self {
        let magnitude = x.to_bits() & 0x7fff_ffff;
        // The last bit of 0.5 is that of subnormal numbers.
        let subnormal = (f32::from_bits(magnitude) + 0.5)
            .to_bits()
            .wrapping_sub(0x3f00_0000);
        let normal =
            ((magnitude.wrapping_add(0xfff) + (magnitude >> 13 & 1)) >> 13).wrapping_sub(112 << 10);
        let bits = match magnitude {
            0x7f80_0001.. => 0x7fff,
            0x4780_0000.. => 0x7c00,
            0x3880_0000.. => normal,
            _ => subnormal,
        };
        let sign = if x.is_nan() {
            0
        } else {
            (x.to_bits() >> 16) as u16 & 0x8000
        };
        Self(bits as u16 | sign)
    }

    fn of(x: f64, round: Round) -> Self {
        Self::near(rounded(x, &AS_F16, round) as f32)
    }
}

impl Half for Bf16 {
    fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    fn bits(self) -> u16 {
        self.0
    }

    fn value(self) -> f32 {
        f32::from_bits(u32::from(self.0) << 16)
    }

    fn near(x: f32) -> Self {
        let bits = x.to_bits();
        let rounded = (bits.wrapping_add(0x7fff + (bits >> 16 & 1)) >> 16) as u16;
        Self(if x.is_nan() { 0x7fff } else { rounded })
    }

    fn of(x: f64, round: Round) -> Self {
        Self::near(rounded(x, &AS_BF16, round) as f32)
    }
}
