//! A training that is stopped before its first step.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use kinegrad_systems::BUILT_IN;
use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS};
use kinegrad_train::run::{Target, TrainRequest, train};
use kinegrad_train::{Error, Observer, Reading, RunSummary, StepReport};

/// Stops after a number of items read, including those read for statistics.
struct Stopping {
    after: usize,
    read: Arc<AtomicUsize>,
}

impl Observer for Stopping {
    fn started(&mut self, _: &RunSummary) {
        panic!("it was stopped before");
    }
    fn stepped(&mut self, _: &StepReport) {}
    fn validated(&mut self, _: u64, _: f64, _: bool) {}
    fn saved(&mut self, _: &Path) {}
    fn note(&mut self, _: &str) {}
    fn warning(&mut self, _: &str) {}
    fn reading(&self) -> Box<Reading> {
        let (after, read) = (self.after, self.read.clone());
        Box::new(
            move |_, _| match read.fetch_add(1, Ordering::SeqCst) < after {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            },
        )
    }
    fn stop_requested(&self) -> bool {
        false
    }
}

#[test]
fn a_stop_while_items_are_read_or_measured_leaves_nothing() {
    for config in [SMALLEST, SMALLEST_WALKS] {
        // 12 items; 14 calls open the dataset, so the second stop is during its statistics.
        for after in [5, 17] {
            let folder = tempfile::tempdir().expect("a folder");
            let path = folder.path().join("c.toml");
            std::fs::write(&path, config).expect("a config");
            let request = TrainRequest {
                target: Target::New(path),
                overrides: Vec::new(),
                environment: Vec::new(),
                runs_dir: folder.path().join("runs"),
                dry_run: false,
            };
            let mut observer = Stopping {
                after,
                read: Arc::default(),
            };
            let stopped = train(BUILT_IN, &request, &mut observer).expect_err("a stop");
            assert!(matches!(stopped, Error::Interrupted), "{stopped}");
            assert_eq!(stopped.exit_code(), 130);
            assert!(observer.read.load(Ordering::SeqCst) < after + 8);
            assert!(!folder.path().join("runs").exists());
        }
    }
}
