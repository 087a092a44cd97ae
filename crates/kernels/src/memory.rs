//! The process's heap.

/// Keeps freed memory for the next step instead of giving it back to the system.
///
/// A training step frees what the next one allocates again. To hand some hundred megabytes back
/// and fault them in anew, page by page, took a tenth of a step; the peak is the same. For the
/// start of a program that trains; does something with the GNU C library alone.
pub fn keep_freed() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        /// The largest size that the library takes from the heap; larger ones are mapped.
        const LARGEST_IN_HEAP: libc::c_int = 32 << 20;
        // SAFETY: `mallopt` takes the library's own lock and reads no memory of ours.
        #[allow(unsafe_code)]
        unsafe {
            libc::mallopt(libc::M_MMAP_THRESHOLD, LARGEST_IN_HEAP);
            libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
        }
    }
}
