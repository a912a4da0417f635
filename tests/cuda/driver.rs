//! A driver and libraries of CUDA for a GPU that there is not: its memory is the machine's, new memory is zeros, copies
//! are real, and kernels and products of matrices do nothing. Programs see all that they would see on a GPU but numbers:
//! which tensors are where, what is asked of CUDA and in which shapes, and how much memory is taken.
//!
//! As on a GPU, no memory of 0 bytes can be had.

use std::alloc::{Layout, alloc_zeroed, dealloc};
use std::collections::HashMap;
use std::ffi::{c_char, c_int, c_uint, c_void};
use std::ptr;
use std::sync::Mutex;

const SUCCESS: c_int = 0;
const INVALID_VALUE: c_int = 1;
const OUT_OF_MEMORY: c_int = 2;
/// Bytes that the GPU has.
const MEMORY: usize = 16 << 30;

/// What was taken, by address.
static TAKEN: Mutex<Option<HashMap<u64, usize>>> = Mutex::new(None);

fn layout(bytes: usize) -> Layout {
    Layout::from_size_align(bytes, 256).unwrap()
}

fn free_bytes() -> usize {
    let taken = TAKEN.lock().unwrap();
    let sum: usize = taken.iter().flat_map(HashMap::values).sum();
    MEMORY - sum
}

fn allocate(to: *mut u64, bytes: usize) -> c_int {
    if bytes == 0 {
        return INVALID_VALUE;
    }
    if bytes > free_bytes() {
        return OUT_OF_MEMORY;
    }
    let address = unsafe { alloc_zeroed(layout(bytes)) } as u64;
    unsafe { *to = address };
    let mut taken = TAKEN.lock().unwrap();
    taken.get_or_insert_default().insert(address, bytes);
    SUCCESS
}

fn release(address: u64) -> c_int {
    let size = TAKEN.lock().unwrap().get_or_insert_default().remove(&address);
    let Some(bytes) = size else {
        return INVALID_VALUE;
    };
    unsafe { dealloc(address as *mut u8, layout(bytes)) };
    SUCCESS
}

fn copy(to: u64, from: u64, bytes: usize) -> c_int {
    unsafe { ptr::copy(from as *const u8, to as *mut u8, bytes) };
    SUCCESS
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
        pub extern "C" fn $name($($argument: $type),*) -> c_int $body)*
    };
}

macro_rules! succeed {
    ($($name:ident)*) => {
        $(#[unsafe(no_mangle)]
        pub extern "C" fn $name() -> c_int {
            SUCCESS
        })*
    };
}

functions! {
    cuDeviceGetCount(count: *mut c_int) { unsafe { *count = 1 }; SUCCESS }
    cuDeviceGet(device: *mut c_int, index: c_int) {
        if index != 0 {
            return 101;
        }
        unsafe { *device = 0 };
        SUCCESS
    }
    cuDeviceGetName(name: *mut c_char, _length: c_int, _device: c_int) { unsafe { *name = 0 }; SUCCESS }
    // Memory pools are there, and whatever else is asked for counts one.
    cuDeviceGetAttribute(value: *mut c_int, _attribute: c_uint, _device: c_int) { unsafe { *value = 1 }; SUCCESS }
    cuDevicePrimaryCtxRetain(context: *mut *const c_void, _device: c_int) { handle(context) }
    cuCtxGetCurrent(context: *mut *const c_void) { handle(context) }
    cuStreamCreate(stream: *mut *const c_void, _flags: c_uint) { handle(stream) }
    cuEventCreate(event: *mut *const c_void, _flags: c_uint) { handle(event) }
    cuStreamIsCapturing(_stream: u64, status: *mut c_int) { unsafe { *status = 0 }; SUCCESS }
    cuModuleLoadData(module: *mut *const c_void, _image: u64) { handle(module) }
    cuModuleGetFunction(function: *mut *const c_void, _module: u64, _name: u64) { handle(function) }
    cuMemGetInfo_v2(free: *mut usize, total: *mut usize) {
        unsafe {
            *free = free_bytes();
            *total = MEMORY;
        }
        SUCCESS
    }
    cuMemAlloc_v2(to: *mut u64, bytes: usize) { allocate(to, bytes) }
    cuMemAllocAsync(to: *mut u64, bytes: usize, _stream: u64) { allocate(to, bytes) }
    cuMemFree_v2(address: u64) { release(address) }
    cuMemFreeAsync(address: u64, _stream: u64) { release(address) }
    cuMemcpyHtoD_v2(to: u64, from: u64, bytes: usize) { copy(to, from, bytes) }
    cuMemcpyHtoDAsync_v2(to: u64, from: u64, bytes: usize, _stream: u64) { copy(to, from, bytes) }
    cuMemcpyDtoH_v2(to: u64, from: u64, bytes: usize) { copy(to, from, bytes) }
    cuMemcpyDtoHAsync_v2(to: u64, from: u64, bytes: usize, _stream: u64) { copy(to, from, bytes) }
    cuMemcpyDtoDAsync_v2(to: u64, from: u64, bytes: usize, _stream: u64) { copy(to, from, bytes) }
    cuMemsetD8Async(at: u64, value: u8, bytes: usize, _stream: u64) {
        unsafe { ptr::write_bytes(at as *mut u8, value, bytes) };
        SUCCESS
    }
    cuGetErrorName(_error: c_int, name: *mut *const c_char) { unsafe { *name = c"CUDA error".as_ptr() }; SUCCESS }
    cuGetErrorString(_error: c_int, text: *mut *const c_char) { unsafe { *text = c"no such GPU or memory".as_ptr() }; SUCCESS }
    cublasCreate_v2(to: *mut *const c_void) { handle(to) }
    curandCreateGenerator(to: *mut *const c_void, _kind: c_uint) { handle(to) }
}

succeed! {
    cuInit cuDevicePrimaryCtxRelease_v2 cuCtxSetCurrent cuCtxSynchronize cuCtxSetFlags
    cuStreamDestroy_v2 cuStreamSynchronize cuStreamWaitEvent
    cuEventDestroy_v2 cuEventRecord cuEventSynchronize cuEventQuery
    cuModuleUnload cuLaunchKernel cuFuncSetAttribute
    cublasDestroy_v2 cublasSetStream_v2 cublasSetMathMode cublasSetWorkspace_v2
    cublasSgemm_v2 cublasDgemm_v2 cublasGemmEx
    cublasSgemmStridedBatched cublasDgemmStridedBatched cublasGemmStridedBatchedEx
    curandDestroyGenerator curandSetStream curandSetPseudoRandomGeneratorSeed
    curandGenerateUniform curandGenerateNormal
}
