use std::path::Path;

use burn::tensor::Device;
use kinegrad_data::file::{is_inside, read_text};
use serde::{Deserialize, Serialize};
use sysinfo::{CpuRefreshKind, MemoryRefreshKind, RefreshKind, System};

use super::appended::{Appended, now};
use crate::Error;

/// Name of the file in a run's folder.
pub(crate) const FILE: &str = "environment.jsonl";

/// Version of Burn that this build trains with.
pub const BURN: &str = "0.22.1";

/// The environment of a process that trains: one line of `environment.jsonl`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Environment {
    /// Seconds since 1970.
    pub time: f64,
    /// Steps done before.
    pub step: u64,
    /// Version of kinegrad.
    pub kinegrad: String,
    /// Version of Burn.
    pub burn: String,
    /// Device, as `run.device` names it.
    pub device: String,
    /// The device's name; `None` for a CPU.
    pub accelerator: Option<String>,
    /// Model of the CPU.
    pub cpu: String,
    /// Number of cores that the process may use.
    pub cores: usize,
    /// Main memory of the machine.
    pub memory_bytes: u64,
    /// Operating system.
    pub system: String,
    /// Number of parameters of the networks.
    pub parameters: usize,
    /// Number of items trained on.
    pub train_items: usize,
    /// Number of held-out items.
    pub validation_items: usize,
    /// Number of items left out as unusable.
    pub skipped_items: usize,
}

impl Environment {
    /// This machine and build, without the fields of a run.
    pub fn here(device: &Device, device_name: &str) -> Self {
        let refresh = RefreshKind::nothing()
            .with_cpu(CpuRefreshKind::nothing())
            .with_memory(MemoryRefreshKind::nothing().with_ram());
        let machine = System::new_with_specifics(refresh);
        let cpu = machine.cpus().first().map(|cpu| cpu.brand().trim());
        let on_host = crate::device::is_host(device_name);
        let accelerator = crate::device::hardware(device);
        Self {
            time: now(),
            kinegrad: env!("CARGO_PKG_VERSION").into(),
            burn: BURN.into(),
            device: device_name.into(),
            accelerator: accelerator.filter(|_| !on_host),
            cpu: cpu.unwrap_or_default().into(),
            cores: std::thread::available_parallelism().map_or(0, usize::from),
            memory_bytes: machine.total_memory(),
            system: System::long_os_version().unwrap_or_default(),
            ..Self::default()
        }
    }

    /// Adds the line to the run in `folder`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn record(&self, folder: &Path) -> Result<(), Error> {
        Appended::open(&folder.join(FILE))?.write_line(self)
    }
}

/// The environments of the run in `folder`, in order. Unreadable lines are skipped, and a link out of
/// the folder.
pub fn read_environments(folder: &Path) -> Vec<Environment> {
    let path = folder.join(FILE);
    let text = match is_inside(folder, &path) {
        Ok(true) => read_text(&path).unwrap_or_default(),
        _ => String::new(),
    };
    let lines = text.lines().map(serde_json::from_str);
    lines.filter_map(Result::ok).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_of_burn_is_the_one_that_is_built() {
        let manifest = include_str!("../../../../Cargo.toml");
        let expected = format!("burn = {{ version = \"={BURN}\"");
        assert!(manifest.contains(&expected), "{expected}");
    }

    #[test]
    fn each_start_is_a_line_and_damaged_lines_are_left_out() {
        let folder = tempfile::tempdir().expect("a folder");
        assert_eq!(read_environments(folder.path()), []);
        let mut first = Environment::here(&Device::flex(), "cpu");
        first.record(folder.path()).expect("written");
        let path = folder.path().join(FILE);
        let text = std::fs::read_to_string(&path).expect("text");
        std::fs::write(&path, text + "{\"time\": tw\n").expect("written");
        first.step = 7;
        first.record(folder.path()).expect("written");
        let read = read_environments(folder.path());
        assert_eq!(
            read.iter().map(|line| line.step).collect::<Vec<_>>(),
            [0, 7]
        );
        assert_eq!(read[1], first);
        assert!(first.cores > 0 && first.memory_bytes > 1 << 20);
        assert_eq!(first.accelerator, None);
    }
}
