//! What becomes of memory that is freed.

/// Lets the process keep memory that is freed, up to a gigabyte or so, instead of giving each large array back
/// to the system at once, as glibc does. To be called when a program starts.
///
/// Networks free and allocate arrays of the same sizes again and again. Fresh memory has to be cleared by the
/// system first, page by page, which can take a sixth of a network's time. Elsewhere than with glibc,
/// nothing happens.
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        /// The largest array that comes from what is kept; 32 MiB if it is not said.
        const LARGEST: libc::c_int = 1 << 30;
        /// Freed memory at the end of the heap that is kept.
        const KEPT: libc::c_int = 1 << 30;
        // Threads that come and go would each keep their own: one heap for each core is enough.
        let heaps = std::thread::available_parallelism().map_or(1, |cores| cores.get());
        let heaps = libc::c_int::try_from(heaps).unwrap_or(libc::c_int::MAX);
        // SAFETY: changes when memory is returned to the system, and nothing else.
        unsafe {
            libc::mallopt(libc::M_MMAP_THRESHOLD, LARGEST);
            libc::mallopt(libc::M_TRIM_THRESHOLD, KEPT);
            libc::mallopt(libc::M_ARENA_MAX, heaps);
        }
    }
}
