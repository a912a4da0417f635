//! Branches, barriers, memory and what threads do together.

use super::{fault, kernel, run, run_with};

#[test]
fn threads_that_part_meet_again() {
    // As many rounds as the thread's number, then both ways of a branch, then all together.
    let out = run(
        "mov.u32 %r1, 0;\nmov.u32 %r2, 0;\n\
         LOOP: setp.ge.u32 %p1, %r2, %r0;\n@%p1 bra DONE;\nadd.u32 %r1, %r1, 3;\nadd.u32 %r2, %r2, 1;\nbra LOOP;\n\
         DONE: and.b32 %r3, %r0, 1;\nsetp.eq.u32 %p2, %r3, 1;\n@%p2 bra ODD;\nadd.u32 %r1, %r1, 100;\nbra.uni END;\n\
         ODD: add.u32 %r1, %r1, 200;\nEND: activemask.b32 %r4;\npopc.b32 %r4, %r4;\nmad.lo.u32 %r1, %r4, 1000, %r1;\n\
         st.global.u32 [%mine], %r1;",
        20,
    );
    let expected: Vec<u32> = (0..20)
        .map(|i| 3 * i + 100 + i % 2 * 100 + 20_000)
        .collect();
    assert_eq!(out, expected);
}

#[test]
fn switches_jump_to_places() {
    let out = run(
        "and.b32 %r1, %r0, 3;\nTABLE: .branchtargets A, B, A, C;\nbrx.idx %r1, TABLE;\n\
         A: mov.u32 %r2, 7;\nbra END;\nB: mov.u32 %r2, 8;\nbra END;\nC: mov.u32 %r2, 9;\nEND: st.global.u32 [%mine], %r2;",
        6,
    );
    assert_eq!(out, [7, 8, 7, 9, 7, 8]);
}

/// Each thread reads what the last but its number wrote.
fn reversal(barrier: &str) -> String {
    kernel(&format!(
        ".shared .align 4 .b8 all[1024];\nmov.u32 %r1, all;\nshl.b32 %r2, %r0, 2;\nadd.u32 %r3, %r1, %r2;\n\
         st.shared.u32 [%r3], %r0;\n{barrier}\nmov.u32 %r4, %ntid.x;\nsub.u32 %r4, %r4, %r0;\nshl.b32 %r4, %r4, 2;\n\
         add.u32 %r4, %r4, %r1;\nld.shared.u32 %r5, [%r4+-4];\nst.global.u32 [%mine], %r5;"
    ))
}

#[test]
fn barriers_make_warps_wait() {
    let expected: Vec<u32> = (0..256).rev().collect();
    for seed in 0..8 {
        let ran = run_with(&reversal("bar.sync 0;"), 256, 0, seed);
        assert_eq!((ran.result, ran.out), (Ok(()), expected.clone()));
    }
    for seed in 0..8 {
        assert_ne!(run_with(&reversal(""), 256, 0, seed).out, expected);
    }
}

#[test]
fn dynamic_shared_memory_comes_after_the_rest() {
    let text = format!(
        ".version 8.0\n.target sm_80\n.extern .shared .align 16 .b8 more[];\n.shared .align 4 .b8 some[20];\n{}",
        kernel(
            "mov.u32 %r1, more;\nmov.u32 %r2, some;\nsub.u32 %r3, %r1, %r2;\nst.shared.u32 [%r1+60], %r3;\n\
             cvta.shared.u64 %d1, %d0;\nld.shared.u32 %r4, [more+60];\nst.global.u32 [%mine], %r4;"
        )
        .split_once(".address_size 64")
        .expect("a header")
        .1
    );
    assert_eq!(run_with(&text, 1, 64, 0).out, [32]);
    let beyond = run_with(&text, 1, 60, 0).result.expect_err("a fault");
    assert!(beyond.contains("shared memory"), "{beyond}");
}

#[test]
fn mistakes_are_said() {
    let has = |message: String, words: &[&str]| {
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    };
    let beyond = "setp.eq.u32 %p1, %r0, 5;\n@%p1 st.global.u32 [%mine+12], %r0;";
    has(
        fault(beyond, 8),
        &[
            "kernel test",
            "thread [5, 0, 0]",
            "nobody's",
            "@%p1 st.global.u32 [%mine+12], %r0;",
        ],
    );
    has(fault("ld.global.u32 %r1, [%mine+2];", 1), &["no multiple"]);
    has(
        fault("frobnicate.b32 %r1, %r0;", 1),
        &["not known", "frobnicate"],
    );
    has(fault("add.strangely.u32 %r1, %r0, %r0;", 1), &["not known"]);
    has(fault("trap;", 1), &["gives up"]);
    has(
        fault("setp.lt.u32 %p1, %r0, 40;\n@%p1 bar.sync 0;", 64),
        &["never come"],
    );
    has(
        fault("setp.lt.u32 %p1, %r0, 32;\n@%p1 bar.sync 0;", 64),
        &["not all threads"],
    );
    has(
        fault("setp.ge.u32 %p1, %r0, 32;\n@%p1 exit;\nbar.sync 0;", 64),
        &["not all threads"],
    );
    has(
        fault("shfl.sync.idx.b32 %r1, %r0, 9, 31, 0xffffffff;", 8),
        &["does not take part"],
    );
    has(
        fault(
            "setp.eq.u32 %p1, %r0, 0;\n@%p1 shfl.sync.idx.b32 %r1, %r0, 0, 31, -1;",
            32,
        ),
        &["never come"],
    );
    has(
        fault(
            ".shared .align 4 .b8 all[8];\nmov.u32 %r1, all;\nld.shared.u32 %r2, [%r1+8];",
            1,
        ),
        &["shared memory"],
    );
}

#[test]
fn registers_go_from_thread_to_thread() {
    let shuffled = |mode: &str, by: u32, limits: u32| {
        run(
            &format!(
                "shfl.sync.{mode}.b32 %r1|%p1, %r0, {by}, {limits}, -1;\n@!%p1 add.u32 %r1, %r1, 100;\nst.global.u32 [%mine], %r1;"
            ),
            32,
        )
    };
    assert_eq!(shuffled("bfly", 5, 31)[..4], [5, 4, 7, 6]);
    assert_eq!(shuffled("down", 3, 31)[27..], [30, 31, 129, 130, 131]);
    assert_eq!(shuffled("up", 2, 0)[..4], [100, 101, 0, 1]);
    // Within eight threads.
    assert_eq!(
        shuffled("idx", 6, 0x181f)[..10],
        [6, 6, 6, 6, 6, 6, 6, 6, 14, 14]
    );
    let votes = run(
        "setp.lt.u32 %p1, %r0, 3;\nvote.sync.ballot.b32 %r1, %p1, -1;\nst.global.u32 [%mine], %r1;",
        32,
    );
    assert_eq!(votes, [7; 32]);
    let sums = run(
        "redux.sync.add.s32 %r1, %r0, -1;\nst.global.u32 [%mine], %r1;",
        32,
    );
    assert_eq!(sums, [496; 32]);
}

#[test]
fn atomic_changes_are_all_made() {
    let out = run(
        "st.global.u32 [%mine], 0;\nbar.sync 0;\nred.global.add.u32 [%out], %r0;\nbar.sync 0;\nld.global.u32 %r1, [%out];\nsetp.eq.u32 %p1, %r0, 0;\n@%p1 bra END;\nst.global.u32 [%mine], %r1;\nEND:",
        100,
    );
    assert_eq!(out, [4950; 100]);
}

#[test]
fn functions_are_called() {
    let header = ".version 8.0\n.target sm_80\n.address_size 64\n\
         .func (.param .b32 result) twice(.param .b32 x)\n{\n.reg .b32 %r<3>;\n.reg .pred %p<2>;\n\
         ld.param.b32 %r1, [x];\nsetp.gt.u32 %p1, %r1, 2;\n@%p1 bra MORE;\nst.param.b32 [result], 1;\nret;\n\
         MORE: add.u32 %r2, %r1, %r1;\nst.param.b32 [result], %r2;\nret;\n}\n";
    let call = "{\n.param .b32 given;\n.param .b32 got;\nst.param.b32 [given], %r0;\n\
         call.uni (got), twice, (given);\nld.param.b32 %r1, [got];\n}\nst.global.u32 [%mine], %r1;";
    let text = format!(
        "{header}{}",
        kernel(call)
            .split_once(".address_size 64")
            .expect("a header")
            .1
    );
    assert_eq!(run_with(&text, 5, 0, 0).out, [1, 1, 1, 6, 8]);
}

/// 16 bytes for each of 32 threads are copied to shared memory; what is read there.
fn copied(wait: &str) -> Vec<u32> {
    run(
        &format!(
            ".shared .align 16 .b8 all[128];\nst.global.u32 [%mine], %r0;\nbar.sync 0;\nmov.u32 %r1, all;\n\
             shl.b32 %r2, %r0, 4;\nadd.u32 %r3, %r1, %r2;\nmul.wide.u32 %d1, %r0, 16;\nadd.u64 %d1, %d1, %out;\n\
             setp.lt.u32 %p1, %r0, 8;\n@%p1 cp.async.cg.shared.global [%r3], [%d1], 16;\ncp.async.commit_group;\n{wait}\n\
             bar.sync 0;\nxor.b32 %r4, %r0, 1;\nshl.b32 %r4, %r4, 2;\nadd.u32 %r4, %r4, %r1;\nld.shared.u32 %r5, [%r4];\n\
             st.global.u32 [%mine], %r5;"
        ),
        32,
    )
}

#[test]
fn copies_are_there_when_they_were_waited_for() {
    let expected: Vec<u32> = (0..32).map(|i| i ^ 1).collect();
    assert_eq!(copied("cp.async.wait_group 0;"), expected);
    assert_eq!(copied("cp.async.wait_all;"), expected);
    assert_eq!(copied("cp.async.wait_group 1;"), [u32::MAX; 32]);
}

/// Matrices of 8 x 8 numbers of 16 bits, 100 times the row and the column.
const MATRICES: &str = ".shared .align 16 .b8 all[512];\n.reg .b32 %m<4>;\nmov.u32 %r1, all;\nmov.u32 %r2, 0;\n\
    FILL: mad.lo.u32 %r3, %r2, 32, %r0;\nshr.u32 %r4, %r3, 3;\nand.b32 %r5, %r3, 7;\nmad.lo.u32 %r4, %r4, 100, %r5;\n\
    shl.b32 %r3, %r3, 1;\nadd.u32 %r3, %r3, %r1;\nst.shared.u16 [%r3], %r4;\nadd.u32 %r2, %r2, 1;\n\
    setp.lt.u32 %p1, %r2, 8;\n@%p1 bra FILL;\nbar.sync 0;\nshl.b32 %r6, %r0, 4;\nadd.u32 %r6, %r6, %r1;\n";

#[test]
fn matrices_are_loaded() {
    let loaded = |register: u32, transposed: &str| {
        run(
            &format!(
                "{MATRICES}ldmatrix.sync.aligned.m8n8.x4{transposed}.shared.b16 {{%m0, %m1, %m2, %m3}}, [%r6];\nst.global.u32 [%mine], %m{register};"
            ),
            32,
        )
    };
    let pair = |first: u32, second: u32| first | second << 16;
    // Thread 5 has row 1, columns 2 and 3; row 17 is row 1 of the third matrix.
    assert_eq!(loaded(0, "")[5], pair(102, 103));
    assert_eq!(loaded(2, "")[5], pair(1702, 1703));
    assert_eq!(loaded(0, ".trans")[5], pair(201, 301));
}

#[test]
fn matrices_are_multiplied() {
    // A is 1 but for row 3, which is 2; B is the column's number plus 1, in bf16; C is 0.5.
    let product = |to: u32| {
        run(
            &format!(
                "mov.u32 %r1, 0x3f803f80;\nshr.u32 %r2, %r0, 2;\nsetp.eq.u32 %p1, %r2, 3;\nselp.b32 %r3, 0x40004000, %r1, %p1;\n\
                 add.u32 %r4, %r2, 1;\ncvt.rn.f32.u32 %f1, %r4;\ncvt.rn.bf16x2.f32 %r5, %f1, %f1;\nmov.f32 %f2, 0f3F000000;\n\
                 mma.sync.aligned.m16n8k16.row.col.f32.bf16.bf16.f32 {{%f4, %f5, %f6, %f7}}, {{%r3, %r1, %r3, %r1}}, \
                 {{%r5, %r5}}, {{%f2, %f2, %f2, %f2}};\nst.global.f32 [%mine], %f{to};"
            ),
            32,
        )
    };
    // Thread 14 has row 3, columns 4 and 5, and row 11.
    assert_eq!(f32::from_bits(product(4)[14]), 2.0 * 16.0 * 5.0 + 0.5);
    assert_eq!(f32::from_bits(product(5)[14]), 2.0 * 16.0 * 6.0 + 0.5);
    assert_eq!(f32::from_bits(product(6)[14]), 16.0 * 5.0 + 0.5);
}
