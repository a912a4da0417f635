//! A driver and libraries of CUDA for a GPU that there is not. Its memory is the machine's, kernels are run from their
//! PTX by an interpreter, and products of matrices are computed: programs see the numbers that a GPU would give, but
//! for the order of sums and the errors of approximate functions.
//!
//! What a GPU refuses, this one does: memory of 0 bytes, blocks that are too large, too much shared memory. And it says
//! what a GPU would not: which thread accesses what memory that is nobody's, where threads wait for others that never
//! come, which instruction is not known. New memory is full of NaN.
//!
//! Variables of the environment:
//! - `CUDA_DRIVER_IDLE=1`: kernels and products are checked, and do nothing; new memory is zeros. Programs see all but
//!   numbers: which tensors are where, what is asked of CUDA in which shapes, how much memory is taken.
//! - `CUDA_DRIVER_SEED=N`: warps of a block run in an order that depends on N, so that a barrier that is missing shows.

#![allow(non_snake_case)]

mod access;
mod blas;
mod compile;
mod launch;
mod memory;
mod number;
mod product;
mod program;
mod random;
mod registers;
mod syntax;
#[cfg(test)]
mod tests;
mod warp;

use launch::Launch;
use program::Program;
use std::collections::HashMap;
use std::env;
use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::ptr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock};
use syntax::Module;

const SUCCESS: c_int = 0;
const INVALID_VALUE: c_int = 1;
const OUT_OF_MEMORY: c_int = 2;
const INVALID_DEVICE: c_int = 101;
const INVALID_PTX: c_int = 218;
const NOT_FOUND: c_int = 500;
const ILLEGAL_ADDRESS: c_int = 700;
const LAUNCH_FAILED: c_int = 719;

/// Whether kernels and products do nothing.
fn is_idle() -> bool {
    static IDLE: OnceLock<bool> = OnceLock::new();
    *IDLE.get_or_init(|| env::var_os("CUDA_DRIVER_IDLE").is_some_and(|value| value == "1"))
}

fn seed() -> u64 {
    static SEED: OnceLock<u64> = OnceLock::new();
    *SEED.get_or_init(|| {
        env::var("CUDA_DRIVER_SEED")
            .ok()
            .and_then(|seed| seed.parse().ok())
            .unwrap_or(0)
    })
}

/// A module that was loaded, and the kernels in it that were asked for. They stay for as long as the program runs.
struct Loaded {
    module: Module,
    kernels: Mutex<HashMap<String, &'static Kernel>>,
}

struct Kernel {
    program: Program,
    /// Bytes of dynamic shared memory that were asked for.
    asked: AtomicUsize,
}

fn say(code: c_int, what: &str) -> c_int {
    eprintln!("CUDA's driver: {what}");
    code
}

fn load_module(to: *mut *const Loaded, image: *const c_char) -> c_int {
    let Ok(text) = unsafe { CStr::from_ptr(image) }.to_str() else {
        return say(INVALID_PTX, "a module is no PTX");
    };
    let text: &'static str = text.to_string().leak();
    match load(text) {
        Ok(module) => {
            let loaded = Loaded {
                module,
                kernels: Mutex::default(),
            };
            unsafe { *to = Box::leak(Box::new(loaded)) };
            SUCCESS
        }
        Err(problem) => say(INVALID_PTX, &problem),
    }
}

/// A module whose variables are in the GPU's memory.
fn load(text: &'static str) -> Result<Module, String> {
    let mut module = syntax::parse(text)?;
    for variable in module
        .variables
        .values()
        .filter(|variable| variable.space != ".shared" && variable.bytes > 0)
    {
        let address =
            memory::allocate(variable.bytes, false).ok_or("variables do not fit in memory")?;
        unsafe {
            ptr::copy_nonoverlapping(
                variable.start.as_ptr(),
                address as *mut u8,
                variable.start.len(),
            )
        };
        module.places.insert(variable.name, address);
    }
    Ok(module)
}

fn get_function(to: *mut *const Kernel, module: *const Loaded, name: *const c_char) -> c_int {
    let loaded: &'static Loaded = unsafe { &*module };
    let name = unsafe { CStr::from_ptr(name) }.to_string_lossy();
    let mut kernels = loaded.kernels.lock().expect("no thread panics");
    if let Some(&kernel) = kernels.get(&*name) {
        unsafe { *to = kernel };
        return SUCCESS;
    }
    match compile::compile(&loaded.module, &name) {
        Ok(program) => {
            let kernel = Box::leak(Box::new(Kernel {
                program,
                asked: AtomicUsize::new(0),
            }));
            kernels.insert(name.into_owned(), kernel);
            unsafe { *to = kernel };
            SUCCESS
        }
        Err(problem) => say(NOT_FOUND, &problem),
    }
}

/// Sets what a kernel asks for; only shared memory counts here.
fn set_attribute(kernel: *const Kernel, attribute: c_uint, value: c_int) -> c_int {
    const MAX_DYNAMIC_SHARED_SIZE_BYTES: c_uint = 8;
    if attribute != MAX_DYNAMIC_SHARED_SIZE_BYTES {
        return SUCCESS;
    }
    let kernel = unsafe { &*kernel };
    let Some(bytes) = usize::try_from(value)
        .ok()
        .filter(|bytes| kernel.program.shared + bytes <= launch::SHARED_ASKED)
    else {
        return say(
            INVALID_VALUE,
            &format!("{value} bytes of shared memory are more than there are"),
        );
    };
    kernel.asked.store(bytes, Ordering::Relaxed);
    SUCCESS
}

fn run(
    kernel: *const Kernel,
    grid: [u32; 3],
    block: [u32; 3],
    dynamic: u32,
    given: *const *const u8,
) -> c_int {
    let kernel = unsafe { &*kernel };
    let program = &kernel.program;
    let mut parameters = Vec::new();
    for (index, parameter) in program.parameters.iter().enumerate() {
        parameters.resize(parameter.offset, 0);
        let from = unsafe { *given.add(index) };
        if from.is_null() {
            return say(
                INVALID_VALUE,
                &format!("{} lacks a parameter", program.name),
            );
        }
        parameters.extend_from_slice(unsafe { std::slice::from_raw_parts(from, parameter.bytes) });
    }
    let asked = kernel.asked.load(Ordering::Relaxed);
    let launch = Launch {
        program,
        grid,
        block,
        dynamic: dynamic as usize,
        asked,
        parameters,
        seed: seed(),
    };
    if let Some(refusal) = launch.refusal() {
        return say(
            INVALID_VALUE,
            &format!("{} cannot be run: {refusal}", program.name),
        );
    }
    if is_idle() {
        return SUCCESS;
    }
    launch
        .run()
        .map_or_else(|problem| say(LAUNCH_FAILED, &problem), |()| SUCCESS)
}

fn allocate(to: *mut u64, bytes: usize) -> c_int {
    if bytes == 0 {
        return INVALID_VALUE;
    }
    let Some(address) = memory::allocate(bytes, !is_idle()) else {
        return OUT_OF_MEMORY;
    };
    unsafe { *to = address };
    SUCCESS
}

fn release(address: u64) -> c_int {
    if memory::release(address) {
        SUCCESS
    } else {
        say(INVALID_VALUE, "what is freed was not taken")
    }
}

/// The GPU's part of a copy has to be the GPU's memory.
fn copy(to: u64, from: u64, bytes: usize, of_gpu: &[u64]) -> c_int {
    if of_gpu
        .iter()
        .any(|&address| !memory::contains(address, bytes))
    {
        return say(
            ILLEGAL_ADDRESS,
            &format!("{bytes} bytes are copied, of which not all are the GPU's"),
        );
    }
    unsafe { ptr::copy(from as *const u8, to as *mut u8, bytes) };
    SUCCESS
}

fn attribute(which: c_uint) -> c_int {
    match which {
        1 => launch::THREADS as c_int,
        2..=4 => launch::BLOCK[which as usize - 2] as c_int,
        5..=7 => launch::GRID[which as usize - 5] as c_int,
        8 => launch::SHARED as c_int,
        10 => registers::LANES as c_int,
        // The generation, 8.6, and what a block's shared memory can be there.
        75 => 8,
        76 => 6,
        97 => launch::SHARED_ASKED as c_int,
        // Memory pools are there, and whatever else is asked for counts one.
        _ => 1,
    }
}

/// Something to point to.
static HANDLE: u64 = 0;

fn handle(to: *mut *const c_void) -> c_int {
    unsafe { *to = (&raw const HANDLE).cast() };
    SUCCESS
}

macro_rules! functions {
    ($($name:ident($($argument:ident: $type:ty),*) $body:block)*) => {
        $(#[unsafe(no_mangle)]
        extern "C" fn $name($($argument: $type),*) -> c_int $body)*
    };
}

macro_rules! succeed {
    ($($name:ident)*) => {
        $(#[unsafe(no_mangle)]
        extern "C" fn $name() -> c_int {
            SUCCESS
        })*
    };
}

functions! {
    cuDeviceGetCount(count: *mut c_int) { unsafe { *count = 1 }; SUCCESS }
    cuDeviceGet(device: *mut c_int, index: c_int) {
        if index != 0 {
            return INVALID_DEVICE;
        }
        unsafe { *device = 0 };
        SUCCESS
    }
    cuDeviceGetName(name: *mut c_char, _length: c_int, _device: c_int) { unsafe { *name = 0 }; SUCCESS }
    cuDeviceGetAttribute(value: *mut c_int, which: c_uint, _device: c_int) {
        unsafe { *value = attribute(which) };
        SUCCESS
    }
    cuDevicePrimaryCtxRetain(context: *mut *const c_void, _device: c_int) { handle(context) }
    cuCtxGetCurrent(context: *mut *const c_void) { handle(context) }
    cuStreamCreate(stream: *mut *const c_void, _flags: c_uint) { handle(stream) }
    cuEventCreate(event: *mut *const c_void, _flags: c_uint) { handle(event) }
    cuStreamIsCapturing(_stream: u64, status: *mut c_int) { unsafe { *status = 0 }; SUCCESS }
    cuModuleLoadData(module: *mut *const Loaded, image: *const c_char) { load_module(module, image) }
    cuModuleGetFunction(function: *mut *const Kernel, module: *const Loaded, name: *const c_char) {
        get_function(function, module, name)
    }
    cuFuncSetAttribute(kernel: *const Kernel, which: c_uint, value: c_int) { set_attribute(kernel, which, value) }
    cuLaunchKernel(
        kernel: *const Kernel, grid_x: c_uint, grid_y: c_uint, grid_z: c_uint, block_x: c_uint, block_y: c_uint,
        block_z: c_uint, shared: c_uint, _stream: u64, parameters: *const *const u8, _extra: u64
    ) {
        run(kernel, [grid_x, grid_y, grid_z], [block_x, block_y, block_z], shared, parameters)
    }
    cuMemGetInfo_v2(free: *mut usize, total: *mut usize) {
        unsafe {
            *free = memory::free();
            *total = memory::TOTAL;
        }
        SUCCESS
    }
    cuMemAlloc_v2(to: *mut u64, bytes: usize) { allocate(to, bytes) }
    cuMemAllocAsync(to: *mut u64, bytes: usize, _stream: u64) { allocate(to, bytes) }
    cuMemFree_v2(address: u64) { release(address) }
    cuMemFreeAsync(address: u64, _stream: u64) { release(address) }
    cuMemcpyHtoD_v2(to: u64, from: u64, bytes: usize) { copy(to, from, bytes, &[to]) }
    cuMemcpyHtoDAsync_v2(to: u64, from: u64, bytes: usize, _stream: u64) { copy(to, from, bytes, &[to]) }
    cuMemcpyDtoH_v2(to: u64, from: u64, bytes: usize) { copy(to, from, bytes, &[from]) }
    cuMemcpyDtoHAsync_v2(to: u64, from: u64, bytes: usize, _stream: u64) { copy(to, from, bytes, &[from]) }
    cuMemcpyDtoDAsync_v2(to: u64, from: u64, bytes: usize, _stream: u64) { copy(to, from, bytes, &[to, from]) }
    cuMemsetD8Async(at: u64, value: u8, bytes: usize, _stream: u64) {
        if !memory::contains(at, bytes) {
            return say(ILLEGAL_ADDRESS, &format!("{bytes} bytes are set, of which not all are the GPU's"));
        }
        unsafe { ptr::write_bytes(at as *mut u8, value, bytes) };
        SUCCESS
    }
    cuGetErrorName(_error: c_int, name: *mut *const c_char) { unsafe { *name = c"CUDA error".as_ptr() }; SUCCESS }
    cuGetErrorString(error: c_int, text: *mut *const c_char) {
        let what = match error {
            LAUNCH_FAILED => c"a kernel failed",
            ILLEGAL_ADDRESS => c"an illegal address",
            INVALID_PTX => c"a module cannot be read",
            NOT_FOUND => c"no such kernel",
            INVALID_VALUE => c"an invalid value",
            _ => c"no such GPU or memory",
        };
        unsafe { *text = what.as_ptr() };
        SUCCESS
    }
    cublasCreate_v2(to: *mut *const c_void) { handle(to) }
}

succeed! {
    cuInit cuDevicePrimaryCtxRelease_v2 cuCtxSetCurrent cuCtxSynchronize cuCtxSetFlags
    cuStreamDestroy_v2 cuStreamSynchronize cuStreamWaitEvent
    cuEventDestroy_v2 cuEventRecord cuEventSynchronize cuEventQuery
    cuModuleUnload
    cublasDestroy_v2 cublasSetStream_v2 cublasSetMathMode cublasSetWorkspace_v2
}
