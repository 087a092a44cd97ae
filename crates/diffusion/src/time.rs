//! The time input of a network: the noise level.

/// The noise level of a sample in its network's units: the timestep of a diffusion process, 0 being
/// the least noisy, or the flow time.
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

    /// The timesteps of times.
    pub fn timesteps(times: &[Self]) -> Vec<usize> {
        times.iter().map(|time| time.timestep()).collect()
    }

    /// The nearest timestep.
    pub fn timestep(self) -> usize {
        self.0.round() as usize
    }
}
