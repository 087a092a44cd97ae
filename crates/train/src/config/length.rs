//! The length of a run and its intervals, in steps or in epochs.

use kinegrad_settings::{DocumentError, Place};
use toml::{Table, Value};

use super::{Config, ConfigError, ValidationConfig};

/// Tables with two keys of which a config has one: a number of steps, or of epochs.
const PAIRS: [(&str, [&str; 2]); 3] = [
    ("train", ["max_steps", "epochs"]),
    ("checkpoint", ["every_steps", "every_epochs"]),
    ("validation", ["every_steps", "every_epochs"]),
];

/// Steps of a run without `train.max_steps` and `train.epochs`.
const MAX_STEPS: u64 = 16_400;

/// Steps between checkpoints, and between validations, without a key that sets them.
const EVERY_STEPS: u64 = 500;

/// The length of a run and its intervals, in steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunLength {
    /// Steps in total.
    pub max_steps: u64,
    /// Steps between checkpoints.
    pub checkpoint_every: u64,
    /// Steps between validations; 0 for none.
    pub validate_every: u64,
}

impl Config {
    /// Steps of an epoch over `train_items` items.
    pub fn steps_per_epoch(&self, train_items: usize) -> u64 {
        let of_step = self.data.batch_size as u64 * self.train.gradient_accumulation_steps;
        (train_items as u64).div_ceil(of_step.max(1)).max(1)
    }

    /// The length of a run whose epochs have `steps_per_epoch` steps.
    pub fn length(&self, steps_per_epoch: u64) -> RunLength {
        let steps = |steps: Option<u64>, epochs: Option<u64>, usual| match epochs {
            Some(epochs) => epochs.saturating_mul(steps_per_epoch),
            None => steps.unwrap_or(usual),
        };
        let (train, checkpoint) = (&self.train, &self.checkpoint);
        let validation = &self.validation;
        RunLength {
            max_steps: steps(train.max_steps, train.epochs, MAX_STEPS),
            checkpoint_every: steps(checkpoint.every_steps, checkpoint.every_epochs, EVERY_STEPS),
            validate_every: steps(validation.every_steps, validation.every_epochs, EVERY_STEPS),
        }
    }

    /// Fills in the default of each pair of which neither key is set.
    pub(crate) fn complete_length(&mut self) {
        let usual = |steps: &mut Option<u64>, epochs: Option<u64>, usual| {
            if epochs.is_none() {
                steps.get_or_insert(usual);
            }
        };
        usual(&mut self.train.max_steps, self.train.epochs, MAX_STEPS);
        let checkpoint = &mut self.checkpoint;
        usual(
            &mut checkpoint.every_steps,
            checkpoint.every_epochs,
            EVERY_STEPS,
        );
        let validation = &mut self.validation;
        usual(
            &mut validation.every_steps,
            validation.every_epochs,
            EVERY_STEPS,
        );
    }
}

impl ValidationConfig {
    /// True unless validation is disabled.
    pub fn is_enabled(&self) -> bool {
        self.every_steps != Some(0)
    }

    /// Disables validation.
    pub fn disable(&mut self) {
        (self.every_steps, self.every_epochs) = (Some(0), None);
    }
}

/// The other key of the pair of a dotted key.
pub(crate) fn alternative(key: &str) -> Option<String> {
    let (table, name) = key.split_once('.')?;
    let (_, pair) = PAIRS
        .iter()
        .find(|(of, pair)| *of == table && pair.contains(&name))?;
    let other = pair.iter().find(|other| **other != name)?;
    Some(format!("{table}.{other}"))
}

/// Removes keys of `below` whose alternative is in `above`.
pub(crate) fn give_way(below: &mut Table, above: &Table) {
    for (table, pair) in PAIRS {
        let Some(Value::Table(above)) = above.get(table) else {
            continue;
        };
        let Some(Value::Table(below)) = below.get_mut(table) else {
            continue;
        };
        if pair.iter().any(|key| above.contains_key(*key)) {
            pair.iter().for_each(|key| drop(below.remove(*key)));
        }
    }
}

/// Rejects a table with both keys of a pair; `place` locates a dotted key.
pub(crate) fn must_have_one(given: &Table, place: Place<'_>) -> Result<(), ConfigError> {
    for (table, [steps, epochs]) in PAIRS {
        let keys = given.get(table).and_then(Value::as_table);
        if keys.is_some_and(|keys| keys.contains_key(steps) && keys.contains_key(epochs)) {
            let key = format!("{table}.{epochs}");
            return Err(both(place(&key), key, &format!("{table}.{steps}")));
        }
    }
    Ok(())
}

/// The error of a config with both keys of a pair.
pub(crate) fn both(place: String, key: String, other: &str) -> ConfigError {
    let error = DocumentError::Value {
        message: format!("`{other}` is set too"),
        hint: format!("set one of the two: `{key}` counts epochs, `{other}` counts steps"),
        place,
        key,
    };
    error.into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::plain;

    fn length(text: &str, items: usize) -> RunLength {
        let config = plain(text, &[]);
        config.length(config.steps_per_epoch(items))
    }

    #[test]
    fn an_epoch_has_as_many_steps_as_reach_every_item() {
        // The source: 100 epochs of 5242 phrases in batches of 32 are 16400 steps.
        let text = "train = { epochs = 100 }\ndata = { batch_size = 32 }\n\
                    checkpoint = { every_epochs = 10 }\nvalidation = { every_epochs = 5 }";
        let expected = RunLength {
            max_steps: 16_400,
            checkpoint_every: 1640,
            validate_every: 820,
        };
        assert_eq!(length(text, 5242), expected);
        let text = "train = { epochs = 2, gradient_accumulation_steps = 2 }\n\
                    data = { batch_size = 4 }";
        assert_eq!(length(text, 17).max_steps, 6);
        assert_eq!(length(text, 1).max_steps, 2);
    }

    #[test]
    fn without_a_key_the_defaults_are_steps() {
        let usual = RunLength {
            max_steps: 16_400,
            checkpoint_every: 500,
            validate_every: 500,
        };
        assert_eq!(length("", 7), usual);
        let mut config = Config::default();
        config.complete_length();
        assert_eq!(config.train.max_steps, Some(16_400));
        assert_eq!(config.length(1), usual);
        let mut config = plain("train = { epochs = 3 }", &[]);
        config.complete_length();
        assert_eq!(config.train.max_steps, None);
    }

    #[test]
    fn a_key_replaces_its_alternative_below() {
        let table = |text: &str| -> Table { text.parse().unwrap() };
        let mut below = table("train = { max_steps = 9, patience = 1 }");
        give_way(&mut below, &table("train = { patience = 2 }"));
        assert_eq!(below, table("train = { max_steps = 9, patience = 1 }"));
        give_way(&mut below, &table("train = { epochs = 2 }"));
        assert_eq!(below, table("train = { patience = 1 }"));
        assert_eq!(
            alternative("validation.every_epochs").as_deref(),
            Some("validation.every_steps")
        );
        assert_eq!(alternative("train.patience"), None);
    }
}
