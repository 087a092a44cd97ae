//! The estimate that `kinegrad train --dry-run` prints.

use kinegrad_report::{facts, grouped};
use kinegrad_settings::{counted, plural};
use kinegrad_train::memory::size;
use kinegrad_train::run::Plan as Estimate;

use crate::output;
use crate::progress::duration;

/// The text after the time for all steps.
fn validations(estimate: &Estimate) -> String {
    match (estimate.validations, estimate.validation_seconds) {
        (0, _) => ", without checkpoints".to_string(),
        (_, None) => ", without validations and checkpoints".to_string(),
        (1, Some(seconds)) => format!(" and a validation of {seconds:.3} s, without checkpoints"),
        (several, Some(seconds)) => {
            let several = grouped(several as usize);
            format!(" and {several} validations of {seconds:.3} s, without checkpoints")
        }
    }
}

/// Prints an estimate, for people or as JSON.
pub fn print(estimate: &Estimate, json: bool) {
    if json {
        return output::json(estimate);
    }
    let [train, held_out] = [estimate.train_items, estimate.validation_items].map(grouped);
    let mut items = format!("{train} to train on, {held_out} held out");
    if estimate.skipped_items > 0 {
        let skipped = grouped(estimate.skipped_items);
        items.push_str(&format!(", {skipped} skipped as unusable"));
    }
    let mut memory = format!("about {}", size(estimate.memory_bytes));
    if let Some(free) = estimate.free_memory_bytes {
        memory.push_str(&format!("; {} are free", size(free)));
    }
    let left = estimate.max_steps.saturating_sub(estimate.step) as usize;
    let needed = duration(estimate.training_seconds);
    let (step, time) = match estimate.step_seconds {
        Some(seconds) => (
            format!("{seconds:.3} s (mean of {})", estimate.measured_steps),
            format!(
                "about {needed} for {} {}{}",
                grouped(left),
                plural(left, "step"),
                validations(estimate)
            ),
        ),
        None => ("not measured".into(), "nothing left to train".into()),
    };
    let [all, each] = [estimate.disk_bytes, estimate.checkpoint_bytes].map(size);
    let mut disk = format!(
        "about {all}: {} of {each}",
        counted(estimate.checkpoints as usize, "checkpoint")
    );
    if estimate.samples_bytes > 0 {
        disk.push_str(&format!(", samples of {}", size(estimate.samples_bytes)));
    }
    let batch = format!(
        "{} of {}",
        estimate.batch_size,
        counted(estimate.frames, "frame")
    );
    let rows = [
        ("run", estimate.folder.display().to_string()),
        ("recipe", estimate.recipe.clone()),
        ("device", estimate.device.clone()),
        ("model", output::parameters(&estimate.parameters)),
        ("dataset", items),
        ("batch", batch),
        ("memory", memory),
        ("time for a step", step),
        ("time for all", time),
        ("disk", disk),
    ];
    show!("{}", facts(rows));
    tell!("dry run: nothing was written");
}
