//! The operations of vectors.

use half::{bf16, f16};

use super::super::Isa;
use super::super::isa::Task;
use super::super::simd::{MAX_LANES, Simd, Stored};
use super::numbers;

/// Numbers of all kinds.
fn kinds() -> Vec<f32> {
    let mut all = vec![
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        1.5,
        2.5,
        -2.5,
        8_388_609.0,
        4_194_303.5,
        1e30,
        -1e30,
        f32::MIN_POSITIVE,
        1e-40,
        f32::INFINITY,
        f32::NEG_INFINITY,
    ];
    all.extend(numbers(1, 16).iter().map(|x| 100.0 * x));
    all
}

/// What becomes of each number and the one `MAX_LANES` further on.
struct Arithmetic(Vec<f32>);

impl Task for Arithmetic {
    type Output = Vec<(&'static str, Vec<f32>)>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        let mut results: Self::Output = Vec::new();
        let mut of = |name, function: &dyn Fn(S::V, S::V) -> S::V| {
            let mut values = vec![0.0; MAX_LANES];
            for at in (0..MAX_LANES).step_by(S::LANES) {
                // SAFETY: there are twice as many numbers, and as many results.
                unsafe {
                    let a = simd.load(self.0.as_ptr().add(at));
                    let b = simd.load(self.0.as_ptr().add(MAX_LANES + at));
                    simd.store(values.as_mut_ptr().add(at), function(a, b));
                }
            }
            results.push((name, values));
        };
        of("add", &|a, b| simd.add(a, b));
        of("sub", &|a, b| simd.sub(a, b));
        of("mul", &|a, b| simd.mul(a, b));
        of("div", &|a, b| simd.div(a, b));
        of("max", &|a, b| simd.max(a, b));
        of("min", &|a, b| simd.min(a, b));
        of("abs", &|a, _| simd.abs(a));
        of("round", &|a, _| simd.round(a));
        of("if_less", &|a, b| {
            simd.if_less(a, b, simd.splat(7.0), simd.splat(9.0))
        });
        results
    }
}

#[test]
fn arithmetic_is_that_of_numbers() {
    let all = kinds();
    for swapped in [false, true] {
        let mut x = all.clone();
        if swapped {
            x.rotate_left(MAX_LANES);
        }
        let (a, b) = x.split_at(MAX_LANES);
        let want = |name: &str, a: f32, b: f32| match name {
            "add" => a + b,
            "sub" => a - b,
            "mul" => a * b,
            "div" => a / b,
            "max" => a.max(b),
            "min" => a.min(b),
            "abs" => a.abs(),
            "round" => a.round_ties_even(),
            _ if a < b => 7.0,
            _ => 9.0,
        };
        for isa in Isa::available() {
            for (name, got) in isa.run(Arithmetic(x.clone())) {
                for (i, got) in got.into_iter().enumerate() {
                    let want = want(name, a[i], b[i]);
                    assert!(got == want, "{isa} {name} {} {}: {got}", a[i], b[i]);
                }
            }
        }
    }
}

#[test]
fn nan_is_the_second_of_two() {
    let mut x = vec![f32::NAN; MAX_LANES];
    x.extend([3.0; MAX_LANES]);
    for isa in Isa::available() {
        for swapped in [false, true] {
            let mut x = x.clone();
            if swapped {
                x.rotate_left(MAX_LANES);
            }
            for (name, got) in isa.run(Arithmetic(x)) {
                match name {
                    // The second one is a number if these are swapped back.
                    "max" | "min" => assert!(got.iter().all(|x| x.is_nan() == swapped), "{isa}"),
                    "if_less" => assert!(got.iter().all(|&x| x == 9.0), "{isa}"),
                    "abs" | "round" => assert!(got.iter().all(|x| x.is_nan() != swapped), "{isa}"),
                    _ => assert!(got.iter().all(|x| x.is_nan()), "{isa} {name}"),
                }
            }
        }
    }
}

/// Products that are added or subtracted, sums and greatest numbers, and scaling by powers of two.
struct Combined;

impl Task for Combined {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let x: Vec<f32> = (0..S::LANES).map(|i| i as f32 - 5.0).collect();
        // SAFETY: there are as many numbers as lanes.
        let v = unsafe { simd.load(x.as_ptr()) };
        assert_eq!(simd.sum(v), x.iter().sum::<f32>());
        assert_eq!(simd.greatest(v), S::LANES as f32 - 6.0);
        let less = simd.sub(simd.splat(0.0), v);
        assert_eq!(simd.greatest(less), 5.0);
        let of = |v: S::V| {
            let mut all = vec![0.0; S::LANES];
            // SAFETY: as above.
            unsafe { simd.store(all.as_mut_ptr(), v) };
            all
        };
        let squares = of(simd.fma(v, v, simd.splat(0.5)));
        let negative = of(simd.fnma(v, v, simd.splat(0.5)));
        for (i, &x) in x.iter().enumerate() {
            assert_eq!((squares[i], negative[i]), (x * x + 0.5, 0.5 - x * x));
        }
        for n in [-252.0_f32, -149.0, -126.0, -1.0, 0.0, 3.0, 127.0, 254.0] {
            for a in [1.0_f32, -1.5, 1e-30, 3e-39, f32::INFINITY, 0.0] {
                let got = of(simd.scale(simd.splat(a), simd.splat(n)))[0];
                let want = (f64::from(a) * power_of_two(n)) as f32;
                // Twice rounded, if it is smaller than normal numbers are.
                let close = (f64::from(got) - f64::from(want)).abs() <= 1.5e-45;
                assert!(got == want || close, "{a} 2^{n}: {got} {want}");
            }
        }
        for n in [-120.0_f32, -1.0, 0.0, 3.0, 126.0] {
            let got = of(simd.scale_normal(simd.splat(1.25), simd.splat(n)))[0];
            assert_eq!(got, (1.25 * power_of_two(n)) as f32);
        }
    }
}

/// Exactly, which `exp2` need not be.
fn power_of_two(n: f32) -> f64 {
    f64::from_bits(((1023 + n as i64) as u64) << 52)
}

#[test]
fn combined_operations_are_exact() {
    for isa in Isa::available() {
        isa.run(Combined);
    }
}

/// Parts of vectors of `T`, and vectors that are turned.
struct Memory<T>(fn(f32) -> T);

impl<T: Stored> Task for Memory<T> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for count in 0..=S::LANES {
            // No more than that in memory.
            let from: Vec<T> = (0..count).map(|i| (self.0)(i as f32 - 2.5)).collect();
            let mut to = vec![-9.0; count];
            let mut all = vec![-9.0; S::LANES];
            // SAFETY: there are `count` numbers in each, and all lanes in the last.
            unsafe {
                let v = T::load_up_to(simd, from.as_ptr(), count);
                simd.store_up_to(to.as_mut_ptr(), count, v);
                simd.store(all.as_mut_ptr(), v);
            }
            for (i, &x) in all.iter().enumerate() {
                assert_eq!(x, if i < count { i as f32 - 2.5 } else { 0.0 });
            }
            assert_eq!(to, all[..count]);
        }
        let mut rows = [simd.splat(0.0); MAX_LANES];
        for (i, row) in rows.iter_mut().enumerate().take(S::LANES) {
            let line: Vec<f32> = (0..S::LANES).map(|j| (100 * i + j) as f32).collect();
            // SAFETY: there are as many numbers as lanes.
            *row = unsafe { simd.load(line.as_ptr()) };
        }
        simd.transpose(&mut rows);
        for (j, &row) in rows.iter().enumerate().take(S::LANES) {
            let mut line = vec![0.0; S::LANES];
            // SAFETY: as above.
            unsafe { simd.store(line.as_mut_ptr(), row) };
            for (i, x) in line.into_iter().enumerate() {
                assert_eq!(x, (100 * i + j) as f32);
            }
        }
    }
}

#[test]
fn parts_of_vectors_touch_nothing_else() {
    for isa in Isa::available() {
        isa.run(Memory(|x| x));
        isa.run(Memory(f16::from_f32));
        isa.run(Memory(bf16::from_f32));
    }
}

/// Numbers of half precision, widened.
struct Widened<T>(Vec<T>);

impl<T: Stored> Task for Widened<T> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<f32> {
        let mut wide = vec![0.0; self.0.len()];
        for (from, to) in self.0.chunks(S::LANES).zip(wide.chunks_mut(S::LANES)) {
            // SAFETY: both are as long as said.
            unsafe {
                let v = T::load_up_to(simd, from.as_ptr(), from.len());
                simd.store_up_to(to.as_mut_ptr(), to.len(), v);
            }
        }
        wide
    }
}

#[test]
fn all_halves_are_widened_exactly() {
    let step = if cfg!(miri) { 257 } else { 1 };
    let bits: Vec<u16> = (0..=u16::MAX).step_by(step).collect();
    for isa in Isa::available() {
        let half: Vec<f16> = bits.iter().map(|&bits| f16::from_bits(bits)).collect();
        for (half, got) in half.iter().zip(isa.run(Widened(half.clone()))) {
            let want = half.to_f32();
            assert!(got == want || got.is_nan() && want.is_nan(), "{isa} {half}");
        }
        let half: Vec<bf16> = bits.iter().map(|&bits| bf16::from_bits(bits)).collect();
        for (half, got) in half.iter().zip(isa.run(Widened(half.clone()))) {
            let want = half.to_f32();
            assert!(got == want || got.is_nan() && want.is_nan(), "{isa} {half}");
        }
    }
}
