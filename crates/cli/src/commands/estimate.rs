//! The estimate that `kinegrad train --dry-run` prints.

use kinegrad_report::{facts, grouped};
use kinegrad_train::memory::size;
use kinegrad_train::run::Plan as Estimate;

use crate::output;
use crate::progress::duration;

/// The text after the time for all steps.
fn counted(estimate: &Estimate) -> String {
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
    let items = [
        estimate.train_items,
        estimate.validation_items,
        estimate.skipped_items,
    ];
    let [train, held_out, skipped] = items.map(grouped);
    let mut items = format!("{train} to train on, {held_out} held out");
    if estimate.skipped_items > 0 {
        items.push_str(&format!(", {skipped} skipped as unusable"));
    }
    let memory = match estimate.free_memory_bytes {
        Some(free) => format!(
            "about {}; {} are free",
            size(estimate.memory_bytes),
            size(free)
        ),
        None => format!("about {}", size(estimate.memory_bytes)),
    };
    let left = estimate.max_steps.saturating_sub(estimate.step);
    let (step, time) = match estimate.step_seconds {
        Some(seconds) => (
            format!("{seconds:.3} s (mean of {})", estimate.measured_steps),
            format!(
                "about {} for {} steps{}",
                duration(estimate.training_seconds),
                grouped(left as usize),
                counted(estimate)
            ),
        ),
        None => ("not measured".into(), "nothing left to train".into()),
    };
    let mut disk = format!(
        "about {}: {} checkpoints of {}",
        size(estimate.disk_bytes),
        estimate.checkpoints,
        size(estimate.checkpoint_bytes)
    );
    if estimate.samples_bytes > 0 {
        disk.push_str(&format!(", samples of {}", size(estimate.samples_bytes)));
    }
    let batch = format!("{} of {} frames", estimate.batch_size, estimate.frames);
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
    say!("{}", facts(rows));
    tell!("dry run: nothing was written");
}
