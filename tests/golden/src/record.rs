//! What the test on this thread has compared so far.

use std::cell::Cell;

thread_local! {
    static COMPARED: Cell<usize> = const { Cell::new(0) };
    static SILENT: Cell<bool> = const { Cell::new(false) };
}

/// Notes that so many values were compared with reference values. The functions of this crate that
/// compare note it themselves; a test that does so by `assert_eq!` calls this beside it.
pub fn compared(values: usize) {
    COMPARED.set(COMPARED.get() + values);
}

/// Runs `body` and answers how many values it compared, on this thread; what it compares on others
/// is not counted. A `silent` body's measured errors are not printed.
pub fn counting(silent: bool, body: impl FnOnce()) -> usize {
    COMPARED.set(0);
    SILENT.set(silent);
    body();
    SILENT.set(false);
    COMPARED.replace(0)
}

/// Prints a measured error beside its bound.
pub(crate) fn report(what: &str, error: f64, tolerance: f64) {
    if !SILENT.get() {
        println!("{what}: error {error:.1e} of {tolerance:.0e}");
    }
}
