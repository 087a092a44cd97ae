//! Receptive fields of convolutions.

/// Kernel size, stride and padding of a convolution over time.
///
/// A convolution *gathers*: output frame `t` reads input frame `t stride - padding + k` through tap
/// `k`. Its input gradient *scatters* along the same pairs in reverse. A transposed convolution
/// scatters, and its input gradient gathers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Geometry {
    /// Taps.
    pub kernel: usize,
    /// Frames of the long side per frame of the short side.
    pub stride: usize,
    /// Frames by which the first window precedes the first frame.
    pub padding: usize,
}

/// Rows `first, first + step, ...` of a product's output, each from a window of consecutive source
/// rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Phase {
    /// First output row.
    pub first: usize,
    /// Distance of the output rows.
    pub step: usize,
    /// Number of output rows.
    pub rows: usize,
    /// First source row of the first window; negative before the first row.
    pub source_first: isize,
    /// Distance of the windows in source rows.
    pub source_step: usize,
    /// The tap of each row of a window.
    pub taps: Vec<usize>,
}

impl Geometry {
    /// Output frames of a convolution of `long` frames.
    ///
    /// # Panics
    /// Panics if the kernel does not fit into the padded frames.
    pub fn short(&self, long: usize) -> usize {
        let padded = long + 2 * self.padding;
        assert!(
            padded >= self.kernel,
            "a kernel of {} on {padded} frames",
            self.kernel
        );
        (padded - self.kernel) / self.stride + 1
    }

    /// Output frames of a transposed convolution of `short` frames.
    ///
    /// # Panics
    /// Panics if no frame is left.
    pub fn long(&self, short: usize) -> usize {
        assert!(short > 0, "a transposed convolution of no frame");
        let reached = (short - 1) * self.stride + self.kernel;
        assert!(
            reached > 2 * self.padding,
            "a transposed convolution without frames"
        );
        reached - 2 * self.padding
    }

    /// Output rows of one direction.
    pub(crate) fn phases(&self, gathers: bool, rows: usize) -> Vec<Phase> {
        match gathers {
            true => self.gather(rows),
            false => self.scatter(rows),
        }
    }

    /// Output rows on the short side.
    pub(crate) fn gather(&self, short: usize) -> Vec<Phase> {
        vec![Phase {
            first: 0,
            step: 1,
            rows: short,
            source_first: -(self.padding as isize),
            source_step: self.stride,
            taps: (0..self.kernel).collect(),
        }]
    }

    /// Output rows on the long side: rows of equal remainder by the stride use the same taps.
    pub(crate) fn scatter(&self, long: usize) -> Vec<Phase> {
        let stride = self.stride;
        (0..stride.min(long))
            .map(|first| {
                // Row u = r stride + first comes from source row r + (first + padding - k) / stride
                // through tap k: a larger tap is an earlier row.
                let remainder = (first + self.padding) % stride;
                let taps: Vec<usize> = (remainder..self.kernel).step_by(stride).rev().collect();
                let earliest = taps.first().copied().unwrap_or(remainder);
                Phase {
                    first,
                    step: stride,
                    rows: (long - first).div_ceil(stride),
                    source_first: ((first + self.padding) as isize - earliest as isize)
                        / stride as isize,
                    source_step: 1,
                    taps,
                }
            })
            .collect()
    }
}

/// Zero rows that the windows of `phases` need before and after `rows` source rows.
pub(crate) fn margins(phases: &[Phase], rows: usize) -> (usize, usize) {
    let before = phases.iter().map(|phase| -phase.source_first).max();
    let after = phases.iter().map(|phase| {
        let last = (phase.rows - 1) * phase.source_step + phase.taps.len();
        phase.source_first + last as isize - rows as isize
    });
    let margin = |rows: Option<isize>| rows.unwrap_or(0).max(0) as usize;
    (margin(before), margin(after.max()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every (output row, source row, tap) of the phases.
    fn triples(phases: &[Phase], source_rows: usize) -> Vec<(usize, usize, usize)> {
        let mut all = Vec::new();
        for phase in phases {
            for r in 0..phase.rows {
                for (j, &tap) in phase.taps.iter().enumerate() {
                    let source = phase.source_first + (r * phase.source_step + j) as isize;
                    if (0..source_rows as isize).contains(&source) {
                        all.push((phase.first + r * phase.step, source as usize, tap));
                    }
                }
            }
        }
        all
    }

    #[test]
    fn scattering_is_gathering_in_reverse() {
        for kernel in 1..6 {
            for stride in 1..4 {
                for padding in 0..=kernel / 2 {
                    let geometry = Geometry {
                        kernel,
                        stride,
                        padding,
                    };
                    for long in (kernel.max(2)..14).filter(|long| long + 2 * padding >= kernel) {
                        let short = geometry.short(long);
                        let mut gathered = triples(&geometry.gather(short), long);
                        let mut scattered: Vec<_> = triples(&geometry.scatter(long), short)
                            .into_iter()
                            .map(|(u, s, k)| (s, u, k))
                            .collect();
                        gathered.sort_unstable();
                        scattered.sort_unstable();
                        assert_eq!(gathered, scattered, "{geometry:?} on {long} frames");
                    }
                }
            }
        }
    }
}
