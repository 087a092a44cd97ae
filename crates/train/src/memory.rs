//! Memory estimates before networks are built.

use burn::module::Module;
use kinegrad_models::parameters;
use rustix::process::{Resource, getrlimit};
use sysinfo::{MemoryRefreshKind, ProcessRefreshKind, ProcessesToUpdate, RefreshKind, System};

use crate::config::Config;
use crate::error::Error;

/// Bytes per number.
const NUMBER: u64 = 4;

/// The training memory of a run's networks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Numbers of all parameters, adapters included.
    pub parameters: u64,
    /// Estimated numbers that the backward pass stores per item and pass.
    pub activations: u64,
    /// Passes that the backward pass stores at a time.
    pub passes: u64,
    /// Numbers of one item: motion and conditions.
    pub item: u64,
    /// Numbers that the items of a batch share, without parameters.
    pub shared: u64,
}

/// Copies of an item's numbers outside the networks: noise, noisy motion, the windows of the first
/// convolution, predictions, losses, and joints.
const COPIES_OF_ITEM: u64 = 16;

/// Copies of an item's numbers without losses and gradients, measured on the UNet of phrases.
const COPIES_WITHOUT_LOSS: u64 = 4;

/// One part in this many of the stored activations is in use at a time without a backward pass, as
/// measured on a UNet of one level. Deep UNets need half.
const PARTS_OF_ACTIVATIONS: u64 = 4;

/// Tenths of the activations that checkpointing stores, at most: 3 to 4 were measured on UNets of
/// phrases (`examples/activation_memory.rs` there).
const CHECKPOINTED_TENTHS: u64 = 5;

impl Footprint {
    /// The footprint of one pass through `network`, without shared numbers.
    pub fn of<M: Module>(network: &M, activations: u64, item: usize) -> Self {
        Self {
            parameters: parameters::count(network) as u64,
            activations,
            passes: 1,
            item: item as u64,
            shared: 0,
        }
    }

    /// The footprint with activation checkpointing, if it `is` used, of a network whose blocks compute
    /// activations again.
    #[must_use]
    pub fn checkpointed(self, is: bool) -> Self {
        let activations = match is {
            true => self.activations / 10 * CHECKPOINTED_TENTHS,
            false => self.activations,
        };
        Self {
            activations,
            ..self
        }
    }

    /// Estimated main memory for training, bytes; `on_host` if the CPU trains.
    pub fn of_training(self, config: &Config, on_host: bool) -> u64 {
        // Weights, moving average, two moments, a checkpoint's copy of the weights and, on the
        // host, gradients.
        let copies = if on_host { 6 } else { 5 };
        let parameters = self.parameters.saturating_mul(copies * NUMBER);
        let of_items = |items: usize, each: u64| each.saturating_mul(items as u64);
        let items = match on_host {
            true => of_items(config.data.batch_size, self.of_item(true))
                .max(of_items(config.validation.batch_size, self.of_item(false))),
            false => 0,
        };
        parameters
            .saturating_add(items)
            .saturating_add(if on_host { self.of_shared() } else { 0 })
            .saturating_add(config.data.memory())
    }

    /// Additional bytes of main memory for the gradients that a rank sends and receives.
    pub fn of_exchange(self) -> u64 {
        self.parameters.saturating_mul(2 * NUMBER)
    }

    /// Estimated main memory for sampling `items` at a time, bytes; `guided` sampling
    /// differentiates the network; `on_host` if the CPU samples.
    pub fn of_sampling(self, items: usize, guided: bool, on_host: bool) -> u64 {
        let parameters = self.parameters.saturating_mul(3 * NUMBER);
        let inside = match (on_host, guided) {
            (false, _) => 0,
            (true, true) => self.of_gradients(),
            (true, false) => self.activations.saturating_mul(NUMBER) / PARTS_OF_ACTIVATIONS,
        };
        let copies = match guided {
            true => COPIES_OF_ITEM,
            false => COPIES_WITHOUT_LOSS,
        };
        let around = self.item.saturating_mul(copies * NUMBER);
        inside
            .saturating_add(around)
            .saturating_mul(items as u64)
            .saturating_add(parameters)
            .saturating_add(self.of_shared())
    }

    fn of_shared(self) -> u64 {
        self.shared.saturating_mul(NUMBER)
    }

    /// Bytes of one item, with the activations of a backward pass or of the layers in use at a
    /// time.
    fn of_item(self, with_gradients: bool) -> u64 {
        let inside = match with_gradients {
            true => self.of_gradients(),
            false => self.activations.saturating_mul(NUMBER) / 2,
        };
        let around = self.item.saturating_mul(COPIES_OF_ITEM * NUMBER);
        inside.saturating_add(around)
    }

    /// Bytes that the backward pass stores per item.
    fn of_gradients(self) -> u64 {
        // Temporary memory adds another half.
        self.activations.saturating_mul(3 * self.passes * NUMBER) / 2
    }
}

/// Main memory available to this process, bytes: the minimum of free memory, the control group's
/// limit and the remaining address space; `None` if unknown.
pub fn available() -> Option<u64> {
    let memory = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
    let mut machine = System::new_with_specifics(memory);
    let free = Some(machine.available_memory()).filter(|free| *free > 0);
    // Part of the group's usage is cached files, which can be freed.
    let group = machine.cgroup_limits().map(|limits| limits.total_memory);
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

/// Main memory of this process, code and stacks included; `None` if unknown.
pub fn taken() -> Option<Taken> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let kibibytes = |key: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(key))?;
        line.split_whitespace().next()?.parse::<u64>().ok()
    };
    Some(Taken {
        most: kibibytes("VmHWM:")? << 10,
        now: kibibytes("VmRSS:")? << 10,
    })
}

/// Bytes of main memory of this process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Taken {
    /// Peak so far.
    pub most: u64,
    /// Now.
    pub now: u64,
}

/// Work is always tried if its estimate is at most this large, because estimates are inexact.
const SMALL: u64 = 256 << 20;

/// Rejects `work` that needs more memory than is free.
///
/// # Errors
/// [`Error::Usage`] with both figures.
pub fn must_fit(work: &str, needed: u64, hint: &str) -> Result<(), Error> {
    match available() {
        Some(free) if needed > free.max(SMALL) => Err(Error::usage(
            format!(
                "{work} needs about {}, {} of memory are free",
                size(needed),
                size(free)
            ),
            hint,
        )),
        _ => Ok(()),
    }
}

/// Formats a number of bytes: `120 MiB`, `3.5 GiB`.
pub fn size(bytes: u64) -> String {
    let mebibytes = bytes as f64 / f64::from(1 << 20);
    match mebibytes < 1000.0 {
        true => format!("{mebibytes:.0} MiB"),
        false => format!("{:.1} GiB", mebibytes / 1024.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::plain;

    #[test]
    fn sizes_are_for_people() {
        assert_eq!(size(3 << 20), "3 MiB");
        assert_eq!(size(7 << 29), "3.5 GiB");
    }

    #[test]
    fn what_is_small_is_tried_and_what_no_machine_has_is_not() {
        must_fit("this", SMALL, "").expect("little");
        let error = must_fit("this", 1 << 60, "").expect_err("too much");
        assert!(
            error
                .to_string()
                .starts_with("this needs about 1073741824.0 GiB")
        );
    }

    #[test]
    fn validation_keeps_no_gradients_and_each_batch_counts() {
        let parse = |text: &str| plain(text, &[]);
        let [little, batch, validation] = [
            "",
            "[data]\nbatch_size = 64",
            "[validation]\nbatch_size = 64",
        ]
        .map(|text| {
            let mut config = parse(text);
            config.data.num_workers = 0;
            if !text.starts_with("[data]") {
                config.data.batch_size = 1;
            }
            if !text.starts_with("[validation]") {
                config.validation.batch_size = 1;
            }
            let footprint = Footprint {
                parameters: 1000,
                activations: 1_000_000,
                passes: 10,
                item: 0,
                shared: 0,
            };
            footprint.of_training(&config, true)
        });
        assert!(batch > 60 * (little / 2), "{batch}, {little}");
        assert!(validation < batch / 20, "{validation}, {batch}");
    }
}
