//! Calling libraries that may panic on malformed input.

use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of active guarded calls.
static GUARDED: AtomicUsize = AtomicUsize::new(0);

/// The result of `call`; `None`, without a printed message, if `call` panics.
pub fn guarded<T>(call: impl FnOnce() -> T) -> Option<T> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |panic| {
            // Not thread-local: the library may panic on its own threads.
            if GUARDED.load(Ordering::SeqCst) == 0 {
                before(panic);
            }
        }));
    });
    GUARDED.fetch_add(1, Ordering::SeqCst);
    let outcome = catch_unwind(AssertUnwindSafe(call));
    GUARDED.fetch_sub(1, Ordering::SeqCst);
    outcome.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_none() {
        assert_eq!(guarded(|| 3), Some(3));
        assert_eq!(guarded(|| -> u8 { panic!("forged") }), None);
    }
}
