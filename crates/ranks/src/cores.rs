//! CPU affinity of processes.

/// Number of words in a set of cores, as in the system's own sets.
pub const WORDS: usize = 16;

/// A set of cores, one bit per core.
pub type Cores = [u64; WORDS];

/// The cores on which this process may run; all cores if unknown.
pub fn own() -> Cores {
    #[cfg(target_os = "linux")]
    {
        let mut cores: Cores = [0; WORDS];
        // SAFETY: the call writes at most `size_of::<Cores>()` bytes, the size of `cores`.
        #[allow(unsafe_code)]
        let found =
            unsafe { libc::sched_getaffinity(0, size_of::<Cores>(), cores.as_mut_ptr().cast()) };
        if found == 0 && cores != [0; WORDS] {
            return cores;
        }
    }
    [u64::MAX; WORDS]
}

/// Number of sets that share a core with `own`.
pub fn sharing(own: &Cores, all: &[Cores]) -> usize {
    let overlaps = |other: &&Cores| own.iter().zip(*other).any(|(a, b)| a & b != 0);
    all.iter().filter(overlaps).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processes_share_the_cores_that_both_may_run_on() {
        let set = |cores: &[usize]| {
            let mut set = [0; WORDS];
            for core in cores {
                set[core / 64] |= 1 << (core % 64);
            }
            set
        };
        let bound = [set(&[0, 1]), set(&[2, 3]), set(&[2, 3]), set(&[700])];
        let shared = bound.each_ref().map(|own| sharing(own, &bound));
        assert_eq!(shared, [1, 2, 2, 1]);
        let free = [own(); 3];
        assert_eq!(sharing(&free[0], &free), 3);
    }
}
