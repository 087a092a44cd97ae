//! Facts about a run.

use std::fs;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use kinegrad_report::grouped;
use kinegrad_report::page::{Cell, Table, Tone};
use kinegrad_settings::{counted, plural};
use kinegrad_train::checkpoint::Checkpoints;
use kinegrad_train::memory::size;
use kinegrad_train::run::{PREVIEWS, SAMPLES};
use kinegrad_train::telemetry::{Environment, Record};

use super::curves::training_seconds;
use crate::progress::duration;
use crate::runs::{Run, RunStatus, complete_state};

type Fact = (String, String);

fn fact(name: &str, value: impl Into<String>) -> Fact {
    (name.to_string(), value.into())
}

/// The main facts.
pub fn highlights(run: &Run, records: &[Record], last: Option<&Environment>) -> Vec<Fact> {
    let mut facts = vec![fact("steps", run.steps(|step| grouped(step as usize)))];
    if let Some(best) = &run.best {
        let value = format!("{:.4} {}", best.val_loss, best_step(best.step));
        facts.push(fact("best validation loss", value));
    } else if let Some(loss) = records.iter().rev().find_map(|r| r.get("loss")) {
        facts.push(fact("last training loss", format!("{loss:.5}")));
    }
    let seconds = training_seconds(records);
    if seconds > 0.0 {
        facts.push(fact("from first to last step", duration(seconds)));
        let speed = records.iter().rev();
        let speed = speed.filter_map(|r| r.get("steps_per_second")).next();
        if let (Some(speed), true) = (speed, run.status == RunStatus::Training) {
            let done = run.step.unwrap_or(0);
            let left = run.max_steps().map_or(0, |all| all.saturating_sub(done));
            facts.push(fact("time left", duration(left as f64 / speed.max(1e-9))));
        }
    }
    if let Some(environment) = last {
        facts.push(fact("parameters", grouped(environment.parameters)));
        facts.push(fact("device", environment.device.clone()));
    }
    facts.push(fact("size on disk", size(run.bytes)));
    facts
}

/// The moment of the best validation.
fn best_step(step: u64) -> String {
    match step {
        0 => "before training, no step was better".to_string(),
        _ => format!("at {}", grouped(step as usize)),
    }
}

/// Machine and versions of the last start, or of the newest checkpoint.
pub fn machine(run: &Run, last: Option<&Environment>) -> Vec<Fact> {
    let Some(last) = last else {
        let state = run.newest.as_ref().map(|(_, state)| state);
        let version = state.map(|state| fact("kinegrad", state.kinegrad.clone()));
        let unknown = "not recorded: the run was imported, merged, or made by an older version";
        let device = fact("hardware", unknown);
        return version.into_iter().chain([device]).collect();
    };
    let device = match &last.accelerator {
        Some(name) => format!("{} ({name})", last.device),
        None => last.device.clone(),
    };
    let mut facts = vec![
        fact("kinegrad", last.kinegrad.clone()),
        fact("Burn", last.burn.clone()),
        fact("device", device),
        fact("CPU", format!("{}, {} cores", last.cpu, last.cores)),
        fact("memory", size(last.memory_bytes)),
        fact("system", last.system.clone()),
        fact("started", date(last.time)),
    ];
    facts.retain(|(_, value)| !value.is_empty());
    facts
}

/// One row per start.
pub fn starts(environments: &[Environment]) -> Table {
    const HEADER: [&str; 6] = [
        "started",
        "after step",
        "kinegrad",
        "device",
        "CPU",
        "cores",
    ];
    let row = |start: &Environment| {
        let cells = [
            date(start.time),
            start.step.to_string(),
            start.kinegrad.clone(),
            start.device.clone(),
            start.cpu.clone(),
            start.cores.to_string(),
        ];
        cells.map(Cell::from).to_vec()
    };
    Table {
        header: HEADER.map(String::from).to_vec(),
        rows: environments.iter().map(row).collect(),
    }
}

/// The training data.
pub fn data(run: &Run, last: Option<&Environment>) -> Vec<Fact> {
    let mut facts = Vec::new();
    if let Some(config) = &run.config {
        let kind = serde_json::to_value(config.data.kind).unwrap_or_default();
        facts.push(fact("kind", kind.as_str().unwrap_or_default()));
        let source = config.data.source.clone();
        facts.extend(source.map(|source| fact("source", source)));
        let frames = config.data.target_frames.to_string();
        facts.push(fact("frames of an item", frames));
        facts.push(fact("batch size", config.data.batch_size.to_string()));
    }
    if let Some(last) = last {
        facts.push(fact("trained on", grouped(last.train_items)));
        facts.push(fact("held out", grouped(last.validation_items)));
        if last.skipped_items > 0 {
            facts.push(fact("skipped as unusable", grouped(last.skipped_items)));
        }
    }
    if let Some((_, state)) = &run.newest {
        let sha256 = state.dataset_sha256.clone();
        facts.extend(sha256.map(|sha256| fact("SHA-256", sha256)));
        let counts = [
            (state.statistics.items, "item"),
            (state.statistics.frames, "frame"),
        ];
        let [items, frames] =
            counts.map(|(count, noun)| format!("{} {}", grouped(count), plural(count, noun)));
        let statistics = format!("of {items} with {frames}");
        facts.push(fact("statistics", statistics));
    }
    facts
}

/// One row per checkpoint.
pub fn checkpoints(run: &Run) -> Table {
    let checkpoints = Checkpoints::of(&run.folder);
    let steps = checkpoints.steps().unwrap_or_default();
    let best = run.best.as_ref().map(|best| best.step);
    let row = |step: u64| {
        let path = checkpoints.step_path(step);
        let state = complete_state(&path);
        if state.is_err() && !path.exists() {
            return None;
        }
        let files = fs::read_dir(&path).into_iter().flatten().flatten();
        let bytes = files
            .flat_map(|file| file.metadata())
            .map(|file| file.len());
        let written = fs::metadata(&path).and_then(|metadata| metadata.modified());
        let (verdict, tone) = match state {
            Ok(_) if best == Some(step) => ("best", Tone::Good),
            Ok(_) => ("", Tone::Plain),
            Err(_) => ("damaged", Tone::Bad),
        };
        Some(vec![
            Cell::from(grouped(step as usize)),
            Cell::from(size(bytes.sum())),
            Cell::from(written.map(moment).unwrap_or_default()),
            Cell::new(verdict, tone),
        ])
    };
    Table {
        header: ["step", "size", "written", ""].map(String::from).to_vec(),
        rows: steps.into_iter().filter_map(row).collect(),
    }
}

/// The run's folder.
pub fn files(run: &Run) -> Vec<Fact> {
    let mut facts = vec![fact("folder", run.folder.display().to_string())];
    for (name, folder) in [("samples", SAMPLES), ("previews", PREVIEWS)] {
        let count = fs::read_dir(run.folder.join(folder)).map_or(0, Iterator::count);
        if count > 0 {
            facts.push(fact(
                name,
                format!("{} in {folder}", counted(count, "file")),
            ));
        }
    }
    facts
}

fn moment(time: SystemTime) -> String {
    let since = time.duration_since(UNIX_EPOCH);
    date(since.unwrap_or(Duration::ZERO).as_secs_f64())
}

/// Seconds since 1970 as a date in UTC, such as `2026-11-23 21:07 UTC`.
fn date(seconds: f64) -> String {
    let minutes = (seconds / 60.0).max(0.0) as u64;
    let (days, minutes) = ((minutes / 1440) as i64, minutes % 1440);
    // Years begin in March, in cycles of 400 years (Howard Hinnant's algorithm).
    let shifted = days + 719_468;
    let (cycle, day) = (shifted / 146_097, shifted % 146_097);
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let date = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + 400 * cycle + i64::from(month <= 2);
    let (hour, minute) = (minutes / 60, minutes % 60);
    format!("{year}-{month:02}-{date:02} {hour:02}:{minute:02} UTC")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_know_leap_years() {
        for (seconds, shown) in [
            (0.0, "1970-01-01 00:00 UTC"),
            (951_827_696.0, "2000-02-29 12:34 UTC"),
            (1_709_251_199.0, "2024-02-29 23:59 UTC"),
            (1_735_689_600.0, "2025-01-01 00:00 UTC"),
        ] {
            assert_eq!(date(seconds), shown);
        }
    }
}
