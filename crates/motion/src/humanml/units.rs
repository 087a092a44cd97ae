//! Conversion of published features to metres.
//!
//! HumanML3D is in metres, KIT-ML in millimetres. The roots of KIT-ML are hundreds of units above
//! the floor.

use super::FeatureLayout;

/// Roots whose mean height is above this are in millimetres.
pub(crate) const HIGHEST_ROOT: f64 = 10.0;

/// Metres in a millimetre.
pub(crate) const MILLIMETRE: f64 = 1e-3;

/// Channel of the root's height.
const HEIGHT: usize = 3;

impl FeatureLayout {
    /// True for channels that are lengths: root position, joint positions and displacements.
    fn is_length(self, channel: usize) -> bool {
        let [_, ground, height, positions, _, displacements, _] = self.groups();
        let lengths = [ground, height, positions, displacements];
        lengths.iter().any(|group| group.contains(&channel))
    }

    /// Features `[frames, channels]` in metres, converted if the mean height indicates millimetres.
    pub fn in_metres(self, mut rows: Vec<f32>) -> Vec<f32> {
        let heights = rows.chunks_exact(self.channels()).map(|row| row[HEIGHT]);
        let (frames, sum) = heights.fold((0, 0.0), |(n, sum), y| (n + 1, sum + f64::from(y)));
        if sum > HIGHEST_ROOT * f64::from(frames) {
            for row in rows.chunks_exact_mut(self.channels()) {
                let lengths = row.iter_mut().enumerate();
                for (_, value) in lengths.filter(|(channel, _)| self.is_length(*channel)) {
                    *value = (f64::from(*value) * MILLIMETRE) as f32;
                }
            }
        }
        rows
    }

    /// Mean and deviation of features, `[channels]` each, converted to metres from millimetres.
    ///
    /// # Panics
    /// Panics unless both have the layout's channels.
    pub fn statistics_in_metres(self, mean: &mut [f64], std: &mut [f64]) {
        let channels = self.channels();
        assert_eq!((mean.len(), std.len()), (channels, channels), "channels");
        if mean[HEIGHT] > HIGHEST_ROOT {
            for channel in (0..channels).filter(|channel| self.is_length(*channel)) {
                mean[channel] *= MILLIMETRE;
                std[channel] *= MILLIMETRE;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Extraction, Features, Joints, Root, Skeleton, test_clip};

    #[test]
    fn features_of_millimetres_become_those_of_metres() {
        let skeleton = Skeleton::kit();
        let layout = skeleton.layout();
        let joints = test_clip(&skeleton, 20);
        let extraction = |unit: f64| Extraction {
            rescale: false,
            contact_threshold: 0.002 * unit * unit,
            ..Extraction::default()
        };
        let metres = extraction(1.0).features(&skeleton, &joints).unwrap();
        let large = joints.as_slice().iter().map(|place| place.map(|v| 1e3 * v));
        let large = Joints::new(large.collect(), joints.joints()).unwrap();
        let published = extraction(1e3).features(&skeleton, &large).unwrap();
        assert!(published.frame(0)[3] > 100.0);
        let read = layout.in_metres(published.as_slice().to_vec());
        for (found, expected) in read.iter().zip(metres.as_slice()) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
        assert_eq!(
            layout.in_metres(metres.as_slice().to_vec()),
            metres.as_slice()
        );
        let read = Features::new(read, layout, Root::Relative).unwrap();
        let far = |joints: &Joints| joints.frame(joints.frames() - 1)[20];
        let pairs = far(&read.joints()).into_iter().zip(far(&metres.joints()));
        pairs.for_each(|(a, b)| assert!((a - b).abs() < 1e-4));

        // Normalized by statistics in the same unit, both are equal.
        let mut mean: Vec<f64> = published.frame(3).iter().map(|&v| f64::from(v)).collect();
        let mut std: Vec<f64> = (0..layout.channels()).map(|c| 1.0 + c as f64).collect();
        let (large_mean, large_std) = (mean.clone(), std.clone());
        layout.statistics_in_metres(&mut mean, &mut std);
        assert!(mean[3] < 2.0);
        for channel in 0..layout.channels() {
            let normalised = |row: &[f32], mean: &[f64], std: &[f64]| {
                (f64::from(row[channel]) - mean[channel]) / std[channel]
            };
            let before = normalised(published.frame(7), &large_mean, &large_std);
            let after = normalised(metres.frame(7), &mean, &std);
            assert!((before - after).abs() < 1e-3, "channel {channel}");
        }
        // A second conversion changes nothing.
        let again = (mean.clone(), std.clone());
        layout.statistics_in_metres(&mut mean, &mut std);
        assert_eq!((mean, std), again);
    }
}
