//! The spread of movement measures over motions.

use kinegrad_motion::quantiles::percentile;
use kinegrad_motion::{MotionMeasure, Phrase};
use serde::Serialize;

/// A measure of the movement over a set of motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MovementSpread {
    /// Name of the measure.
    pub name: &'static str,
    /// Title in tables.
    #[serde(skip)]
    pub title: &'static str,
    /// Unit of the measure.
    pub unit: &'static str,
    /// Median over the motions; median and percentiles are `None` if no motion has a finite value.
    pub median: Option<f64>,
    /// 1st percentile.
    pub p1: Option<f64>,
    /// 99th percentile.
    pub p99: Option<f64>,
}

/// All measures of the motions.
pub(super) fn movement_spreads<'a>(
    motions: impl Iterator<Item = &'a Phrase> + Clone,
) -> Vec<MovementSpread> {
    let spread = |measure: MotionMeasure| {
        let values = motions.clone().filter_map(|motion| measure.of(motion));
        let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        let at = |percent| (!values.is_empty()).then(|| percentile(values.clone(), percent));
        MovementSpread {
            name: measure.name(),
            title: measure.title(),
            unit: measure.unit(),
            median: at(50.0),
            p1: at(1.0),
            p99: at(99.0),
        }
    };
    MotionMeasure::ALL.into_iter().map(spread).collect()
}

#[cfg(test)]
mod tests {
    use kinegrad_data::synthetic;
    use kinegrad_motion::phrase::POSITION;

    use super::*;

    #[test]
    fn jerk_is_measured_on_the_path_and_not_on_the_channels() {
        let mut motions: Vec<Phrase> = (0..5)
            .map(|index| synthetic::phrase(index, 60, 1).motion)
            .collect();
        let jerk = |motions: &[Phrase]| {
            let spreads = movement_spreads(motions.iter());
            let found = spreads
                .into_iter()
                .find(|spread| spread.name == "path_jerk");
            found.and_then(|spread| spread.median).unwrap()
        };
        let before = jerk(&motions);
        for motion in &mut motions {
            // A zigzag of one centimeter below the channels of a smooth path.
            for t in (0..60).step_by(2) {
                let [x, y, z] = motion.vector(t, POSITION);
                motion.set_vector(t, POSITION, [x + 0.01, y, z]);
            }
        }
        let after = jerk(&motions);
        assert!(before < 100.0 && after > 1000.0, "{before} {after}");
    }

    #[test]
    fn motions_without_a_value_do_not_count() {
        let long = synthetic::phrase(0, 60, 1).motion;
        let short = long.slice(0..20);
        let mut broken = long.clone();
        broken.frame_mut(5)[0] = f32::NAN;
        let all = [long.clone(), short.clone(), broken];
        let travel = |motions: &[Phrase]| {
            let spreads = movement_spreads(motions.iter());
            spreads
                .into_iter()
                .find(|spread| spread.name == "travel")
                .unwrap()
        };
        let alone = travel(&all[..1]);
        assert_eq!(alone.median, MotionMeasure::Travel.of(&long));
        assert_eq!(travel(&all), alone);
        assert_eq!(travel(&[short]).median, None);
    }
}
