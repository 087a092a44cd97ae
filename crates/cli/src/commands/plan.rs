//! What `kinegrad train --dry-run` prints.

use kinegrad_report::{facts, grouped};
use kinegrad_train::memory::size;
use kinegrad_train::run::Plan;

use crate::output;
use crate::progress::duration;

/// What the time of a plan includes beside its steps.
fn counted(plan: &Plan) -> String {
    match (plan.validations, plan.validation_seconds) {
        (0, _) => ", without checkpoints".to_string(),
        (_, None) => ", without validations and checkpoints".to_string(),
        (1, Some(seconds)) => format!(" and a validation of {seconds:.3} s, without checkpoints"),
        (several, Some(seconds)) => {
            let several = grouped(several as usize);
            format!(" and {several} validations of {seconds:.3} s, without checkpoints")
        }
    }
}

/// Prints a plan, for people or as JSON.
pub fn print(plan: &Plan, json: bool) {
    if json {
        return output::json(plan);
    }
    let mut items = format!(
        "{} to train on, {} held out",
        grouped(plan.train_items),
        grouped(plan.validation_items)
    );
    if plan.skipped_items > 0 {
        items.push_str(&format!(
            ", {} skipped as unusable",
            grouped(plan.skipped_items)
        ));
    }
    let memory = match plan.free_memory_bytes {
        Some(free) => format!("about {}; {} are free", size(plan.memory_bytes), size(free)),
        None => format!("about {}", size(plan.memory_bytes)),
    };
    let left = plan.max_steps.saturating_sub(plan.step);
    let (step, time) = match plan.step_seconds {
        Some(seconds) => (
            format!("{seconds:.3} s (mean of {})", plan.measured_steps),
            format!(
                "about {} for {} steps{}",
                duration(plan.training_seconds),
                grouped(left as usize),
                counted(plan)
            ),
        ),
        None => ("not measured".into(), "nothing left to train".into()),
    };
    let mut disk = format!(
        "about {}: {} checkpoints of {}",
        size(plan.disk_bytes),
        plan.checkpoints,
        size(plan.checkpoint_bytes)
    );
    if plan.samples_bytes > 0 {
        disk.push_str(&format!(", samples of {}", size(plan.samples_bytes)));
    }
    let batch = format!("{} of {} frames", plan.batch_size, plan.frames);
    let rows = [
        ("run", plan.folder.display().to_string()),
        ("recipe", plan.recipe.clone()),
        ("device", plan.device.clone()),
        ("model", output::parameters(&plan.parameters)),
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
