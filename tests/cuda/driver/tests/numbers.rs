//! Numbers: roundings, conversions, bits, products.

use super::first;
use crate::memory;
use crate::number::{Bf16, F16, Half, Round, add_f64, fma_f32};

fn float(body: &str) -> f32 {
    f32::from_bits(first(&format!("{body}\nmov.b32 %r1, %f1;")))
}

#[test]
fn halves_are_what_they_were() {
    for bits in 0..=u16::MAX {
        let (x, y) = (F16(bits), Bf16(bits));
        if x.value().is_nan() {
            assert_eq!(F16::near(x.value()).0, 0x7fff);
        } else {
            assert_eq!(F16::near(x.value()).0, bits);
            assert_eq!(F16::of(x.value().into(), Round::Up).0, bits);
        }
        if !y.value().is_nan() {
            assert_eq!(Bf16::near(y.value()).0, bits);
            assert_eq!(Bf16::of(y.value().into(), Round::Down).0, bits);
        }
    }
    assert_eq!(F16(0x3c01).value(), 1.0 + 1.0 / 1024.0);
    assert_eq!(F16(0x0001).value(), 2.0_f32.powi(-24));
}

#[test]
fn halves_are_rounded_once() {
    // Halfway between two is the even one.
    assert_eq!(F16::near(1.0 + 1.0 / 2048.0).0, 0x3c00);
    assert_eq!(F16::near(1.0 + 3.0 / 2048.0).0, 0x3c02);
    assert_eq!(F16::near(65519.0).0, 0x7bff);
    assert_eq!(F16::near(65520.0).0, 0x7c00);
    assert_eq!(F16::of(1.0 + 1e-9, Round::Up).0, 0x3c01);
    assert_eq!(F16::of(-1.0 - 1e-9, Round::Zero).0, 0xbc00);
    assert_eq!(F16::of(1e6, Round::Zero).0, 0x7bff);
    assert_eq!(F16::of(2.0_f64.powi(-26), Round::Up).0, 1);
    assert_eq!(Bf16::of(1.0 + 1e-9, Round::Up).0, 0x3f81);
    // 1 + 2^-8 lies halfway; what is added is too little for an f32.
    let tiny = Bf16::near(2.0_f32.powi(-60));
    let half = Bf16::near(2.0_f32.powi(-8));
    let one = Bf16::near(1.0);
    assert_eq!(one.fma(one, half).0, 0x3f80);
    assert_eq!(
        Bf16::near_odd(crate::number::odd_sum(
            1.0 + 2.0_f64.powi(-8),
            tiny.value().into()
        ))
        .0,
        0x3f81
    );
}

#[test]
fn sums_are_rounded_as_is_said() {
    let (a, b, c) = (1.0 + f32::EPSILON, 1.0 + f32::EPSILON, 2.0_f32.powi(-60));
    // The product is 1 + 2e + e^2.
    assert_eq!(fma_f32(a, b, c, Round::Nearest), 1.0 + 2.0 * f32::EPSILON);
    assert_eq!(fma_f32(a, b, c, Round::Up), 1.0 + 3.0 * f32::EPSILON);
    assert_eq!(fma_f32(a, b, c, Round::Down), 1.0 + 2.0 * f32::EPSILON);
    assert_eq!(fma_f32(-a, b, c, Round::Zero), -1.0 - 2.0 * f32::EPSILON);
    assert_eq!(
        float("add.rp.f32 %f1, 0f3F800000, 0f00000001;"),
        1.0 + f32::EPSILON
    );
    assert_eq!(
        float("add.rm.f32 %f1, 0f3F800000, 0f80000001;"),
        1.0 - f32::EPSILON / 2.0
    );
    assert_eq!(add_f64(1.0, -1e-30, Round::Zero), 1.0 - f64::EPSILON / 2.0);
    assert_eq!(add_f64(-1.0, -1e-30, Round::Zero), -1.0);
    assert_eq!(add_f64(1.0, 1e-30, Round::Up), 1.0 + f64::EPSILON);
    assert_eq!(
        float("fma.rn.f32 %f1, 0f3F800001, 0f3F800001, 0fBF800002;"),
        f32::EPSILON * f32::EPSILON
    );
    assert_eq!(float("add.sat.f32 %f1, 0f3F800000, 0f3F800000;"), 1.0);
    assert_eq!(float("mul.ftz.f32 %f1, 0f00800000, 0f3F000000;"), 0.0);
    assert_eq!(float("max.f32 %f1, 0f7FFFFFFF, 0fC0000000;"), -2.0);
    assert!(float("max.NaN.f32 %f1, 0f7FFFFFFF, 0fC0000000;").is_nan());
}

#[test]
fn numbers_become_others() {
    assert_eq!(first("cvt.rni.s32.f32 %r1, 0f40200000;"), 2);
    assert_eq!(first("cvt.rpi.s32.f32 %r1, 0fC0200000;"), -2_i32 as u32);
    assert_eq!(first("cvt.rzi.u32.f32 %r1, 0fC0200000;"), 0);
    assert_eq!(first("cvt.rzi.s32.f32 %r1, 0f7F800000;"), i32::MAX as u32);
    assert_eq!(first("cvt.rzi.s32.f32 %r1, 0f7FFFFFFF;"), 0);
    assert_eq!(first("mov.u32 %r2, 0x1ff;\ncvt.s32.s8 %r1, %r2;"), u32::MAX);
    assert_eq!(first("mov.u32 %r2, 300;\ncvt.sat.u8.u32 %r1, %r2;"), 255);
    assert_eq!(
        first("mov.u64 %d1, -5;\ncvt.u32.u64 %r1, %d1;"),
        -5_i32 as u32
    );
    assert_eq!(
        float("mov.u32 %r2, 0x1000001;\ncvt.rp.f32.u32 %f1, %r2;"),
        16_777_218.0
    );
    assert_eq!(
        float("mov.u32 %r2, 0x1000001;\ncvt.rn.f32.u32 %f1, %r2;"),
        16_777_216.0
    );
    assert_eq!(float("cvt.rmi.f32.f32 %f1, 0fBFC00000;"), -2.0);
    // The first number is the upper half.
    assert_eq!(
        first("cvt.rn.f16x2.f32 %r1, 0f40000000, 0f3F800000;"),
        0x4000_3c00
    );
    assert_eq!(
        first("cvt.rn.bf16x2.f32 %r1, 0f40000000, 0f3F800000;"),
        0x4000_3f80
    );
}

#[test]
fn bits_are_where_they_belong() {
    assert_eq!(
        first("mov.u32 %r2, 0x80000000;\nshr.s32 %r1, %r2, 40;"),
        u32::MAX
    );
    assert_eq!(first("mov.u32 %r2, 0x80000000;\nshr.u32 %r1, %r2, 32;"), 0);
    assert_eq!(
        first(
            "mov.u32 %r2, 0x12345678;\nmov.u32 %r3, 0x9abcdef0;\nshf.l.wrap.b32 %r1, %r2, %r3, 8;"
        ),
        0xbcde_f012
    );
    assert_eq!(
        first(
            "mov.u32 %r2, 0x12345678;\nmov.u32 %r3, 0x9abcdef0;\nprmt.b32 %r1, %r2, %r3, 0xc061;"
        ),
        0xff78_bc56
    );
    assert_eq!(
        first(
            "mov.u32 %r2, 0xf0;\nmov.u32 %r3, 0xcc;\nmov.u32 %r4, 0xaa;\nlop3.b32 %r1, %r2, %r3, %r4, 0x96;"
        ),
        0x96
    );
    assert_eq!(
        first("mov.u32 %r2, 0x00f00000;\nbfe.s32 %r1, %r2, 20, 4;"),
        u32::MAX
    );
    assert_eq!(
        first("mov.u32 %r2, 5;\nmov.u32 %r3, -1;\nbfi.b32 %r1, %r2, %r3, 4, 8;"),
        0xffff_f05f
    );
    assert_eq!(first("mov.u32 %r2, 0x00f00000;\nbfind.u32 %r1, %r2;"), 23);
    assert_eq!(
        first("mov.u32 %r2, 0xffffffff;\nadd.cc.u32 %r3, %r2, 1;\naddc.u32 %r1, 5, 0;"),
        6
    );
    assert_eq!(first("mov.u32 %r2, -3;\nmul.hi.s32 %r1, %r2, 5;"), u32::MAX);
    assert_eq!(first("mov.u32 %r2, -3;\nmul.hi.u32 %r1, %r2, 5;"), 4);
    assert_eq!(
        first(
            "setp.lt.f32 %p1|%p2, 0f7FFFFFFF, 0f00000000;\nselp.u32 %r1, 1, 2, %p1;\n@%p2 add.u32 %r1, %r1, 4;"
        ),
        6
    );
    assert_eq!(
        first("setp.ltu.f32 %p1, 0f7FFFFFFF, 0f00000000;\nselp.u32 %r1, 1, 2, %p1;"),
        1
    );
    assert_eq!(
        first("mov.b32 %r2, 0x00020001;\nmov.b32 {%h1, %h2}, %r2;\nmov.b32 %r1, {%h2, %h1};"),
        0x0001_0002
    );
}

/// Memory of the GPU with these numbers.
fn given<T: Copy>(numbers: &[T]) -> u64 {
    let address = memory::allocate(size_of_val(numbers), true).expect("memory");
    unsafe { std::ptr::copy_nonoverlapping(numbers.as_ptr(), address as *mut T, numbers.len()) };
    address
}

#[test]
fn matrices_are_multiplied_column_by_column() {
    // Larger than a part of each side.
    let (m, n, k) = (130, 270, 300);
    let made = |count: usize, seed: usize| -> Vec<f32> {
        (0..count)
            .map(|i| ((i * 7919 + seed) % 17) as f32 - 8.0)
            .collect()
    };
    for (transa, transb) in [(false, false), (true, false), (false, true), (true, true)] {
        let (a, b, c) = (made(m * k, 1), made(k * n, 2), made(m * n, 3));
        let (lda, ldb) = (if transa { k } else { m }, if transb { n } else { k });
        let (on_gpu_a, on_gpu_b, on_gpu_c) = (given(&a), given(&b), given(&c));
        let (alpha, beta) = (0.5_f32, 2.0_f32);
        let status = crate::blas::cublasSgemm_v2(
            0,
            transa.into(),
            transb.into(),
            m as i32,
            n as i32,
            k as i32,
            &alpha,
            on_gpu_a as _,
            lda as i32,
            on_gpu_b as _,
            ldb as i32,
            &beta,
            on_gpu_c as _,
            m as i32,
        );
        assert_eq!(status, 0);
        let result = unsafe { std::slice::from_raw_parts(on_gpu_c as *const f32, m * n) };
        for (row, column) in [(0, 0), (129, 269), (119, 31), (120, 256), (5, 200)] {
            let left = |p: usize| a[if transa { row * lda + p } else { p * lda + row }];
            let right = |p: usize| {
                b[if transb {
                    p * ldb + column
                } else {
                    column * ldb + p
                }]
            };
            let sum: f32 = (0..k).map(|p| left(p) * right(p)).sum();
            assert_eq!(
                result[column * m + row],
                0.5 * sum + 2.0 * c[column * m + row]
            );
        }
    }
}

#[test]
fn matrices_that_are_not_there_are_refused() {
    let (a, one) = (given(&[0.0_f32; 16]), 1.0_f32);
    let multiply = |lda| {
        crate::blas::cublasSgemm_v2(
            0, 0, 0, 4, 4, 4, &one, a as _, lda, a as _, 4, &one, a as _, 4,
        )
    };
    assert_eq!(multiply(4), 0);
    assert_ne!(multiply(5), 0);
    assert_ne!(multiply(3), 0);
}
