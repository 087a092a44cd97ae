//! Distance of a root from its path, as a loss (docs/sources.md, section 7, options B and D).

use kinegrad_settings::{InvalidSetting, Refused, in_range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::humanml::Root;

/// Smoothing of the distance at zero, metres.
const ROUNDED: f64 = 1e-6;

/// Weights of a [`PathLoss`].
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PathLossConfig {
    /// Weight of the heading relative to the distance; 0 ignores the heading.
    pub heading: f64,
    /// Distance from the path without loss, metres.
    pub tolerance: f64,
}

impl PathLossConfig {
    /// # Errors
    /// For a negative number.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("heading", self.heading, 0.0..).hint("0 leaves the heading free")?;
        in_range("tolerance", self.tolerance, 0.0..).hint("metres; 0 for none")
    }
}

/// The loss of a root at ground position p with heading psi:
///
/// ```text
/// L = sum_t |p - path|^2 + heading sum_t (1 - cos(psi - psi_path))
/// ```
///
/// With a tolerance, the square is `max(0, |p - path| - tolerance)^2`.
#[derive(Clone, Debug)]
pub struct PathLoss {
    /// Weights.
    pub config: PathLossConfig,
    /// Positions of the path, `[frames]`. Later frames are free.
    pub points: Vec<[f64; 2]>,
    /// Headings of the path, `[frames]`, radians.
    pub headings: Vec<f64>,
}

impl PathLoss {
    /// The loss of a clip's first three channels (rotation, x, z, in radians and metres, in
    /// representation `root`), and the gradient. With a relative root the last row has no effect.
    pub fn evaluate(&self, root: Root, channels: &[[f64; 3]]) -> (f64, Vec<[f64; 3]>) {
        assert_eq!(self.points.len(), self.headings.len(), "a heading a point");
        let enough = channels.len() >= self.points.len();
        assert!(enough, "a frame for each point");
        let channels: Vec<[f64; 4]> = channels.iter().map(|[a, x, z]| [*a, *x, *z, 0.0]).collect();
        let positions = root.positions(&channels);
        let angles = root.half_angles(&channels);
        let mut loss = 0.0;
        let mut by_position = vec![[0.0; 2]; channels.len()];
        let mut by_heading = vec![0.0; channels.len()];
        for (t, (target, wanted)) in self.points.iter().zip(&self.headings).enumerate() {
            let away = [positions[t][0] - target[0], positions[t][2] - target[1]];
            let squared = away[0] * away[0] + away[1] * away[1];
            let (value, factor) = match self.config.tolerance {
                0.0 => (squared, 2.0),
                tolerance => {
                    let distance = (squared + ROUNDED * ROUNDED).sqrt();
                    let over = (distance - tolerance).max(0.0);
                    (over * over, 2.0 * over / distance)
                }
            };
            let angle = -2.0 * angles[t] - wanted;
            loss += value + self.config.heading * (1.0 - angle.cos());
            by_position[t] = away.map(|value| factor * value);
            by_heading[t] = self.config.heading * angle.sin();
        }
        let moved = root.ground_gradient(&channels, &by_position).into_iter();
        let turned = by_rotation(root, &by_heading);
        let gradient = moved.zip(turned);
        let gradient = gradient.map(|([a, x, z, _], turned)| [a + turned, x, z]);
        (loss, gradient.collect())
    }
}

/// The gradient with respect to the rotation channel, from the gradient with respect to headings.
fn by_rotation(root: Root, by_heading: &[f64]) -> Vec<f64> {
    match root {
        Root::Absolute => by_heading.iter().map(|slope| -2.0 * slope).collect(),
        Root::Relative => {
            // A change of rotation acts on all later frames.
            let mut behind = 0.0;
            let mut slopes = vec![0.0; by_heading.len()];
            for (into, slope) in slopes.iter_mut().zip(by_heading).rev() {
                *into = -2.0 * behind;
                behind += slope;
            }
            slopes
        }
    }
}

/// The first three channels (rotation, x, z) of a root at `points` with `headings`. With a relative
/// root the path begins at the origin, facing +z. The last row repeats the previous change.
pub fn root_channels(points: &[[f64; 2]], headings: &[f64], root: Root) -> Vec<[f64; 3]> {
    assert_eq!(points.len(), headings.len(), "a heading for each point");
    let both = points.iter().zip(headings);
    let absolute = both.map(|([x, z], psi)| [-0.5 * psi, *x, *z, 0.0]);
    let converted = Root::Absolute.convert(&absolute.collect::<Vec<_>>(), root);
    converted
        .into_iter()
        .map(|[a, x, z, _]| [a, x, z])
        .collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn of(config: PathLossConfig, frames: usize) -> PathLoss {
        let place = |t: usize| [0.1 * t as f64, 0.3 - 0.05 * (t * t) as f64];
        PathLoss {
            config,
            points: (0..frames).map(place).collect(),
            headings: (0..frames).map(|t| 0.4 * t as f64 - 1.0).collect(),
        }
    }

    proptest! {
        #[test]
        fn its_gradient_is_that_of_differences(
            rows in proptest::collection::vec(proptest::array::uniform3(-0.5..0.5f64), 3..9),
            heading in prop_oneof![Just(0.0), 0.1..2.0f64],
            tolerance in prop_oneof![Just(0.0), 0.05..0.3f64],
            short in 0..2usize,
        ) {
            let loss = of(PathLossConfig { heading, tolerance }, rows.len() - short);
            for root in [Root::Absolute, Root::Relative] {
                let (_, gradient) = loss.evaluate(root, &rows);
                for t in 0..rows.len() {
                    for channel in 0..3 {
                        let at = |by: f64| {
                            let mut rows = rows.clone();
                            rows[t][channel] += by;
                            loss.evaluate(root, &rows).0
                        };
                        let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
                        prop_assert!((slope - gradient[t][channel]).abs() < 1e-5 * (1.0 + slope.abs()));
                    }
                }
                if root == Root::Relative {
                    prop_assert_eq!(gradient[rows.len() - 1], [0.0; 3]);
                }
            }
        }

        #[test]
        fn a_root_on_the_path_costs_nothing(frames in 2..9usize) {
            let config = PathLossConfig { heading: 0.5, tolerance: 0.0 };
            let mut loss = of(config, frames);
            for root in [Root::Absolute, Root::Relative] {
                let rows = root_channels(&loss.points, &loss.headings, root);
                if root == Root::Relative {
                    // The path is relative to its start.
                    let rows: Vec<[f64; 4]> = rows.iter().map(|[a, x, z]| [*a, *x, *z, 0.0]).collect();
                    let positions = root.positions(&rows);
                    prop_assert_eq!(positions[0], [0.0; 3]);
                    loss.points = positions.iter().map(|[x, _, z]| [*x, *z]).collect();
                    loss.headings = root.half_angles(&rows).iter().map(|a| -2.0 * a).collect();
                }
                let (value, gradient) = loss.evaluate(root, &rows);
                prop_assert!(value < 1e-20 && gradient.as_flattened().iter().all(|g| g.abs() < 1e-9));
            }
        }
    }

    #[test]
    fn within_the_tolerance_nothing_pulls() {
        let near = PathLossConfig {
            heading: 0.0,
            tolerance: 0.2,
        };
        let loss = of(near, 4);
        let mut rows = root_channels(&loss.points, &loss.headings, Root::Absolute);
        for row in &mut rows {
            row[1] += 0.15;
        }
        let (value, gradient) = loss.evaluate(Root::Absolute, &rows);
        assert_eq!(value, 0.0);
        assert!(gradient.as_flattened().iter().all(|g| *g == 0.0));
        assert!(
            PathLossConfig {
                tolerance: -1.0,
                ..near
            }
            .validate()
            .is_err()
        );
    }
}
