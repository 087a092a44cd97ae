//! The number of comparisons of the test on this thread.

use std::cell::Cell;

thread_local! {
    static COMPARED: Cell<usize> = const { Cell::new(0) };
    static SILENT: Cell<bool> = const { Cell::new(false) };
}

/// Adds to the number of values compared with reference values. The comparing functions of this
/// crate call it; a test that compares by `assert_eq!` calls it too.
pub fn compared(values: usize) {
    COMPARED.set(COMPARED.get() + values);
}

/// Runs `body` and returns the number of values it compared on this thread; other threads are not
/// counted. A `silent` body's measured errors are not printed.
pub fn counting(silent: bool, body: impl FnOnce()) -> usize {
    COMPARED.set(0);
    SILENT.set(silent);
    body();
    SILENT.set(false);
    COMPARED.replace(0)
}

/// Prints a measured error and its bound.
pub(crate) fn report(what: &str, error: f64, tolerance: f64) {
    if !SILENT.get() {
        println!("{what}: error {error:.1e} of {tolerance:.0e}");
    }
}
