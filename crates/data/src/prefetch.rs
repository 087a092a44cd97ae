//! Prefetching of numbered values on threads, in order.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Maximum number of values per worker that wait for the consumer.
pub(crate) const LOOK_AHEAD_PER_WORKER: usize = 2;

/// Interval at which a waiting consumer checks whether to stop.
const STOP_INTERVAL: Duration = Duration::from_millis(100);

/// Time limit for workers to end when a [`Prefetch`] is dropped.
const PATIENCE: Duration = Duration::from_secs(2);

/// Worker threads that compute values 0, 1, 2, ... for a consumer that receives them in order.
/// Workers run ahead of the consumer by at most the look-ahead. Dropping a `Prefetch` ends its
/// workers.
pub(crate) struct Prefetch<T> {
    /// Ordered receivers of the requested values, or of a worker's panic.
    ordered: VecDeque<Receiver<thread::Result<T>>>,
    orders: Sender<Order<T>>,
    next_to_order: u64,
    stopped: Arc<AtomicBool>,
    workers: Vec<JoinHandle<()>>,
}

/// The number of a requested value, and the channel for the value.
type Order<T> = (u64, SyncSender<thread::Result<T>>);

impl<T: Send + 'static> Prefetch<T> {
    /// Starts `workers` threads, at least one, on `make(first)`, `make(first + 1)`, ..., each with
    /// a clone of `make`. Returns `None` if no thread starts.
    pub fn start(
        workers: usize,
        first: u64,
        make: impl FnMut(u64) -> T + Clone + Send + 'static,
    ) -> Option<Self> {
        let (orders, taken) = mpsc::channel();
        let mut prefetch = Self {
            ordered: VecDeque::new(),
            orders,
            next_to_order: first,
            stopped: Arc::default(),
            workers: Vec::new(),
        };
        (0..LOOK_AHEAD_PER_WORKER * workers).for_each(|_| prefetch.order());
        let taken = Arc::new(Mutex::new(taken));
        prefetch.workers.extend((0..workers).map_while(|worker| {
            let (taken, stopped, mut make) =
                (taken.clone(), prefetch.stopped.clone(), make.clone());
            let name = format!("loader-{worker}");
            let thread = thread::Builder::new().name(name);
            thread.spawn(move || work(&taken, &stopped, &mut make)).ok()
        }));
        (!prefetch.workers.is_empty()).then_some(prefetch)
    }

    /// Orders one more value.
    fn order(&mut self) {
        let (place, arrival) = mpsc::sync_channel(1);
        // Fails without workers.
        let _ = self.orders.send((self.next_to_order, place));
        self.ordered.push_back(arrival);
        self.next_to_order += 1;
    }

    /// The next value; `None` if `stop` becomes true during the wait.
    pub fn next_unless(&mut self, stop: &dyn Fn() -> bool) -> Option<T> {
        let mut wait = Duration::ZERO;
        let made = loop {
            match self.ordered[0].recv_timeout(wait) {
                Ok(made) => break made,
                Err(RecvTimeoutError::Disconnected) => unreachable!("workers pass panics on"),
                Err(RecvTimeoutError::Timeout) if stop() => return None,
                Err(RecvTimeoutError::Timeout) => wait = STOP_INTERVAL,
            }
        };
        self.ordered.pop_front();
        self.order();
        Some(made.unwrap_or_else(|panic| resume_unwind(panic)))
    }
}

/// Computes requested values until stopped. The consumer resumes the panics of workers.
fn work<T>(
    orders: &Mutex<Receiver<Order<T>>>,
    stopped: &AtomicBool,
    make: &mut impl FnMut(u64) -> T,
) {
    // No code under the lock panics.
    let next = || orders.lock().unwrap_or_else(PoisonError::into_inner).recv();
    while let Ok((number, place)) = next()
        && !stopped.load(Ordering::Relaxed)
    {
        // Sending fails if the consumer no longer waits.
        let _ = place.send(catch_unwind(AssertUnwindSafe(|| make(number))));
    }
}

impl<T> Drop for Prefetch<T> {
    fn drop(&mut self) {
        self.stopped.store(true, Ordering::Relaxed);
        // Closing the channel ends the waiting workers.
        self.orders = mpsc::channel().0;
        let deadline = Instant::now() + PATIENCE;
        for worker in self.workers.drain(..) {
            while !worker.is_finished() && Instant::now() < deadline {
                thread::sleep(Duration::from_millis(1));
            }
            // A worker that waits for a network ends later, or with the process.
            if worker.is_finished() {
                // Panics were caught.
                let _ = worker.join();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU64;

    fn next<T: Send + 'static>(prefetch: &mut Prefetch<T>) -> T {
        prefetch.next_unless(&|| false).expect("it never stops")
    }

    #[test]
    fn who_asks_to_stop_does_not_wait() {
        let mut prefetch =
            Prefetch::start(1, 0, |_| thread::sleep(Duration::from_secs(4))).unwrap();
        let started = Instant::now();
        let waited = || started.elapsed() > Duration::from_millis(50);
        assert_eq!(prefetch.next_unless(&waited), None);
        drop(prefetch);
        assert!(started.elapsed() < Duration::from_secs(4));
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
        let owned = Arc::clone(&alive);
        let mut prefetch = Prefetch::start(4, 0, move |number| {
            let _owned = &owned;
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
