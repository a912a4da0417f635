//! Arrays that threads write together.

/// A pointer that may be given to other threads.
///
/// Whoever writes through it sees to it that no two threads touch the same elements.
#[derive(Clone, Copy)]
pub(super) struct Shared<T>(pub(super) *mut T);

// SAFETY: it is only a number; using it is unsafe, and the promise above is made there.
unsafe impl<T: Send> Send for Shared<T> {}
// SAFETY: as above.
unsafe impl<T: Send> Sync for Shared<T> {}

impl<T> Shared<T> {
    /// The element `offset` further on.
    pub(super) fn add(&self, offset: usize) -> *mut T {
        self.0.wrapping_add(offset)
    }
}

/// A new array of `len` numbers, all of which `fill` writes through the pointer that it gets.
///
/// Unlike an array of zeros, its memory is touched first by the threads that write it.
///
/// # Errors
///
/// Those of `fill`.
///
/// # Safety
///
/// `fill` writes every element unless it fails, and nothing beyond.
pub(super) unsafe fn filled<E>(
    len: usize,
    fill: impl FnOnce(*mut f32) -> Result<(), E>,
) -> Result<Vec<f32>, E> {
    let mut values = Vec::with_capacity(len);
    prefer_large_pages(values.as_mut_ptr(), len);
    if cfg!(tid3r_checked) {
        // Miri sees what is never written; for others, that is told by its value.
        values.resize(len, f32::NAN);
        values.clear();
    }
    fill(values.as_mut_ptr())?;
    // SAFETY: `fill` wrote them, as the caller promises.
    unsafe { values.set_len(len) };
    Ok(values)
}

/// Asks the system to back `len` elements, which nobody has written yet, with large pages. Handing out large
/// arrays page by page takes longer than filling them.
#[cfg(target_os = "linux")]
pub(super) fn prefer_large_pages<T>(start: *mut T, len: usize) {
    /// Bytes of a page, at least.
    const PAGE: usize = 1 << 12;
    /// Bytes for which it pays.
    const LARGE: usize = 1 << 22;
    let bytes = len * size_of::<T>();
    if bytes >= LARGE {
        let start = start.cast::<u8>();
        let offset = start.align_offset(PAGE);
        // SAFETY: this changes nothing but how memory, which is this array's, is backed. Where it is
        // refused, it is backed as always.
        unsafe {
            libc::madvise(
                start.wrapping_add(offset).cast(),
                bytes - offset,
                libc::MADV_HUGEPAGE,
            );
        }
    }
}

/// Only Linux is asked.
#[cfg(not(target_os = "linux"))]
pub(super) fn prefer_large_pages<T>(_start: *mut T, _len: usize) {}
