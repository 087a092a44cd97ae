//! The number of threads.

use std::env;
use std::thread::available_parallelism;

/// The environment variables of the number of threads, in their order of precedence.
const VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "RAYON_RS_NUM_CPUS"];

/// Limits the threads that the environment sets to the cores that this process may use.
pub fn bound() {
    let cores = available_parallelism().map_or(1, usize::from);
    if is_more_than(cores, |name| env::var(name).ok()) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(cores);
        // Fails only if the pool is in use.
        let _ = pool.build_global();
    }
}

/// True if the first variable with a number is larger than `cores`.
fn is_more_than(cores: usize, variable: impl Fn(&str) -> Option<String>) -> bool {
    let mut numbers = VARIABLES
        .iter()
        .filter_map(|name| variable(name)?.parse().ok());
    numbers.next().is_some_and(|threads: usize| threads > cores)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_threads_than_cores_are_found() {
        let asked = |rayon: Option<&str>, older: Option<&str>| {
            is_more_than(8, |name| match name {
                "RAYON_NUM_THREADS" => rayon.map(String::from),
                _ => older.map(String::from),
            })
        };
        for (rayon, older, is_more) in [
            (None, None, false),
            (Some("8"), Some("99"), false),
            (Some("9"), None, true),
            (Some("many"), Some("100000"), true),
            (Some("0"), Some("9"), false),
        ] {
            assert_eq!(asked(rayon, older), is_more, "{rayon:?} {older:?}");
        }
    }
}
