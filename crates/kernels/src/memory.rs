//! The process's heap.

/// Keeps freed memory for the next training step instead of returning it to the system.
///
/// Returning some hundred megabytes and faulting them in again took a tenth of a step; peak memory
/// does not change. Training programs call this function at start. Only the GNU C library is
/// affected.
pub fn keep_freed() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        /// Larger allocations are mapped.
        const LARGEST_IN_HEAP: libc::c_int = 32 << 20;
        // SAFETY: `mallopt` takes the library's own lock and reads no memory of ours.
        #[allow(unsafe_code)]
        unsafe {
            libc::mallopt(libc::M_MMAP_THRESHOLD, LARGEST_IN_HEAP);
            libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
        }
    }
}
