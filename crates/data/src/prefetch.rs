//! Making numbered things ahead of their use, on threads, and handing them out in order.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// How many finished things may wait for each worker: one being handed out, one in reserve.
const LOOK_AHEAD_PER_WORKER: u64 = 2;

/// How often a waiting consumer checks whether to stop.
const STOP_INTERVAL: Duration = Duration::from_millis(100);

/// How long dropping waits for workers to end what they are at.
const PATIENCE: Duration = Duration::from_secs(2);

/// Worker threads that make thing 0, 1, 2, ... and a consumer that gets them in that order.
///
/// Workers never run further ahead of the consumer than the look-ahead. Dropping it ends them.
pub(crate) struct Prefetch<T> {
    shared: Arc<Shared<T>>,
    workers: Vec<JoinHandle<()>>,
}

struct Shared<T> {
    state: Mutex<State<T>>,
    /// Signalled when a thing is finished.
    finished: Condvar,
    /// Signalled when the consumer took one, or all is over.
    room: Condvar,
    look_ahead: u64,
}

struct State<T> {
    next_to_make: u64,
    next_to_hand_out: u64,
    /// Finished things, or the panic of the worker that made them.
    ready: BTreeMap<u64, thread::Result<T>>,
    stopped: bool,
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        // Nothing that panics runs under the lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The number of the next thing to make, once there is room for it; `None` when all is over.
    fn claim(&self) -> Option<u64> {
        let mut state = self.lock();
        while !state.stopped && state.next_to_make - state.next_to_hand_out >= self.look_ahead {
            state = self
                .room
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        if state.stopped {
            return None;
        }
        state.next_to_make += 1;
        Some(state.next_to_make - 1)
    }
}

impl<T: Send + 'static> Prefetch<T> {
    /// Starts `workers` threads, at least one, on `make(first)`, `make(first + 1)`, ... Each has
    /// its own clone of `make`. `None` if the system gives no thread at all.
    pub fn start(
        workers: usize,
        first: u64,
        make: impl FnMut(u64) -> T + Clone + Send + 'static,
    ) -> Option<Self> {
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                next_to_make: first,
                next_to_hand_out: first,
                ready: BTreeMap::new(),
                stopped: false,
            }),
            finished: Condvar::new(),
            room: Condvar::new(),
            look_ahead: LOOK_AHEAD_PER_WORKER * workers as u64,
        });
        let workers: Vec<JoinHandle<()>> = (0..workers)
            .map_while(|worker| {
                let (shared, mut make) = (Arc::clone(&shared), make.clone());
                let name = format!("loader-{worker}");
                thread::Builder::new()
                    .name(name)
                    .spawn(move || work(&shared, &mut make))
                    .ok()
            })
            .collect();
        (!workers.is_empty()).then_some(Self { shared, workers })
    }

    /// The next thing, waiting for it where need be; `None` if `stop` comes to hold meanwhile.
    ///
    /// # Panics
    /// Goes on with the panic of the worker that made it.
    pub fn next_unless(&mut self, stop: &dyn Fn() -> bool) -> Option<T> {
        let mut state = self.shared.lock();
        let number = state.next_to_hand_out;
        let outcome = loop {
            if let Some(outcome) = state.ready.remove(&number) {
                break outcome;
            }
            if stop() {
                return None;
            }
            let waited = self.shared.finished.wait_timeout(state, STOP_INTERVAL);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        };
        state.next_to_hand_out += 1;
        drop(state);
        self.shared.room.notify_all();
        Some(outcome.unwrap_or_else(|panic| resume_unwind(panic)))
    }
}

/// Produces items until stopped. A panic is passed on in place of the item, so that the consumer
/// receives it too.
fn work<T>(shared: &Shared<T>, make: &mut impl FnMut(u64) -> T) {
    while let Some(number) = shared.claim() {
        let outcome = catch_unwind(AssertUnwindSafe(|| make(number)));
        shared.lock().ready.insert(number, outcome);
        shared.finished.notify_all();
    }
}

impl<T> Drop for Prefetch<T> {
    fn drop(&mut self) {
        self.shared.lock().stopped = true;
        self.shared.room.notify_all();
        let deadline = Instant::now() + PATIENCE;
        for worker in self.workers.drain(..) {
            while !worker.is_finished() && Instant::now() < deadline {
                thread::sleep(Duration::from_millis(1));
            }
            // One that waits for a network longer ends by itself, or with the process.
            if worker.is_finished() {
                // Its panics were caught.
                let _ = worker.join();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

    fn next<T: Send + 'static>(prefetch: &mut Prefetch<T>) -> T {
        prefetch
            .next_unless(&|| false)
            .expect("nobody asks to stop")
    }

    #[test]
    fn who_asks_to_stop_does_not_wait() {
        let mut prefetch =
            Prefetch::start(1, 0, |_| thread::sleep(Duration::from_secs(4))).unwrap();
        let asked = Instant::now();
        let waited = || asked.elapsed() > Duration::from_millis(50);
        assert_eq!(prefetch.next_unless(&waited), None);
        drop(prefetch);
        assert!(asked.elapsed() < Duration::from_secs(4));
    }

    #[test]
    fn things_come_in_order_whatever_the_speed_of_each() {
        for workers in [1, 3, 8] {
            let make = |number: u64| {
                thread::sleep(Duration::from_micros(number * 7919 % 700));
                number * number
            };
            let mut prefetch = Prefetch::start(workers, 5, make).unwrap();
            for number in 5..60 {
                assert_eq!(next(&mut prefetch), number * number);
            }
        }
    }

    #[test]
    fn workers_wait_for_a_slow_consumer() {
        let made = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&made);
        let mut prefetch = Prefetch::start(3, 0, move |number| {
            count.fetch_add(1, Ordering::SeqCst);
            number
        })
        .unwrap();
        let deadline = Instant::now() + Duration::from_secs(20);
        while made.load(Ordering::SeqCst) < 6 && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        thread::sleep(Duration::from_millis(50));
        assert_eq!(
            made.load(Ordering::SeqCst),
            6,
            "two for each worker, and no more"
        );
        assert_eq!(next(&mut prefetch), 0);
    }

    #[test]
    fn a_panic_reaches_the_consumer_and_nothing_hangs() {
        let make = |number: u64| match number {
            2 => panic!("thing two is broken"),
            other => other,
        };
        let mut prefetch = Prefetch::start(1, 0, make).unwrap();
        assert_eq!((next(&mut prefetch), next(&mut prefetch)), (0, 1));
        let panic = catch_unwind(AssertUnwindSafe(|| next(&mut prefetch))).unwrap_err();
        assert_eq!(
            *panic.downcast_ref::<&str>().unwrap(),
            "thing two is broken"
        );
        assert_eq!(next(&mut prefetch), 3);
    }

    #[test]
    fn dropping_ends_the_threads() {
        let alive = Arc::new(());
        let held = Arc::clone(&alive);
        let mut prefetch = Prefetch::start(4, 0, move |number| {
            let _held = &held;
            number
        })
        .unwrap();
        assert_eq!(next(&mut prefetch), 0);
        drop(prefetch);
        assert_eq!(
            Arc::strong_count(&alive),
            1,
            "every worker gave its clone back"
        );
    }
}
