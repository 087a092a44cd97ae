//! Checks of values that plans of phrases and of clips have in common.

use kinegrad_data::check_id;
use kinegrad_settings::{InvalidSetting, in_range, require};

/// Metres of the smallest unit of a plan.
pub(super) const SMALLEST_UNIT: f64 = 1e-9;

/// The smallest frame rate of a plan.
pub(super) const LEAST_FPS: f64 = 0.1;

/// The largest number of seconds, metres or frames per second of a plan.
pub(super) const MOST: f64 = 1e5;

/// Rejects numbers of seconds, metres or hertz that no recording has.
pub(super) fn check_number(
    key: &str,
    number: Option<f64>,
    least: f64,
) -> Result<(), InvalidSetting> {
    number.map_or(Ok(()), |number| in_range(key, number, least..=MOST))
}

/// Rejects a part of a motion file whose end is not after the start.
pub(super) fn check_end(start: f64, end: Option<f64>) -> Result<(), InvalidSetting> {
    check_number("motion_start_seconds", Some(start), 0.0)?;
    let after = end.is_none_or(|end| end > start && end.is_finite());
    let found = end.unwrap_or_default();
    let allowed = "a moment after `motion_start_seconds`";
    require(after, "motion_end_seconds", found, allowed)
}

/// Rejects a name that cannot begin ids.
pub(super) fn check_name(name: Option<&str>) -> Result<(), InvalidSetting> {
    let name = name.unwrap_or("x");
    check_id(&name.replace("{name}", "x"))
        .map_err(|error| InvalidSetting::new("name", format!("\"{name}\""), error))
}
