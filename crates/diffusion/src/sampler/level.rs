//! Signal and noise of a noisy motion.

use crate::GaussianDiffusion;

/// `x_t = alpha x_0 + sigma noise`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    pub alpha: f64,
    pub sigma: f64,
}

impl Level {
    /// The levels at timesteps; `None` is the clean motion.
    pub fn of(
        diffusion: &GaussianDiffusion,
        timesteps: impl IntoIterator<Item = Option<usize>>,
    ) -> Vec<Self> {
        let pairs = timesteps.into_iter().map(|t| diffusion.schedule.abar_at(t));
        let level = |(abar, one_minus_abar): (f64, f64)| Self {
            alpha: abar.sqrt(),
            sigma: one_minus_abar.sqrt(),
        };
        pairs.map(level).collect()
    }

    /// Noise over motion.
    pub fn ratio(&self) -> f64 {
        self.sigma / self.alpha
    }

    /// Increase of `ln(alpha / sigma)` to another level.
    pub fn lambda_to(&self, other: &Self) -> f64 {
        (self.ratio() / other.ratio()).ln()
    }
}
