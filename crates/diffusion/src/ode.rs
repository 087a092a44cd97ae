//! Explicit Runge-Kutta methods for `dx / dt = f(x, t)`, given by their Butcher tableaus. Flows and
//! the diffusion sampler `heun` use these methods.

use burn::tensor::Tensor;

use crate::Error;

/// One step of a differential equation.
pub(crate) trait Ode<const D: usize> {
    /// A slope, with the data for [`moved`](Self::moved).
    type Slope;

    /// `f(x, t)` at `place` of the step: 0 is the start, 1 the end.
    fn slope(&mut self, x: Tensor<D>, place: f64) -> Result<Self::Slope, Error>;

    /// `x + h sum(shares * slopes)`, with h the size of the step.
    fn moved(&self, x: &Tensor<D>, shares: &[f64], slopes: &[Self::Slope]) -> Tensor<D>;
}

/// A method of integration.
pub(crate) struct Method {
    /// For each slope after the first: its place, and the shares of the previous slopes.
    stages: &'static [(f64, &'static [f64])],
    /// Shares of the slopes in the step.
    shares: &'static [f64],
}

impl Method {
    /// Order 1.
    pub const EULER: Self = Self {
        stages: &[],
        shares: &[1.0],
    };

    /// Order 2, with the slope at the middle of Euler's step.
    pub const MIDPOINT: Self = Self {
        stages: &[(0.5, &[0.5])],
        shares: &[0.0, 1.0],
    };

    /// Order 2, with the mean of the slopes at both ends of Euler's step.
    pub const HEUN: Self = Self {
        stages: &[(1.0, &[1.0])],
        shares: &[0.5, 0.5],
    };

    /// The method of order 5 of Dormand and Prince (Hairer, Nørsett and Wanner, "Solving Ordinary
    /// Differential Equations I", 1993, section II.5).
    pub const DOPRI5: Self = Self {
        stages: &[
            (1.0 / 5.0, &[1.0 / 5.0]),
            (3.0 / 10.0, &[3.0 / 40.0, 9.0 / 40.0]),
            (4.0 / 5.0, &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0]),
            (
                8.0 / 9.0,
                &[
                    19372.0 / 6561.0,
                    -25360.0 / 2187.0,
                    64448.0 / 6561.0,
                    -212.0 / 729.0,
                ],
            ),
            (
                1.0,
                &[
                    9017.0 / 3168.0,
                    -355.0 / 33.0,
                    46732.0 / 5247.0,
                    49.0 / 176.0,
                    -5103.0 / 18656.0,
                ],
            ),
        ],
        shares: &[
            35.0 / 384.0,
            0.0,
            500.0 / 1113.0,
            125.0 / 192.0,
            -2187.0 / 6784.0,
            11.0 / 84.0,
        ],
    };

    /// Shares of the slopes of [`Self::DOPRI5`], and of the end's slope, in the difference from a
    /// solution of order 4.
    pub const DOPRI5_ERROR: [f64; 7] = [
        71.0 / 57600.0,
        0.0,
        -71.0 / 16695.0,
        71.0 / 1920.0,
        -17253.0 / 339_200.0,
        22.0 / 525.0,
        -1.0 / 40.0,
    ];

    /// Slopes per step.
    pub const fn evaluations(&self) -> usize {
        self.shares.len()
    }

    /// The end of a step from `x`.
    pub fn step<O: Ode<D>, const D: usize>(
        &self,
        ode: &mut O,
        x: &Tensor<D>,
    ) -> Result<Tensor<D>, Error> {
        let first = ode.slope(x.clone(), 0.0)?;
        Ok(self.step_along(ode, x, first)?.0)
    }

    /// The end of a step with a known `first` slope, and all slopes.
    pub fn step_along<O: Ode<D>, const D: usize>(
        &self,
        ode: &mut O,
        x: &Tensor<D>,
        first: O::Slope,
    ) -> Result<(Tensor<D>, Vec<O::Slope>), Error> {
        let mut slopes = vec![first];
        for (place, shares) in self.stages {
            let there = ode.moved(x, shares, &slopes);
            slopes.push(ode.slope(there, *place)?);
        }
        Ok((ode.moved(x, self.shares, &slopes), slopes))
    }
}
