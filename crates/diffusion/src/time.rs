//! The time input of a network: the noise level.

/// The noise level of a sample in its network's units: the flow time, or the timestep of a
/// diffusion process (0 is the least noisy).
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Time(pub f64);

impl From<usize> for Time {
    fn from(timestep: usize) -> Self {
        Self(timestep as f64)
    }
}

impl Time {
    /// The times of timesteps.
    pub fn of(timesteps: &[usize]) -> Vec<Self> {
        timesteps.iter().copied().map(Self::from).collect()
    }

    /// The timesteps nearest to times.
    pub fn timesteps(times: &[Self]) -> Vec<usize> {
        times.iter().map(|time| time.timestep()).collect()
    }

    /// The nearest timestep.
    pub fn timestep(self) -> usize {
        self.0.round() as usize
    }
}
