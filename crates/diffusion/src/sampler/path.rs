//! The path of a sampler through the noise levels.

use super::config::SamplerConfig;
use super::spacing::timesteps;
use crate::Time;

/// The timesteps of each sample of a batch, noisiest first, and the end of its last step.
#[derive(Clone, Debug)]
pub struct TimestepPath {
    /// One list of the batch per step.
    steps: Vec<Vec<usize>>,
    /// The timestep of each sample after the last step; `None` is the clean motion.
    last: Vec<Option<usize>>,
}

impl TimestepPath {
    /// The path of a sampler, the same for all samples of a batch.
    pub fn of(config: &SamplerConfig, num_train_timesteps: usize, batch: usize) -> Self {
        let visited = timesteps(config, num_train_timesteps).into_iter();
        Self {
            steps: visited.map(|timestep| vec![timestep; batch]).collect(),
            last: vec![config.last_prev_timestep(); batch],
        }
    }

    /// A path to the clean motion with one list of the batch per step.
    pub fn to_clean(steps: Vec<Vec<usize>>) -> Self {
        Self {
            last: vec![None; steps.first().map_or(0, Vec::len)],
            steps,
        }
    }

    /// Step `index` as a path.
    ///
    /// # Panics
    /// Panics if `index` is out of range.
    #[must_use]
    pub fn step(&self, index: usize) -> Self {
        Self {
            steps: vec![self.steps[index].clone()],
            last: self.prev_timesteps(index),
        }
    }

    /// Number of steps.
    pub fn num_steps(&self) -> usize {
        self.steps.len()
    }

    /// The timestep of each sample before step `index`.
    ///
    /// # Panics
    /// Panics if `index` is out of range.
    pub fn timesteps(&self, index: usize) -> &[usize] {
        &self.steps[index]
    }

    /// [`timesteps`](Self::timesteps) as the time input of a network.
    ///
    /// # Panics
    /// Panics if `index` is out of range.
    pub fn time(&self, index: usize) -> Vec<Time> {
        Time::of(self.timesteps(index))
    }

    /// True if step `index` takes a sample to a different timestep, not the clean motion.
    pub(super) fn stays_noisy(&self, index: usize) -> bool {
        let prev = self.prev_timesteps(index).into_iter();
        prev.zip(self.timesteps(index))
            .filter_map(|(next, now)| Some((next?, now)))
            .any(|(next, now)| next != *now)
    }

    /// The timestep of each sample after step `index`.
    ///
    /// # Panics
    /// Panics if `index` is out of range.
    pub fn prev_timesteps(&self, index: usize) -> Vec<Option<usize>> {
        match self.steps.get(index + 1) {
            Some(next) => next.iter().copied().map(Some).collect(),
            None => self.last.clone(),
        }
    }
}
