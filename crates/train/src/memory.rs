//! Memory that work takes, estimated before anything is built.

use rustix::process::{Resource, getrlimit};
use sysinfo::{MemoryRefreshKind, ProcessRefreshKind, ProcessesToUpdate, RefreshKind, System};

use crate::config::Config;
use crate::error::Error;

/// Bytes of a number.
const NUMBER: u64 = 4;

/// What the networks of a run take in training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Numbers of all parameters, adapters included.
    pub parameters: u64,
    /// Numbers that the backward pass keeps of one item of a batch inside of the networks, roughly.
    pub activations: u64,
    /// Numbers of one item: motion and conditions.
    pub item: u64,
}

/// What is made of an item's numbers around the networks: noise, noisy motion, the windows of the
/// first convolution, predictions, losses, in the end the motion's joints.
const COPIES_OF_ITEM: u64 = 16;

impl Footprint {
    /// Bytes of main memory that training takes, roughly; `on_host` where the CPU trains, so that
    /// gradients and activations are there too.
    pub fn of_training(self, config: &Config, on_host: bool) -> u64 {
        // Weights, their average, two moments, and what is copied of them for a checkpoint; where
        // the CPU trains, gradients too.
        let copies = if on_host { 7 } else { 6 };
        let parameters = self.parameters.saturating_mul(copies * NUMBER);
        let items = match on_host {
            true => config.data.batch_size.max(config.validation.batch_size),
            false => 0,
        };
        let an_item = self.kept(true);
        parameters
            .saturating_add(an_item.saturating_mul(items as u64))
            .saturating_add(config.data.memory())
    }

    /// Bytes of main memory that it takes to draw `items` clips at a time, roughly; `guided`
    /// towards goals, which differentiates the network.
    pub fn of_sampling(self, items: usize, guided: bool) -> u64 {
        let parameters = self.parameters.saturating_mul(3 * NUMBER);
        parameters.saturating_add(self.kept(guided).saturating_mul(items as u64))
    }

    /// Bytes of one item, with the activations of a backward pass or of as many layers as are in
    /// use at a time.
    fn kept(self, with_gradients: bool) -> u64 {
        // Half as much again for what comes and goes.
        let halves = if with_gradients { 3 } else { 1 };
        let inside = self.activations.saturating_mul(halves * NUMBER) / 2;
        let around = self.item.saturating_mul(COPIES_OF_ITEM * NUMBER);
        inside.saturating_add(around)
    }
}

/// Bytes of main memory that are free: of the machine, of the process's control group and below
/// the limit of its addresses, whichever is least; nothing where that cannot be told.
pub fn available() -> Option<u64> {
    let memory = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
    let mut machine = System::new_with_specifics(memory);
    let free = Some(machine.available_memory()).filter(|free| *free > 0);
    let group = machine.cgroup_limits().map(|limits| limits.free_memory);
    let addresses = getrlimit(Resource::As).current.map(|limit| {
        let process = sysinfo::get_current_pid().ok().and_then(|own| {
            let refresh = ProcessRefreshKind::nothing().with_memory();
            machine.refresh_processes_specifics(ProcessesToUpdate::Some(&[own]), false, refresh);
            machine.process(own)
        });
        limit.saturating_sub(process.map_or(0, |process| process.virtual_memory()))
    });
    free.into_iter().chain(group).chain(addresses).min()
}

/// Rejects `work` that needs more memory than is free.
///
/// # Errors
/// [`Error::Usage`] with both figures.
pub fn must_fit(work: &str, needed: u64, hint: &str) -> Result<(), Error> {
    match available() {
        Some(free) if needed > free => Err(Error::usage(
            format!(
                "{work} needs about {}, {} of memory are free",
                gibibytes(needed),
                gibibytes(free)
            ),
            hint,
        )),
        _ => Ok(()),
    }
}

/// A number of bytes for people: `3.5 GiB`.
pub fn gibibytes(bytes: u64) -> String {
    format!("{:.1} GiB", bytes as f64 / (1 << 30) as f64)
}
