//! Signal and noise of a noisy motion.

use crate::{GaussianDiffusion, NoiseSchedule};

/// `x_t = alpha x_0 + sigma noise`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    pub alpha: f64,
    pub sigma: f64,
}

impl Level {
    /// The levels of timesteps.
    pub fn of(diffusion: &GaussianDiffusion, timesteps: &[usize]) -> Vec<Self> {
        let levels = timesteps.iter();
        levels
            .map(|&timestep| Self::at(&diffusion.schedule, Some(timestep)))
            .collect()
    }

    /// The levels of where steps land; `None` is the clean motion.
    pub fn of_landings(diffusion: &GaussianDiffusion, landings: &[Option<usize>]) -> Vec<Self> {
        let levels = landings.iter();
        levels
            .map(|&landing| Self::at(&diffusion.schedule, landing))
            .collect()
    }

    fn at(schedule: &NoiseSchedule, landing: Option<usize>) -> Self {
        let (abar, one_minus_abar) = schedule.landing(landing);
        Self {
            alpha: abar.sqrt(),
            sigma: one_minus_abar.sqrt(),
        }
    }

    /// Noise over motion.
    pub fn ratio(&self) -> f64 {
        self.sigma / self.alpha
    }

    /// Growth of `ln(alpha / sigma)` from here to another level.
    pub fn lambda_to(&self, other: &Self) -> f64 {
        (self.ratio() / other.ratio()).ln()
    }
}
