//! The timesteps of a sampler.

use super::config::{SamplerConfig, TimestepSpacing};

/// The timesteps of `config` out of `num_train_timesteps`, noisiest first: strictly decreasing for
/// a valid config.
///
/// The formulas of [`TimestepSpacing`] are evaluated in integers. A linspace in single precision is
/// wrong for some numbers of steps (from 220 of 1000).
pub fn timesteps(config: &SamplerConfig, num_train_timesteps: usize) -> Vec<usize> {
    let (total, steps) = (num_train_timesteps, config.num_inference_steps);
    let last = total.saturating_sub(1);
    let visited = config.kind.timesteps();
    let spacing = visited.map_or_else(TimestepSpacing::default, |all| all.timestep_spacing);
    let stride = total.checked_div(steps).unwrap_or(0);
    (0..steps)
        .map(|i| match spacing {
            TimestepSpacing::CcMotion => last - i * stride,
            TimestepSpacing::Leading => (steps - 1 - i) * stride,
            TimestepSpacing::Linspace if steps == 1 => last,
            TimestepSpacing::Linspace => last * (steps - 1 - i) / (steps - 1),
            TimestepSpacing::Trailing => {
                rounded_division(total * (steps - i), steps).saturating_sub(1)
            }
        })
        .collect()
}

/// `numerator / denominator` to the nearest integer, ties to even.
fn rounded_division(numerator: usize, denominator: usize) -> usize {
    let (quotient, twice) = (numerator / denominator, numerator % denominator * 2);
    let up = twice > denominator || (twice == denominator && quotient % 2 == 1);
    quotient + usize::from(up)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::sampler::{SamplerKind, Timesteps};

    const SPACINGS: [TimestepSpacing; 4] = [
        TimestepSpacing::CcMotion,
        TimestepSpacing::Leading,
        TimestepSpacing::Linspace,
        TimestepSpacing::Trailing,
    ];

    fn spaced(timestep_spacing: TimestepSpacing, steps: usize, total: usize) -> Vec<usize> {
        let kind = Timesteps {
            timestep_spacing,
            guidance_until: 0,
        };
        let kind = SamplerKind::Ddpm(kind.into());
        timesteps(&SamplerConfig::new(kind, steps), total)
    }

    #[test]
    fn ten_in_three_and_four_steps() {
        let three = SPACINGS.map(|spacing| spaced(spacing, 3, 10));
        assert_eq!(three, [[9, 6, 3], [6, 3, 0], [9, 4, 0], [9, 6, 2]]);
        // 2.5 and 7.5 are ties: 2 and 8.
        assert_eq!(spaced(TimestepSpacing::Trailing, 4, 10), [9, 7, 4, 1]);
    }

    #[test]
    fn all_steps_are_all_timesteps() {
        for spacing in SPACINGS {
            assert_eq!(spaced(spacing, 7, 7), [6, 5, 4, 3, 2, 1, 0], "{spacing:?}");
        }
    }

    #[test]
    fn they_strictly_decrease_within_range() {
        for total in [2, 3, 10, 50, 97, 360] {
            for steps in 1..=total {
                check(steps, total);
            }
        }
    }

    proptest! {
        #[test]
        fn they_strictly_decrease_for_any_total(total in 2usize..5000, part in 0.0f64..1.0) {
            check(1 + (part * (total - 1) as f64) as usize, total);
        }
    }

    fn check(steps: usize, total: usize) {
        for spacing in SPACINGS {
            let visited = spaced(spacing, steps, total);
            assert_eq!(visited.len(), steps, "{spacing:?} {steps} of {total}");
            assert!(
                visited[0] < total,
                "{spacing:?} {steps} of {total}: {visited:?}"
            );
            let decreases = visited.windows(2).all(|pair| pair[1] < pair[0]);
            assert!(decreases, "{spacing:?} {steps} of {total}: {visited:?}");
            match spacing {
                TimestepSpacing::Leading => assert_eq!(visited[steps - 1], 0),
                _ => assert_eq!(
                    visited[0],
                    total - 1,
                    "{spacing:?} begins with the noisiest"
                ),
            }
        }
    }
}
