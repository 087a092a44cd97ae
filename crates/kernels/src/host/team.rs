//! Threads that spin while they wait for the next kernel.
//!
//! A training step consists of some thousand short parallel sections. Sleeping and waking would
//! take longer than many sections, so helpers spin for a moment before they sleep. Rayon sets the
//! number of threads.

use std::cell::UnsafeCell;
use std::hint::spin_loop;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, TryLockError};
use std::thread::{self, Thread};

/// Number of checks for the next section before a helper sleeps, which take some hundred
/// microseconds.
const SPINS: u32 = 4000;

/// The number of a section in the upper half of the state.
const SECTION: u32 = 32;
/// Flag: helpers may still enter the section.
const OPEN: u64 = 1 << 31;
/// Mask: number of helpers in the section.
const INSIDE: u64 = OPEN - 1;

/// The work of a section.
#[derive(Clone, Copy)]
struct Job {
    work: &'static (dyn Fn(usize) + Sync),
    tasks: usize,
    /// Number of helpers that take part.
    helpers: usize,
}

struct Shared {
    /// Number of the section, [`OPEN`], and the number of helpers inside.
    state: AtomicU64,
    job: UnsafeCell<Option<Job>>,
    next: AtomicUsize,
    panicked: AtomicBool,
}

// SAFETY: only the holder of the team's lock writes `job`, while the section is closed and no
// helper inside. Only helpers inside an open section read `job`. Entering and leaving go through
// `state` with acquire and release order.
#[allow(unsafe_code)]
unsafe impl Sync for Shared {}

struct Helper {
    thread: Thread,
    asleep: Arc<AtomicBool>,
}

struct Team {
    shared: &'static Shared,
    helpers: Mutex<Vec<Helper>>,
}

/// Runs `work(0)` to `work(tasks - 1)` once each, on this thread and the helpers, and returns when
/// all are done. Inside another section, or while another thread uses the helpers, all tasks run on
/// this thread.
///
/// # Panics
/// Panics if a task does.
pub(crate) fn for_each(tasks: usize, work: impl Fn(usize) + Sync) {
    let helpers = rayon::current_num_threads().min(tasks).saturating_sub(1);
    if helpers == 0 {
        return (0..tasks).for_each(work);
    }
    let team = team();
    let guard = match team.helpers.try_lock() {
        Ok(guard) => Some(guard),
        Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
        Err(TryLockError::WouldBlock) => None,
    };
    let Some(mut crew) = guard else {
        (0..tasks).for_each(work);
        return;
    };
    while crew.len() < helpers {
        let index = crew.len();
        crew.push(Helper::spawn(index, team.shared));
    }
    team.shared.run(&work, tasks, helpers, &crew);
}

/// [`for_each`] over items, one task per item.
pub(crate) fn for_each_item<T: Send>(items: Vec<T>, work: impl Fn(T) + Sync) {
    let slots: Vec<Mutex<Option<T>>> = items.into_iter().map(|i| Mutex::new(Some(i))).collect();
    for_each(slots.len(), |index| {
        let item = slots[index]
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        work(item.expect("one task an item"));
    });
}

/// The results of `work(0)` to `work(tasks - 1)`, in this order.
pub(crate) fn map<T: Send>(tasks: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let slots: Vec<Mutex<Option<T>>> = (0..tasks).map(|_| Mutex::new(None)).collect();
    for_each(tasks, |index| {
        let result = work(index);
        *slots[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
    });
    let taken = slots
        .into_iter()
        .map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner));
    taken
        .map(|result| result.expect("every task has run"))
        .collect()
}

/// The process's team; helpers start when they are first needed.
fn team() -> &'static Team {
    static TEAM: OnceLock<Team> = OnceLock::new();
    TEAM.get_or_init(|| Team {
        shared: Box::leak(Box::new(Shared {
            state: AtomicU64::new(0),
            job: UnsafeCell::new(None),
            next: AtomicUsize::new(0),
            panicked: AtomicBool::new(false),
        })),
        helpers: Mutex::new(Vec::new()),
    })
}

impl Shared {
    /// Opens a section, runs its tasks, closes it and waits for the helpers inside.
    fn run(&self, work: &(dyn Fn(usize) + Sync), tasks: usize, helpers: usize, crew: &[Helper]) {
        // SAFETY: the reference leaves this function only in `job`, which helpers read only inside
        // the section; before this function returns or unwinds, the section is closed and empty.
        #[allow(unsafe_code)]
        let work = unsafe {
            std::mem::transmute::<&(dyn Fn(usize) + Sync), &'static (dyn Fn(usize) + Sync)>(work)
        };
        let job = Job {
            work,
            tasks,
            helpers,
        };
        // SAFETY: the caller holds the team's lock, and the previous section was closed and empty.
        #[allow(unsafe_code)]
        unsafe {
            *self.job.get() = Some(job);
        }
        self.next.store(0, Ordering::Relaxed);
        self.panicked.store(false, Ordering::Relaxed);
        let section = (self.state.load(Ordering::Relaxed) >> SECTION).wrapping_add(1);
        self.state
            .store(section << SECTION | OPEN, Ordering::SeqCst);
        for helper in &crew[..helpers] {
            if helper.asleep.load(Ordering::SeqCst) {
                helper.thread.unpark();
            }
        }
        let mine = catch_unwind(AssertUnwindSafe(|| self.work_off(job)));
        self.state.fetch_and(!OPEN, Ordering::AcqRel);
        let mut spins = 0;
        while self.state.load(Ordering::Acquire) & INSIDE != 0 {
            spins += 1;
            if spins < SPINS {
                spin_loop();
            } else {
                // The helper may wait for this core.
                thread::yield_now();
            }
        }
        if let Err(panic) = mine {
            resume_unwind(panic);
        }
        assert!(
            !self.panicked.load(Ordering::Relaxed),
            "a helper's task panicked"
        );
    }

    fn work_off(&self, job: Job) {
        loop {
            let task = self.next.fetch_add(1, Ordering::Relaxed);
            if task >= job.tasks {
                return;
            }
            (job.work)(task);
        }
    }

    /// Enters section `section` if it is still open; the job is then valid until `leave`.
    fn enter(&self, section: u64) -> Option<Job> {
        let open = |state: u64| state >> SECTION == section && state & OPEN != 0;
        self.state
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, |state| {
                open(state).then_some(state + 1)
            })
            .ok()?;
        // SAFETY: inside an open section the job is not written.
        #[allow(unsafe_code)]
        unsafe {
            *self.job.get()
        }
    }

    fn leave(&self) {
        self.state.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Helper {
    fn spawn(index: usize, shared: &'static Shared) -> Self {
        let asleep = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&asleep);
        let thread = thread::Builder::new()
            .name(format!("kernels-{index}"))
            .spawn(move || help(index, shared, &flag))
            .expect("a thread");
        Self {
            thread: thread.thread().clone(),
            asleep,
        }
    }
}

/// Loop of a helper thread.
fn help(index: usize, shared: &Shared, asleep: &AtomicBool) {
    let mut seen = 0;
    loop {
        let state = wait(shared, asleep, seen);
        seen = state >> SECTION;
        let Some(job) = shared.enter(seen) else {
            continue;
        };
        if index < job.helpers && catch_unwind(AssertUnwindSafe(|| shared.work_off(job))).is_err() {
            shared.panicked.store(true, Ordering::Relaxed);
        }
        shared.leave();
    }
}

/// Waits for a section after `seen`: first spinning, then asleep.
fn wait(shared: &Shared, asleep: &AtomicBool, seen: u64) -> u64 {
    loop {
        for _ in 0..SPINS {
            let state = shared.state.load(Ordering::Acquire);
            if state >> SECTION != seen && state & OPEN != 0 {
                return state;
            }
            spin_loop();
        }
        asleep.store(true, Ordering::SeqCst);
        // The state is checked again after the flag is set, so that no section is missed.
        let state = shared.state.load(Ordering::SeqCst);
        if state >> SECTION == seen || state & OPEN == 0 {
            thread::park();
        }
        asleep.store(false, Ordering::SeqCst);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_threads<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> R {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool");
        pool.install(work)
    }

    #[test]
    fn every_task_runs_once() {
        with_threads(4, || {
            for tasks in [0, 1, 2, 3, 50, 1000] {
                for _ in 0..200 {
                    let counts: Vec<AtomicUsize> =
                        (0..tasks).map(|_| AtomicUsize::new(0)).collect();
                    for_each(tasks, |i| {
                        counts[i].fetch_add(1, Ordering::Relaxed);
                    });
                    assert!(counts.iter().all(|c| c.load(Ordering::Relaxed) == 1));
                }
            }
        });
    }

    #[test]
    fn sections_within_and_beside_each_other_end() {
        with_threads(3, || {
            let outer: Vec<usize> = map(8, |i| map(8, |j| i * j).into_iter().sum());
            assert_eq!(outer, (0..8).map(|i| 28 * i).collect::<Vec<_>>());
        });
        thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    with_threads(2, || {
                        for _ in 0..500 {
                            assert_eq!(map(5, |i| i), [0, 1, 2, 3, 4]);
                        }
                    });
                });
            }
        });
    }

    #[test]
    fn sleeping_helpers_wake() {
        with_threads(3, || {
            for _ in 0..20 {
                thread::sleep(std::time::Duration::from_millis(3));
                let items: Vec<usize> = (0..40).collect();
                let sum = AtomicUsize::new(0);
                for_each_item(items, |i| {
                    sum.fetch_add(i, Ordering::Relaxed);
                });
                assert_eq!(sum.into_inner(), 780);
            }
        });
    }

    #[test]
    fn a_panic_reaches_the_caller_and_the_team_continues() {
        with_threads(3, || {
            let caught = catch_unwind(|| for_each(30, |i| assert!(i != 17, "seventeen")));
            assert!(caught.is_err());
            assert_eq!(map(3, |i| i), [0, 1, 2]);
        });
    }
}
