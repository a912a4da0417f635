//! Functions of vectors.

use super::simd::Simd;
use crate::nn::Activation;

/// `c[0] + c[1] x + c[2] x^2 + ..`
#[inline(always)]
fn polynomial<S: Simd, const N: usize>(simd: S, x: S::V, c: &[f32; N]) -> S::V {
    let mut sum = simd.splat(c[N - 1]);
    for &c in c[..N - 1].iter().rev() {
        sum = simd.fma(sum, x, simd.splat(c));
    }
    sum
}

/// `exp(x)` with a relative error below 3e-7; infinite above 88.8, zero below -104.
#[inline(always)]
pub(super) fn exp<S: Simd>(simd: S, x: S::V) -> S::V {
    // exp(x) = 2^n exp(r), |r| <= ln(2) / 2. The polynomial is the minimax one for the relative
    // error, which is 2e-9 before rounding.
    const EXP: [f32; 7] = [
        1.0,
        1.0,
        0.499_999_9,
        0.166_664_19,
        0.041_668_232,
        0.008_374_898,
        0.001_383_673_8,
    ];
    // ln(2) in two parts: n times the first is exact.
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    let x = simd.max(simd.splat(-110.0), simd.min(simd.splat(90.0), x));
    let n = simd.round(simd.mul(x, simd.splat(std::f32::consts::LOG2_E)));
    let r = simd.fnma(n, simd.splat(LN_2[0]), x);
    let r = simd.fnma(n, simd.splat(LN_2[1]), r);
    simd.scale(polynomial(simd, r, &EXP), n)
}

/// `2^y` with a relative error below 2e-7 for `y` within -125 to 127; `2^-125` below that.
#[inline(always)]
pub(super) fn exp2<S: Simd>(simd: S, y: S::V) -> S::V {
    // 2^y = 2^n 2^f, |f| <= 1/2. The minimax polynomial for the relative error, 2e-9.
    const EXP2: [f32; 7] = [
        1.0,
        std::f32::consts::LN_2,
        0.240_226_47,
        0.055_503_285,
        0.009_618_49,
        0.001_340_006_3,
        0.000_153_456_93,
    ];
    let y = simd.max(simd.splat(-125.0), y);
    let n = simd.round(y);
    // The polynomial is within 0.7 to 1.5, and the result no smaller than 2^-126.
    simd.scale_normal(polynomial(simd, simd.sub(y, n), &EXP2), n)
}

/// `x Phi(x)`, Phi being the normal distribution function; the error is below 5e-8 and a unit in
/// the last place of the result. At negative infinity it is about -5e-15.
#[inline(always)]
pub(super) fn gelu<S: Simd>(simd: S, x: S::V) -> S::V {
    // With the upper tail Q(a) = 1 - Phi(a), x Phi(x) = max(x, 0) - |x| Q(|x|) for either sign. No
    // digits cancel in that, and log2 Q is smooth: this is its polynomial on 0 to 8 for which the
    // greatest error of |x| Q(|x|) is least (2e-9). Beyond 8, |x| Q(|x|) is below 1e-14: as there.
    const LOG2_Q: [f32; 10] = [
        -0.999_999_7,
        -1.151_11,
        -0.459_187_48,
        -0.052_527_79,
        0.007_069_701_3,
        -0.000_105_240_564,
        -0.000_222_228_93,
        5.624_026_7e-5,
        -6.530_435e-6,
        3.106_818_3e-7,
    ];
    let size = simd.min(simd.splat(8.0), simd.abs(x));
    let tail = exp2(simd, polynomial(simd, size, &LOG2_Q));
    simd.fnma(size, tail, simd.max(simd.splat(0.0), x))
}

/// `x / (1 + exp(-t))`: `x` times the logistic function of `t`, with a relative error below 5e-7.
#[inline(always)]
fn gated<S: Simd>(simd: S, x: S::V, t: S::V) -> S::V {
    let grown = exp(simd, simd.sub(simd.splat(0.0), t));
    simd.div(x, simd.add(simd.splat(1.0), grown))
}

/// GELU's approximation by tanh. Since `(1 + tanh(u)) / 2` is the logistic function of `2 u`, no digits
/// cancel.
#[inline(always)]
fn gelu_tanh<S: Simd>(simd: S, x: S::V) -> S::V {
    // 2 sqrt(2 / pi), and that times 0.044715.
    const LINEAR: f32 = 1.595_769;
    const CUBIC: f32 = 0.071_354_814;
    let slope = simd.fma(simd.splat(CUBIC), simd.mul(x, x), simd.splat(LINEAR));
    gated(simd, x, simd.mul(x, slope))
}

/// `activation(x)`.
#[inline(always)]
pub(super) fn activate<S: Simd>(simd: S, activation: Activation, x: S::V) -> S::V {
    match activation {
        Activation::Identity => x,
        Activation::Gelu => gelu(simd, x),
        Activation::GeluTanh => gelu_tanh(simd, x),
        Activation::Relu => simd.max(simd.splat(0.0), x),
        Activation::Selu => {
            let scale = Activation::SELU_SCALE as f32;
            let below = (Activation::SELU_SCALE * Activation::SELU_ALPHA) as f32;
            // Below 0, e^x - 1 loses digits against x, but none against SELU's range.
            let negative = simd.mul(simd.splat(below), simd.sub(exp(simd, x), simd.splat(1.0)));
            let positive = simd.mul(simd.splat(scale), x);
            simd.if_less(x, simd.splat(0.0), negative, positive)
        }
        Activation::Silu => gated(simd, x, x),
    }
}

#[cfg(test)]
mod tests {
    use candle_core::cpu::erf::erf_f64;

    use super::super::Isa;
    use super::super::isa::Task;
    use super::*;

    enum Function {
        Exp,
        Exp2,
        Activation(Activation),
    }

    /// The function's values at `x`.
    struct Values<'a>(Function, &'a [f32]);

    impl Task for Values<'_> {
        type Output = Vec<f32>;

        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> Vec<f32> {
            let mut values = vec![0.0; self.1.len()];
            for (x, y) in self.1.chunks(S::LANES).zip(values.chunks_mut(S::LANES)) {
                // SAFETY: both are as long as said.
                unsafe {
                    let v = simd.load_up_to(x.as_ptr(), x.len());
                    let v = match self.0 {
                        Function::Exp => exp(simd, v),
                        Function::Exp2 => exp2(simd, v),
                        Function::Activation(activation) => activate(simd, activation, v),
                    };
                    simd.store_up_to(y.as_mut_ptr(), y.len(), v);
                }
            }
            values
        }
    }

    /// Numbers from `-end` to `end`.
    fn sweep(end: f32) -> Vec<f32> {
        let steps = 40_001;
        (0..=2 * steps)
            .map(|i| (i - steps) as f32 / steps as f32 * end)
            .collect()
    }

    #[test]
    fn exponentials_are_right_to_three_units() {
        let (x, y) = (sweep(87.0), sweep(124.0));
        for isa in Isa::available() {
            for (x, got) in x.iter().zip(isa.run(Values(Function::Exp, &x))) {
                let want = f64::from(*x).exp();
                assert!((f64::from(got) / want - 1.0).abs() < 2e-7, "{isa} exp {x}");
            }
            for (y, got) in y.iter().zip(isa.run(Values(Function::Exp2, &y))) {
                let want = f64::from(*y).exp2();
                assert!((f64::from(got) / want - 1.0).abs() < 2e-7, "{isa} exp2 {y}");
            }
        }
    }

    #[test]
    fn exponentials_beyond_f32_are_infinite_or_zero() {
        let x = [f32::INFINITY, 100.0, -110.0, f32::NEG_INFINITY, f32::NAN];
        for isa in Isa::available() {
            let y = isa.run(Values(Function::Exp, &x));
            assert_eq!(y[..4], [f32::INFINITY, f32::INFINITY, 0.0, 0.0], "{isa}");
            assert!(y[4].is_nan());
            let y = isa.run(Values(Function::Exp2, &[f32::NEG_INFINITY, 0.0, f32::NAN]));
            assert!(y[0] < 1e-37 && y[1] == 1.0 && y[2].is_nan(), "{isa} {y:?}");
        }
    }

    #[test]
    fn gelu_is_right_to_a_unit_of_its_result() {
        for x in [sweep(0.01), sweep(10.0), sweep(1e4)] {
            for isa in Isa::available() {
                for (x, got) in x
                    .iter()
                    .zip(isa.run(Values(Function::Activation(Activation::Gelu), &x)))
                {
                    let wide = f64::from(*x);
                    let want = 0.5 * wide * (1.0 + erf_f64(wide * std::f64::consts::FRAC_1_SQRT_2));
                    let bound = 5e-8 + 1.2e-7 * want.abs();
                    assert!(
                        (f64::from(got) - want).abs() < bound,
                        "{isa} {x}: {got} {want}"
                    );
                }
            }
        }
    }

    #[test]
    fn gated_activations_keep_their_digits_below_zero() {
        // `x` times the logistic function of these.
        let gelu_tanh =
            |x: f64| 2.0 * (2.0 / std::f64::consts::PI).sqrt() * (x + 0.044715 * x.powi(3));
        let gates = [
            (Activation::Silu, (|x| x) as fn(f64) -> f64, 80.0),
            (Activation::GeluTanh, gelu_tanh, 6.0),
        ];
        for (activation, gate, end) in gates {
            for x in [sweep(0.01), sweep(end)] {
                for isa in Isa::available() {
                    for (x, got) in x
                        .iter()
                        .zip(isa.run(Values(Function::Activation(activation), &x)))
                    {
                        let t = gate((*x).into());
                        let want = f64::from(*x) / (1.0 + (-t).exp());
                        // The exponent itself is a rounded number.
                        let bound = (5e-7 + 2e-7 * t.abs()) * want.abs();
                        let error = (f64::from(got) - want).abs();
                        assert!(error <= bound, "{isa} {activation:?} {x}: {got} {want}");
                    }
                }
            }
        }
    }

    /// Numbers of all sizes and signs: every so many bit patterns, and the ends.
    fn of_all_sizes() -> Vec<f32> {
        let ends = [
            0.0,
            -0.0,
            f32::MAX,
            f32::MIN,
            f32::MIN_POSITIVE,
            1e-45,
            -1e-45,
        ];
        let patterns = (0..=u32::MAX).step_by(30_011).map(f32::from_bits);
        patterns.filter(|x| x.is_finite()).chain(ends).collect()
    }

    #[test]
    fn activations_are_right_over_all_of_f32() {
        let x = of_all_sizes();
        let logistic = |t: f64| 1.0 / (1.0 + (-t).exp());
        let functions = [
            (Activation::Identity, (|x| x) as fn(f64) -> f64),
            (Activation::Relu, |x| x.max(0.0)),
            (Activation::Gelu, |x| {
                x * 0.5 * (1.0 + erf_f64(x.clamp(-40.0, 40.0) / 2_f64.sqrt()))
            }),
            (Activation::Selu, |x| match x > 0.0 {
                true => Activation::SELU_SCALE * x,
                false => Activation::SELU_SCALE * Activation::SELU_ALPHA * x.exp_m1(),
            }),
        ];
        let gated = [Activation::Silu, Activation::GeluTanh].map(|activation| {
            let slope = |x: f64| match activation {
                Activation::Silu => 1.0,
                _ => 2.0 * (2.0 / std::f64::consts::PI).sqrt() * (1.0 + 0.044715 * x * x),
            };
            let of = |&x: &f32| f64::from(x) * logistic(f64::from(x) * slope(x.into()));
            (activation, x.iter().map(of).collect::<Vec<f64>>())
        });
        let of = |(activation, function): (_, fn(f64) -> f64)| {
            (activation, x.iter().map(|&x| function(x.into())).collect())
        };
        for (activation, want) in functions.map(of).into_iter().chain(gated) {
            for isa in Isa::available() {
                let got = isa.run(Values(Function::Activation(activation), &x));
                for ((x, got), want) in x.iter().zip(got).zip(&want) {
                    let bound = 2e-7 + 6e-7 * want.abs();
                    let error = (f64::from(got) - want).abs();
                    let close = error <= bound || got == *want as f32;
                    assert!(close, "{isa} {activation:?} {x:e}: {got:e} {want:e}");
                }
            }
        }
    }

    #[test]
    fn exponentials_are_right_down_to_the_smallest_numbers() {
        let x: Vec<f32> = (0..60_000).map(|i| i as f32 * 3.3e-3 - 109.0).collect();
        for isa in Isa::available() {
            for (x, got) in x.iter().zip(isa.run(Values(Function::Exp, &x))) {
                let want = f64::from(*x).exp();
                // Smaller than normal ones, numbers are multiples of 1.4e-45.
                let bound = 3e-7 * want + 3e-45;
                let error = (f64::from(got) - want).abs();
                let beyond = want > 3.3e38 && got == f32::INFINITY;
                assert!(error <= bound || beyond, "{isa} exp {x}: {got:e} {want:e}");
            }
            let low = [-125.0, -126.0, -200.0, f32::MIN];
            for y in isa.run(Values(Function::Exp2, &low)) {
                assert_eq!(y, (-125_f32).exp2(), "{isa}");
            }
        }
    }
}
