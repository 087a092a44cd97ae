//! Range, mean and standard deviation of channels.

use serde::{Deserialize, Serialize};

/// Measured range, mean and deviation of each channel; [`Statistics`](crate::Statistics) may
/// differ.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct ChannelMoments {
    /// Mean of each channel, `[channels]`.
    pub mean: Vec<f64>,
    /// Standard deviation of each channel (of the population), `[channels]`.
    pub std: Vec<f64>,
    /// Smallest value of each channel, `[channels]`.
    pub min: Vec<f64>,
    /// Largest value of each channel, `[channels]`.
    pub max: Vec<f64>,
    /// Number of frames of all items.
    pub frames: usize,
    /// Number of items.
    pub items: usize,
}

impl ChannelMoments {
    /// Measures items `[frames, channels]`, row-major. All frames have the same weight.
    pub fn measure<'a>(channels: usize, items: impl IntoIterator<Item = &'a [f32]>) -> Self {
        let items: Vec<&[f32]> = items.into_iter().collect();
        let frames = items.iter().map(|item| item.len()).sum::<usize>() / channels;
        assert!(frames > 0, "moments of no frames");
        let column = |channel: usize| {
            let items = items.iter().map(|item| item.iter());
            let values = items.flat_map(move |values| values.skip(channel).step_by(channels));
            values.map(|&value| f64::from(value))
        };
        let each = |of: &dyn Fn(usize) -> f64| (0..channels).map(of).collect();
        let (mean, std) = (0..channels).map(|c| mean_and_deviation(column(c))).unzip();
        Self {
            mean,
            std,
            min: each(&|c| column(c).fold(f64::INFINITY, f64::min)),
            max: each(&|c| column(c).fold(f64::NEG_INFINITY, f64::max)),
            frames,
            items: items.len(),
        }
    }

    /// Adds the moments of further items exactly (Chan, Golub and LeVeque 1979).
    pub fn merge(&mut self, other: &Self) {
        let (n, m) = (self.frames as f64, other.frames as f64);
        let total = n + m;
        for channel in 0..self.mean.len() {
            let apart = other.mean[channel] - self.mean[channel];
            let squares = n * self.std[channel].powi(2)
                + m * other.std[channel].powi(2)
                + apart.powi(2) * n * m / total;
            self.mean[channel] += apart * m / total;
            self.std[channel] = (squares / total).sqrt();
            self.min[channel] = self.min[channel].min(other.min[channel]);
            self.max[channel] = self.max[channel].max(other.max[channel]);
        }
        self.frames += other.frames;
        self.items += other.items;
    }
}

/// Mean of values; NaN without values.
pub(crate) fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// Mean and population standard deviation.
pub(crate) fn mean_and_deviation(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    // Two passes: a difference of sums of squares would lose small deviations.
    let squares = values.map(|value| (value - mean).powi(2));
    (mean, (squares.sum::<f64>() / count).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_weighs_the_same() {
        let rows = |values: &[f32]| -> Vec<f32> { values.iter().flat_map(|&v| [v; 3]).collect() };
        let (long, short) = (rows(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0]), rows(&[9.0]));
        let moments = ChannelMoments::measure(3, [&long[..], &short]);
        assert_eq!((moments.frames, moments.items), (8, 2));
        for channel in 0..3 {
            assert_eq!((moments.mean[channel], moments.std[channel]), (5.0, 2.0));
            assert_eq!((moments.min[channel], moments.max[channel]), (2.0, 9.0));
        }
    }

    #[test]
    fn merged_moments_are_those_of_all_items() {
        let item = |frames: usize, scale: f32| -> Vec<f32> {
            let values = (0..frames * 7).map(|i| scale * ((i * 7919) % 101) as f32 - 3.0);
            values.collect()
        };
        let items = [item(5, 0.01), item(40, 1.0), item(1, -2.0)];
        let together = ChannelMoments::measure(7, items.iter().map(Vec::as_slice));
        let mut merged = ChannelMoments::measure(7, [&items[0][..]]);
        for item in &items[1..] {
            merged.merge(&ChannelMoments::measure(7, [&item[..]]));
        }
        for channel in 0..7 {
            assert!((merged.mean[channel] - together.mean[channel]).abs() < 1e-12);
            assert!((merged.std[channel] - together.std[channel]).abs() < 1e-12);
        }
        assert_eq!((&merged.min, &merged.max), (&together.min, &together.max));
        assert_eq!((merged.frames, merged.items), (46, 3));
    }
}
