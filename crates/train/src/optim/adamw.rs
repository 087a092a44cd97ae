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

impl Moments {
    /// The initial state of a parameter with a number of elements.
    pub fn zeros(len: usize) -> Self {
        Self {
            exp_avg: vec![0.0; len],
            exp_avg_sq: vec![0.0; len],
        }
    }

    /// Updates a parameter in place by an [`AdamW::step`] and, in the same pass, its moving average
    /// with the share of [`share_at`](crate::config::EmaConfig::share_at).
    ///
    /// # Panics
    /// Panics if the lengths differ.
    pub fn update(
        &mut self,
        step: kernels::AdamW,
        parameter: &mut [f32],
        gradient: &[f32],
        ema: Option<(&mut [f32], f64)>,
    ) {
        let state = kernels::AdamWState {
            parameter,
            exp_avg: &mut self.exp_avg,
            exp_avg_sq: &mut self.exp_avg_sq,
            ema,
        };
        step.update(state, gradient);
    }
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
/// so weight decay has no effect.
#[derive(Clone, Debug)]
pub struct AdamW {
    config: OptimConfig,
    steps: u64,
    /// True for parameters that decay; if empty, all parameters decay.
    decaying: Vec<bool>,
}

impl AdamW {
    /// An optimizer after `steps` steps.
    pub fn new(config: &OptimConfig, steps: u64) -> Self {
        Self {
            config: config.clone(),
            steps,
            decaying: Vec::new(),
        }
    }

    /// The optimizer with weight decay on the selected parameters only, in their order.
    #[must_use]
    pub fn with_decay_on(self, decaying: Vec<bool>) -> Self {
        Self { decaying, ..self }
    }

    /// Starts a step; [`step`](Self::step) then gives its settings.
    pub fn begin_step(&mut self) {
        self.steps += 1;
    }

    /// Steps started.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The settings of this step for parameter `index`; `gradient_scale` scales the gradient.
    pub fn step(&self, index: usize, gradient_scale: f64, learning_rate: f64) -> kernels::AdamW {
        let decays = self.decaying.get(index).copied().unwrap_or(true);
        kernels::AdamW {
            betas: self.config.betas,
            eps: self.config.eps,
            weight_decay: match decays {
                true => self.config.weight_decay,
                false => 0.0,
            },
            learning_rate,
            steps: self.steps,
            gradient_scale,
        }
    }
}
