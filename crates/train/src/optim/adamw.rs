use kinegrad_kernels::optimizer as kernels;

use crate::config::OptimConfig;

/// The running means of one parameter's gradient and squared gradient.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Moments {
    /// Running mean of the gradient.
    pub exp_avg: Vec<f32>,
    /// Running mean of the squared gradient.
    pub exp_avg_sq: Vec<f32>,
}

/// Adam with decoupled weight decay (CC-MotionGen, section 6.3; docs/sources.md, section 1.10),
/// over parameters in the module's order:
///
/// ```text
/// p -= lr decay p
/// m  = b1 m + (1 - b1) g
/// v  = b2 v + (1 - b2) g^2
/// p -= lr mhat / (sqrt(vhat) + eps)    with  mhat = m / (1 - b1^t),  vhat = v / (1 - b2^t)
/// ```
///
/// With CC-MotionGen's rate and decay of 1e-4 each, `1 - lr decay` rounds to 1 in single precision,
/// so that decay does nothing; larger values of either work.
#[derive(Clone, Debug)]
pub struct AdamW {
    config: OptimConfig,
    moments: Vec<Moments>,
    steps: u64,
    /// Whether each parameter decays; all of them where this is empty.
    decaying: Vec<bool>,
}

impl AdamW {
    /// An optimiser before its first step, for parameters of these numbers of elements.
    pub fn new(config: &OptimConfig, lengths: impl IntoIterator<Item = usize>) -> Self {
        let zero = |n| Moments {
            exp_avg: vec![0.0; n],
            exp_avg_sq: vec![0.0; n],
        };
        Self::restore(config, lengths.into_iter().map(zero).collect(), 0)
    }

    /// An optimiser after `steps` steps.
    pub fn restore(config: &OptimConfig, moments: Vec<Moments>, steps: u64) -> Self {
        Self {
            config: config.clone(),
            moments,
            steps,
            decaying: Vec::new(),
        }
    }

    /// The same optimiser with decay on those parameters alone for which this says so, in their
    /// order.
    #[must_use]
    pub fn with_decay_on(self, decaying: Vec<bool>) -> Self {
        Self { decaying, ..self }
    }

    /// The running means, in the parameters' order.
    pub fn moments(&self) -> &[Moments] {
        &self.moments
    }

    /// Counts a step; [`update`](Self::update) then belongs to it.
    pub fn begin_step(&mut self) {
        self.steps += 1;
    }

    /// Updates parameter `index` in place from its gradient times `gradient_scale`, and in the same
    /// pass its moving average, if that moves at this step ([`crate::ema::Ema::average`]).
    ///
    /// # Panics
    /// Panics if the lengths differ.
    pub fn update(
        &mut self,
        index: usize,
        parameter: &mut [f32],
        gradient: &[f32],
        gradient_scale: f64,
        learning_rate: f64,
        ema: Option<(&mut [f32], f64)>,
    ) {
        let Moments {
            exp_avg,
            exp_avg_sq,
        } = &mut self.moments[index];
        let decays = self.decaying.get(index).copied().unwrap_or(true);
        let step = kernels::AdamW {
            betas: self.config.betas,
            eps: self.config.eps,
            weight_decay: if decays {
                self.config.weight_decay
            } else {
                0.0
            },
            learning_rate,
            steps: self.steps,
            gradient_scale,
        };
        let state = kernels::AdamWState {
            parameter,
            exp_avg,
            exp_avg_sq,
            ema,
        };
        step.update(state, gradient);
    }
}
