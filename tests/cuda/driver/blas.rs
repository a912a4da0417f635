//! cuBLAS, for matrices that lie column by column.

use crate::number::{F16, Half};
use crate::product::{Kind, Matrices, Product, Rounded};
use std::ffi::{c_int, c_longlong, c_uint, c_void};

const SUCCESS: c_int = 0;
const INVALID_VALUE: c_int = 7;
const NOT_SUPPORTED: c_int = 15;

/// A factor's address, its type, and the distances of its columns and matrices.
type Given = (*const c_void, c_uint, c_int, c_longlong);

/// `alpha` and `beta` are of the type that is computed in.
#[expect(clippy::too_many_arguments, reason = "they are cuBLAS's")]
fn multiply(
    operations: [c_uint; 2],
    sizes: [c_int; 3],
    alpha: *const c_void,
    a: Given,
    b: Given,
    beta: *const c_void,
    c: Given,
    count: c_int,
    compute: c_uint,
) -> c_int {
    if crate::is_idle() {
        return SUCCESS;
    }
    let scale = |at: *const c_void| unsafe {
        match compute {
            64 | 65 => f64::from(F16(at.cast::<u16>().read()).value()),
            70 | 71 => at.cast::<f64>().read(),
            _ => f64::from(at.cast::<f32>().read()),
        }
    };
    let matrices = |(address, kind, leading, stride): Given, operation: c_uint| {
        Some(Matrices {
            address: address as u64,
            kind: Kind::of(kind)?,
            leading: usize::try_from(leading).ok()?,
            stride: usize::try_from(stride).ok()?,
            transposed: operation != 0,
        })
    };
    let size = |size: c_int| usize::try_from(size).ok();
    let product = || {
        Some(Product {
            rows: size(sizes[0])?,
            columns: size(sizes[1])?,
            depth: size(sizes[2])?,
            count: size(count)?,
            a: matrices(a, operations[0])?,
            b: matrices(b, operations[1])?,
            c: matrices(c, 0)?,
            alpha: scale(alpha),
            beta: scale(beta),
            rounded: match compute {
                74 => Rounded::F16,
                75 => Rounded::Bf16,
                77 => Rounded::Tf32,
                _ => Rounded::No,
            },
        })
    };
    let Some(product) = product() else {
        eprintln!("cuBLAS: sizes {sizes:?} or types cannot be multiplied");
        return INVALID_VALUE;
    };
    let are_there = match compute {
        64 | 65 | 68 | 69 | 74 | 75 | 77 => product.run::<f32>(),
        70 | 71 => product.run::<f64>(),
        _ => {
            eprintln!("cuBLAS: computing in the type {compute} is not known");
            return NOT_SUPPORTED;
        }
    };
    if are_there {
        return SUCCESS;
    }
    eprintln!("cuBLAS: {count} matrices of the sizes {sizes:?} are not in the GPU's memory");
    INVALID_VALUE
}

/// Products of numbers of one type: names, types, CUDA's numbers of the type and of computing in it.
macro_rules! products {
    ($($name:ident, $batched:ident, $type:ty, $kind:expr, $compute:expr;)*) => {
        $(
            #[unsafe(no_mangle)]
            pub(crate) extern "C" fn $name(
                _handle: u64, transa: c_uint, transb: c_uint, m: c_int, n: c_int, k: c_int, alpha: *const $type,
                a: *const c_void, lda: c_int, b: *const c_void, ldb: c_int, beta: *const $type, c: *const c_void, ldc: c_int,
            ) -> c_int {
                let [a, b, c] = [(a, lda), (b, ldb), (c, ldc)].map(|(at, leading)| (at, $kind, leading, 0));
                multiply([transa, transb], [m, n, k], alpha.cast(), a, b, beta.cast(), c, 1, $compute)
            }

            #[unsafe(no_mangle)]
            pub(crate) extern "C" fn $batched(
                _handle: u64, transa: c_uint, transb: c_uint, m: c_int, n: c_int, k: c_int, alpha: *const $type,
                a: *const c_void, lda: c_int, stride_a: c_longlong, b: *const c_void, ldb: c_int, stride_b: c_longlong,
                beta: *const $type, c: *const c_void, ldc: c_int, stride_c: c_longlong, count: c_int,
            ) -> c_int {
                let [a, b, c] = [(a, lda, stride_a), (b, ldb, stride_b), (c, ldc, stride_c)]
                    .map(|(at, leading, stride)| (at, $kind, leading, stride));
                multiply([transa, transb], [m, n, k], alpha.cast(), a, b, beta.cast(), c, count, $compute)
            }
        )*
    };
}

products! {
    cublasSgemm_v2, cublasSgemmStridedBatched, f32, 0, 68;
    cublasDgemm_v2, cublasDgemmStridedBatched, f64, 1, 70;
    cublasHgemm, cublasHgemmStridedBatched, u16, 2, 64;
}

#[unsafe(no_mangle)]
#[rustfmt::skip]
extern "C" fn cublasGemmEx(
    _handle: u64, transa: c_uint, transb: c_uint, m: c_int, n: c_int, k: c_int, alpha: *const c_void,
    a: *const c_void, a_type: c_uint, lda: c_int, b: *const c_void, b_type: c_uint, ldb: c_int,
    beta: *const c_void, c: *const c_void, c_type: c_uint, ldc: c_int, compute: c_uint, _algorithm: c_int,
) -> c_int {
    let [a, b, c] = [(a, a_type, lda, 0), (b, b_type, ldb, 0), (c, c_type, ldc, 0)];
    multiply([transa, transb], [m, n, k], alpha, a, b, beta, c, 1, compute)
}

#[unsafe(no_mangle)]
#[rustfmt::skip]
extern "C" fn cublasGemmStridedBatchedEx(
    _handle: u64, transa: c_uint, transb: c_uint, m: c_int, n: c_int, k: c_int, alpha: *const c_void,
    a: *const c_void, a_type: c_uint, lda: c_int, stride_a: c_longlong, b: *const c_void, b_type: c_uint, ldb: c_int,
    stride_b: c_longlong, beta: *const c_void, c: *const c_void, c_type: c_uint, ldc: c_int, stride_c: c_longlong,
    count: c_int, compute: c_uint, _algorithm: c_int,
) -> c_int {
    let (a, b, c) = ((a, a_type, lda, stride_a), (b, b_type, ldb, stride_b), (c, c_type, ldc, stride_c));
    multiply([transa, transb], [m, n, k], alpha, a, b, beta, c, count, compute)
}
