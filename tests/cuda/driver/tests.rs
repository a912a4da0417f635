//! Kernels small enough to know what comes out.

mod numbers;
mod warps;

use crate::launch::Launch;
use crate::{compile, load, memory};

/// A kernel with one parameter, `%out`'s address, and these statements.
fn kernel(body: &str) -> String {
    format!(
        ".version 8.0\n.target sm_80\n.address_size 64\n.visible .entry test(.param .u64 out)\n{{\n\
         .reg .pred %p<8>;\n.reg .b16 %h<32>;\n.reg .b32 %r<64>;\n.reg .b64 %d<32>;\n.reg .f32 %f<32>;\n\
         .reg .b64 %out, %mine;\n\
         ld.param.u64 %out, [out];\nmov.u32 %r0, %tid.x;\nmul.wide.u32 %mine, %r0, 4;\nadd.u64 %mine, %out, %mine;\n\
         {body}\nret;\n}}\n"
    )
}

struct Ran {
    out: Vec<u32>,
    result: Result<(), String>,
}

/// Runs one block; the output is a number for each thread, at first full of ones.
fn run_with(text: &str, threads: u32, dynamic: usize, seed: u64) -> Ran {
    let module = load(text.to_string().leak()).expect("PTX");
    let program = compile::compile(&module, "test").expect("a kernel");
    let address = memory::allocate(threads as usize * 4, true).expect("memory");
    let launch = Launch {
        program: &program,
        grid: [1; 3],
        block: [threads, 1, 1],
        dynamic,
        asked: 0,
        parameters: address.to_le_bytes().to_vec(),
        seed,
    };
    assert_eq!(launch.refusal(), None);
    let result = launch.run();
    let out =
        unsafe { std::slice::from_raw_parts(address as *const u32, threads as usize) }.to_vec();
    memory::release(address);
    Ran { out, result }
}

/// What every thread of a block puts out.
fn run(body: &str, threads: u32) -> Vec<u32> {
    let Ran { out, result } = run_with(&kernel(body), threads, 0, 0);
    assert_eq!(result, Ok(()));
    out
}

/// What is said about a kernel that must not run to its end.
fn fault(body: &str, threads: u32) -> String {
    run_with(&kernel(body), threads, 0, 0)
        .result
        .expect_err("a fault")
}

/// What the first thread puts out.
fn first(body: &str) -> u32 {
    run(&format!("{body}\nst.global.u32 [%mine], %r1;"), 1)[0]
}
