use crate::config::{LrSchedule, OptimConfig};

/// The learning rate of optimizer step `step` (from 0) of `max_steps`: `base step / warmup` during
/// the warm-up, then the decay over the remaining steps (CC-MotionGen, section 6.3;
/// docs/sources.md, section 1.10).
pub fn learning_rate(config: &OptimConfig, base: f64, step: u64, max_steps: u64) -> f64 {
    let warmup = config.warmup_steps;
    if step < warmup {
        return base * step as f64 / warmup as f64;
    }
    let rest = max_steps.saturating_sub(warmup).max(1);
    let progress = ((step - warmup) as f64 / rest as f64).min(1.0);
    match config.lr_schedule {
        LrSchedule::Constant => base,
        LrSchedule::Linear => base * (1.0 - progress),
        LrSchedule::Cosine => base * 0.5 * (1.0 + (std::f64::consts::PI * progress).cos()),
    }
}
