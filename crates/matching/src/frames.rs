//! Matrices of motion, `[frames, channels]`, and their resampling.

use rayon::prelude::*;

/// A motion as a matrix `[frames, channels]`, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Frames {
    channels: usize,
    values: Vec<f32>,
}

impl Frames {
    /// A matrix of `values`, `[frames, channels]`, row-major.
    ///
    /// # Panics
    /// If `values` is not a multiple of `channels`, or `channels` is 0.
    pub fn new(channels: usize, values: Vec<f32>) -> Self {
        assert!(channels > 0 && values.len().is_multiple_of(channels));
        Self { channels, values }
    }

    /// A matrix of zeros, `[frames, channels]`. It panics like [`new`](Self::new).
    pub fn zeros(frames: usize, channels: usize) -> Self {
        Self::new(channels, vec![0.0; frames * channels])
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.values.len() / self.channels
    }

    /// All values, `[frames, channels]`, row-major.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// All values, mutable.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// Frame `t`, `[channels]`.
    ///
    /// # Panics
    /// If frame `t` does not exist.
    pub fn frame(&self, t: usize) -> &[f32] {
        &self.values[t * self.channels..(t + 1) * self.channels]
    }

    /// Frame `t`, `[channels]`, mutable. It panics like [`frame`](Self::frame).
    pub fn frame_mut(&mut self, t: usize) -> &mut [f32] {
        &mut self.values[t * self.channels..(t + 1) * self.channels]
    }

    /// Concatenation of matrices along frames.
    ///
    /// # Panics
    /// Panics if `parts` is empty or the channels differ.
    pub fn joined(parts: &[Self]) -> Self {
        let channels = parts[0].channels;
        assert!(parts.iter().all(|part| part.channels == channels));
        let values: Vec<&[f32]> = parts.iter().map(|part| part.values.as_slice()).collect();
        Self::new(channels, values.concat())
    }

    /// The channels `columns` in that order, `[frames, columns]`.
    ///
    /// # Panics
    /// Panics if `columns` is empty or a column does not exist.
    pub fn columns(&self, columns: &[usize]) -> Self {
        let rows = self.values.chunks_exact(self.channels);
        let values = rows.flat_map(|row| columns.iter().map(|&column| row[column]));
        Self::new(columns.len(), values.collect())
    }

    /// Linear resampling to `frames` with half-pixel centres: frame i is read at max(0, (i + 0.5) n
    /// / frames - 0.5), clamped at the end. No low-pass filter is applied.
    pub fn resampled(&self, frames: usize) -> Self {
        let scale = self.frames() as f64 / frames as f64;
        self.read_at(frames, |i| ((i + 0.5) * scale - 0.5).max(0.0))
    }

    /// [`resampled`](Self::resampled) of a loop.
    pub fn resampled_loop(&self, frames: usize) -> Self {
        let n = self.frames();
        let ends = [n - 1].into_iter().chain(0..n).chain([0]);
        let values = ends.flat_map(|t| self.frame(t)).copied().collect();
        let scale = n as f64 / frames as f64;
        Self::new(self.channels, values).read_at(frames, |i| (i + 0.5) * scale + 0.5)
    }

    /// Linear resampling to `frames` with aligned corners: frame i is read at i (n - 1) / (frames -
    /// 1).
    pub fn resampled_aligned(&self, frames: usize) -> Self {
        let scale = match frames {
            0 | 1 => 0.0,
            _ => (self.frames() - 1) as f64 / (frames - 1) as f64,
        };
        self.read_at(frames, |i| i * scale)
    }

    /// The linearly interpolated frame at `position`, clamped, `[channels]`.
    pub fn read(&self, position: f64) -> Vec<f32> {
        let position = position.max(0.0);
        self.read_at(1, |_| position).values
    }

    /// Frames at interpolated positions.
    fn read_at(&self, frames: usize, position: impl Fn(f64) -> f64 + Sync) -> Self {
        let last = self.frames() - 1;
        let mut read = Self::zeros(frames, self.channels);
        let rows = read.values.par_chunks_exact_mut(self.channels);
        rows.enumerate().for_each(|(i, row)| {
            let position = position(i as f64).min(last as f64);
            let left = position as usize;
            let part = (position - left as f64) as f32;
            let right = self.frame((left + 1).min(last));
            let pairs = self.frame(left).iter().zip(right);
            for (value, (a, b)) in row.iter_mut().zip(pairs) {
                *value = (1.0 - part) * a + part * b;
            }
        });
        read
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn ramp(frames: usize) -> Frames {
        let values = (0..frames).flat_map(|t| [t as f32, -2.0 * t as f32]);
        Frames::new(2, values.collect())
    }

    proptest! {
        #[test]
        fn a_straight_line_stays_one(frames in 2..60usize, to in 2..90usize) {
            let line = ramp(frames);
            let aligned = line.resampled_aligned(to);
            let step = (frames - 1) as f32 / (to - 1) as f32;
            let centred = line.resampled(to);
            let scale = frames as f32 / to as f32;
            for i in 0..to {
                let expected = i as f32 * step;
                prop_assert!((aligned.frame(i)[0] - expected).abs() < 1e-4);
                let expected = ((i as f32 + 0.5) * scale - 0.5).clamp(0.0, (frames - 1) as f32);
                prop_assert!((centred.frame(i)[0] - expected).abs() < 1e-4);
                prop_assert!((centred.frame(i)[1] + 2.0 * expected).abs() < 2e-4);
            }
        }

        #[test]
        fn its_own_length_changes_nothing(frames in 1..40usize) {
            let line = ramp(frames);
            prop_assert_eq!(&line.resampled(frames), &line);
        }
    }

    #[test]
    fn around_the_circle_the_ends_meet() {
        let circle = Frames::new(1, vec![0.0, 1.0, 2.0, 1.0]);
        let values = [0.25, 0.25, 0.75, 1.25, 1.75, 1.75, 1.25, 0.75];
        assert_eq!(circle.resampled_loop(8).values(), values);
        assert_eq!(circle.resampled_loop(4), circle);
    }

    #[test]
    fn columns_and_joints_keep_their_order() {
        let both = Frames::joined(&[ramp(2), ramp(3)]);
        assert_eq!(both.frames(), 5);
        assert_eq!(both.columns(&[1]).values(), [0.0, -2.0, 0.0, -2.0, -4.0]);
    }
}
