use half::bf16;
use proptest::prelude::*;

use super::*;
use crate::nn::cpu::Isa;

/// Numbers between -1 and 1 that look random.
fn noise(len: usize, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    std::iter::repeat_with(next).take(len).collect()
}

/// A product and what belongs to it. Rows of all matrices are `extra` further apart than needed.
#[derive(Clone, Debug)]
struct Case {
    rows: usize,
    columns: usize,
    depth: usize,
    extra: usize,
    /// Whether the second factor's transpose is given.
    transposed: bool,
    /// Whether both factors are rounded to bf16; sizes are then even, the second factor is transposed.
    pairs: bool,
    accumulate: bool,
    bias: bool,
    activation: Activation,
    residual: bool,
}

fn size() -> impl Strategy<Value = usize> {
    prop_oneof![Just(1), Just(3), Just(17), 1_usize..70]
}

fn cases() -> impl Strategy<Value = Case> {
    let depth = prop_oneof![4 => size(), 1 => Just(0), 1 => Just(DEPTH), 1 => Just(2 * DEPTH + 5)];
    let activation = prop::sample::select(vec![
        Activation::Identity,
        Activation::Gelu,
        Activation::GeluTanh,
        Activation::Relu,
        Activation::Selu,
        Activation::Silu,
    ]);
    let flags = any::<[bool; 5]>();
    (size(), size(), depth, 0_usize..3, flags, activation).prop_map(
        |(
            rows,
            columns,
            depth,
            extra,
            [transposed, pairs, accumulate, bias, residual],
            activation,
        )| {
            let even = |size: usize| size << usize::from(pairs);
            Case {
                rows,
                columns,
                depth: even(depth),
                extra: even(extra),
                transposed: transposed || pairs,
                pairs,
                accumulate,
                bias,
                activation,
                residual,
            }
        },
    )
}

fn activated(activation: Activation, x: f64) -> f64 {
    match activation {
        Activation::Identity => x,
        Activation::Gelu => x * 0.5 * (1.0 + candle_core::cpu::erf::erf_f64(x / 2_f64.sqrt())),
        Activation::GeluTanh => {
            let u = (2.0 / std::f64::consts::PI).sqrt() * (x + 0.044715 * x.powi(3));
            0.5 * x * (1.0 + u.tanh())
        }
        Activation::Relu => x.max(0.0),
        Activation::Selu if x > 0.0 => Activation::SELU_SCALE * x,
        Activation::Selu => Activation::SELU_SCALE * Activation::SELU_ALPHA * x.exp_m1(),
        Activation::Silu => x / (1.0 + (-x).exp()),
    }
}

/// Checks each way of multiplying against sums in f64, for one instruction set.
fn check(isa: Isa, case: &Case) -> std::result::Result<(), TestCaseError> {
    let Case {
        rows,
        columns,
        depth,
        extra,
        ..
    } = *case;
    let (b_rows, b_columns) = match case.transposed {
        true => (columns, depth),
        false => (depth, columns),
    };
    let array = |rows: usize, columns: usize, seed| noise(rows * (columns + extra), seed);
    let (mut a, mut b) = (array(rows, depth, 1), array(b_rows, b_columns, 2));
    let halves: Vec<bf16> = b.iter().map(|&x| bf16::from_f32(x)).collect();
    let a_given = a.clone();
    if case.pairs {
        for x in a.iter_mut().chain(&mut b) {
            *x = bf16::from_f32(*x).to_f32();
        }
    }
    let (old, residual) = (array(rows, columns, 3), array(rows, columns, 4));
    let bias = noise(columns, 5);
    let matrix = |data, rows, columns| Matrix::new(data, rows, columns, columns + extra).unwrap();
    let factor = match case.transposed {
        true if case.pairs => {
            let halves = Matrix::new(&halves, b_rows, b_columns, b_columns + extra).unwrap();
            Factor::Bf16Pairs(halves.pairs().unwrap())
        }
        true => Factor::Transposed(matrix(&b, b_rows, b_columns)),
        false => Factor::Plain(matrix(&b, b_rows, b_columns)),
    };
    let epilogue = Epilogue {
        accumulate: case.accumulate,
        bias: case.bias.then_some(&bias[..]),
        activation: case.activation,
        residual: case.residual.then(|| matrix(&residual, rows, columns)),
    };
    let a_matrix = matrix(&a_given, rows, depth);
    let (mut serial, mut parallel) = (old.clone(), old.clone());
    let c = MatrixMut::new(&mut serial, rows, columns, columns + extra).unwrap();
    gemm_serial(a_matrix, &PackedFactor::pack_for(isa, factor), c, &epilogue).unwrap();
    // SAFETY: the array has these rows and columns.
    unsafe {
        let c = parallel.as_mut_ptr();
        gemm_into(isa, a_matrix, factor, c, columns + extra, &epilogue).unwrap();
    }
    prop_assert_eq!(&serial, &parallel);
    for i in 0..rows {
        for j in 0..columns + extra {
            let at = i * (columns + extra) + j;
            if j >= columns {
                prop_assert_eq!(serial[at], old[at], "written beside the matrix");
                continue;
            }
            let (mut want, mut size) = (0.0, 0.0);
            for p in 0..depth {
                let b = match case.transposed {
                    true => b[j * (depth + extra) + p],
                    false => b[p * (columns + extra) + j],
                };
                let term = f64::from(a[i * (depth + extra) + p]) * f64::from(b);
                (want, size) = (want + term, size + term.abs());
            }
            if case.accumulate {
                want += f64::from(old[at]);
            }
            if case.bias {
                want += f64::from(bias[j]);
            }
            want = activated(case.activation, want);
            if case.residual {
                want += f64::from(residual[at]);
            }
            // Each step of a sum rounds by half a unit in the last place at most, and errors add up
            // like a random walk; activations stretch them by at most SELU's 1.76.
            let bound = 1e-6 + 2e-7 * (1.0 + depth as f64).sqrt() * size;
            let error = (f64::from(serial[at]) - want).abs();
            prop_assert!(error < bound, "{isa} ({i}, {j}): {} {want}", serial[at]);
        }
    }
    Ok(())
}

proptest! {
    #[test]
    fn products_are_those_of_f64(case in cases()) {
        for isa in Isa::available() {
            check(isa, &case)?;
        }
    }
}

#[test]
fn sizes_are_checked() {
    let data = [0.0; 12];
    assert!(Matrix::new(&data, 3, 4, 4).is_ok());
    assert!(Matrix::new(&data, 3, 4, 3).is_err());
    assert!(Matrix::new(&data, 4, 4, 4).is_err());
    assert!(Matrix::new(&data, usize::MAX, 4, usize::MAX).is_err());
    let (a, mut c) = (Matrix::new(&data, 3, 4, 4).unwrap(), [0.0; 9]);
    let mut product = |factor, epilogue: &Epilogue| {
        let serial = PackedFactor::pack(factor)
            .and_then(|packed| gemm_serial(a, &packed, MatrixMut::new(&mut c, 3, 3, 3)?, epilogue));
        let parallel = gemm(
            a,
            factor,
            MatrixMut::new(&mut c, 3, 3, 3).unwrap(),
            epilogue,
        );
        assert_eq!(serial.is_ok(), parallel.is_ok());
        parallel
    };
    let plain = Epilogue::default();
    assert!(product(Factor::Transposed(a), &plain).is_ok());
    assert!(product(Factor::Plain(a), &plain).is_err());
    let bias = Epilogue {
        bias: Some(&data[..2]),
        ..plain
    };
    assert!(product(Factor::Transposed(a), &bias).is_err());
    let residual = Epilogue {
        residual: Some(a),
        ..plain
    };
    assert!(product(Factor::Transposed(a), &residual).is_err());
}

#[test]
fn threads_do_not_change_a_result() {
    let (rows, columns, depth) = (800, 100, 530);
    let (a, b) = (noise(rows * depth, 1), noise(columns * depth, 2));
    let a = Matrix::new(&a, rows, depth, depth).unwrap();
    let b = Factor::Transposed(Matrix::new(&b, columns, depth, depth).unwrap());
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let mut c = vec![0.0; rows * columns];
        let matrix = MatrixMut::new(&mut c, rows, columns, columns).unwrap();
        pool.build()
            .unwrap()
            .install(|| gemm(a, b, matrix, &Epilogue::default()))
            .unwrap();
        c
    };
    let one = with(1);
    assert_eq!(one, with(2));
    assert_eq!(one, with(7));
}
