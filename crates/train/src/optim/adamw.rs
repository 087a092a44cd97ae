use rayon::prelude::*;

use crate::config::OptimConfig;

/// Elements that one thread handles at a time.
const CHUNK: usize = 1 << 14;

/// The running means of one parameter's gradient and squared gradient.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Running mean of the gradient.
    pub exp_avg: Vec<f32>,
    /// Running mean of the squared gradient.
    pub exp_avg_sq: Vec<f32>,
}

/// Adam with decoupled weight decay (CC-MotionGen documentation, section 6.3), over parameters in
/// the module's order:
///
/// ```text
/// p -= lr decay p
/// m  = b1 m + (1 - b1) g
/// v  = b2 v + (1 - b2) g^2
/// p -= lr mhat / (sqrt(vhat) + eps)    with  mhat = m / (1 - b1^t),  vhat = v / (1 - b2^t)
/// ```
///
/// With the document's rate and decay of 1e-4 each, `1 - lr decay` rounds to 1 in single
/// precision, so that decay does nothing; larger values of either work.
#[derive(Clone, Debug)]
pub struct AdamW {
    config: OptimConfig,
    moments: Vec<Moments>,
    steps: u64,
}

impl AdamW {
    /// An optimiser before its first step, for parameters of these numbers of elements.
    pub fn new(config: &OptimConfig, lengths: impl IntoIterator<Item = usize>) -> Self {
        let zero = |n| Moments {
            exp_avg: vec![0.0; n],
            exp_avg_sq: vec![0.0; n],
        };
        Self {
            config: config.clone(),
            moments: lengths.into_iter().map(zero).collect(),
            steps: 0,
        }
    }

    /// An optimiser after `steps` steps.
    pub fn restore(config: &OptimConfig, moments: Vec<Moments>, steps: u64) -> Self {
        Self {
            config: config.clone(),
            moments,
            steps,
        }
    }

    /// The running means, in the parameters' order.
    pub fn moments(&self) -> &[Moments] {
        &self.moments
    }

    /// Counts a step; [`update`](Self::update) then belongs to it.
    pub fn begin_step(&mut self) {
        self.steps += 1;
    }

    /// Updates parameter `index` in place from its gradient times `gradient_scale`.
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
    ) {
        let Moments {
            exp_avg,
            exp_avg_sq,
        } = &mut self.moments[index];
        assert_eq!(
            parameter.len(),
            gradient.len(),
            "gradient of parameter {index}"
        );
        assert_eq!(parameter.len(), exp_avg.len(), "state of parameter {index}");
        let [beta1, beta2] = self.config.betas;
        let steps = self.steps as i32;
        let (correction1, correction2) = (1.0 - beta1.powi(steps), 1.0 - beta2.powi(steps));
        let keep = (1.0 - learning_rate * self.config.weight_decay) as f32;
        let step_size = (learning_rate / correction1) as f32;
        let root_correction2 = correction2.sqrt() as f32;
        let eps = self.config.eps as f32;
        let scale = gradient_scale as f32;
        let (b1, b2) = (beta1 as f32, beta2 as f32);
        let (c1, c2) = ((1.0 - beta1) as f32, (1.0 - beta2) as f32);

        parameter
            .par_chunks_mut(CHUNK)
            .zip(gradient.par_chunks(CHUNK))
            .zip(exp_avg.par_chunks_mut(CHUNK))
            .zip(exp_avg_sq.par_chunks_mut(CHUNK))
            .for_each(|(((parameter, gradient), exp_avg), exp_avg_sq)| {
                for (((p, g), m), v) in parameter
                    .iter_mut()
                    .zip(gradient)
                    .zip(exp_avg)
                    .zip(exp_avg_sq)
                {
                    let g = g * scale;
                    *m = b1 * *m + c1 * g;
                    *v = b2 * *v + c2 * g * g;
                    let denominator = v.sqrt() / root_correction2 + eps;
                    *p = *p * keep - step_size * *m / denominator;
                }
            });
    }
}
