//! A matrix with one row per frame.

/// A matrix `[frames, width]` of single-precision values, one frame after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameMatrix {
    width: usize,
    values: Vec<f32>,
}

impl FrameMatrix {
    /// Zeros, `[frames, width]`.
    ///
    /// # Panics
    /// Panics if `width` is zero.
    pub fn zeros(frames: usize, width: usize) -> Self {
        assert!(width > 0, "a frame has at least one value");
        Self {
            width,
            values: vec![0.0; frames * width],
        }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.values.len() / self.width
    }

    /// Values in a frame.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The `width` values of frame `t`.
    ///
    /// # Panics
    /// Panics if `t` is not a frame.
    pub fn frame(&self, t: usize) -> &[f32] {
        &self.values[t * self.width..(t + 1) * self.width]
    }

    /// All values, row-major `[frames, width]`.
    pub fn as_slice(&self) -> &[f32] {
        &self.values
    }

    /// All values, row-major `[frames, width]`, for changes.
    pub fn as_mut_slice(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// The values of channel `c` over time.
    pub fn channel(&self, c: usize) -> impl Iterator<Item = f32> + '_ {
        self.values.chunks_exact(self.width).map(move |row| row[c])
    }

    /// The values as channel-major `[width, frames]`.
    pub fn channel_major(&self) -> Vec<f32> {
        let mut out = Vec::with_capacity(self.values.len());
        (0..self.width).for_each(|c| out.extend(self.channel(c)));
        out
    }
}
