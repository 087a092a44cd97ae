//! Transposes lines of a weight, because products load neighboring columns.

#[cfg(target_arch = "x86_64")]
use super::simd::fetch;

/// Lines transposed at once: their writes fill a cache line.
pub(crate) const LINES: usize = 16;

/// Transposes lines of equal length: `panel[c stride + i] = lines[i][c]`. Prefetches `next`, the
/// following lines, because waiting for weights took two thirds of the time.
///
/// # Panics
/// Panics if a line is shorter than the first, or the panel too short.
#[inline(always)]
pub(crate) fn write_columns(
    lines: [&[f32]; LINES],
    stride: usize,
    panel: &mut [f32],
    next: &[f32],
) {
    let length = lines[0].len();
    let lines = lines.map(|line| &line[..length]);
    let done = turn_blocks(lines, stride, panel, next);
    for c in done..length {
        let out = &mut panel[c * stride..][..LINES];
        for (out, line) in out.iter_mut().zip(&lines) {
            *out = line[c];
        }
    }
}

/// Transposes all full blocks and returns the elements of each line that it covered.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn turn_blocks(lines: [&[f32]; LINES], stride: usize, panel: &mut [f32], next: &[f32]) -> usize {
    let Some(simd) = pulp::x86::V3::try_new() else {
        return 0;
    };
    let blocks = lines[0].len() / avx::SIDE;
    // The slices have equal lengths, so that no access below is checked.
    let lines = lines.map(|line| &line.as_chunks::<{ avx::SIDE }>().0[..blocks]);
    simd.vectorize(
        #[inline(always)]
        || {
            let panels = panel.chunks_mut(avx::SIDE * stride).take(blocks);
            for (c, panel) in panels.enumerate() {
                let ahead = c * avx::SIDE * LINES..(c + 1) * avx::SIDE * LINES;
                fetch(next.get(ahead).unwrap_or_default());
                avx::turn(simd, std::array::from_fn(|i| &lines[i][c]), stride, panel);
                let second = std::array::from_fn(|i| &lines[avx::SIDE + i][c]);
                avx::turn(simd, second, stride, &mut panel[avx::SIDE..]);
            }
        },
    );
    blocks * avx::SIDE
}

#[cfg(not(target_arch = "x86_64"))]
fn turn_blocks(_: [&[f32]; LINES], _: usize, _: &mut [f32], _: &[f32]) -> usize {
    0
}

#[cfg(target_arch = "x86_64")]
mod avx {
    use pulp::x86::V3;

    /// Lines and columns of a block.
    pub const SIDE: usize = 8;

    /// Transposes a block in registers: pairs of neighbors, then pairs of pairs, then halves.
    #[inline(always)]
    pub fn turn(simd: V3, lines: [&[f32; SIDE]; SIDE], stride: usize, panel: &mut [f32]) {
        const FIRST_PAIRS: i32 = 0b01_00_01_00;
        const SECOND_PAIRS: i32 = 0b11_10_11_10;
        const LOW_HALVES: i32 = 0x20;
        const HIGH_HALVES: i32 = 0x31;
        let avx = simd.avx;
        let lines = lines.map(|line| pulp::cast(*line));
        let pairs: [_; SIDE] = std::array::from_fn(|i| {
            let (a, b) = (lines[i / 2 * 2], lines[i / 2 * 2 + 1]);
            match i % 2 {
                0 => avx._mm256_unpacklo_ps(a, b),
                _ => avx._mm256_unpackhi_ps(a, b),
            }
        });
        let quarters: [_; SIDE] = std::array::from_fn(|i| {
            let first = i / 4 * 4 + i % 4 / 2;
            let (a, b) = (pairs[first], pairs[first + 2]);
            match i % 2 {
                0 => avx._mm256_shuffle_ps::<FIRST_PAIRS>(a, b),
                _ => avx._mm256_shuffle_ps::<SECOND_PAIRS>(a, b),
            }
        });
        for (c, out) in panel.chunks_mut(stride).enumerate().take(SIDE) {
            let (a, b) = (quarters[c % 4], quarters[c % 4 + 4]);
            let column = match c / 4 {
                0 => avx._mm256_permute2f128_ps::<LOW_HALVES>(a, b),
                _ => avx._mm256_permute2f128_ps::<HIGH_HALVES>(a, b),
            };
            let column: [f32; SIDE] = pulp::cast(column);
            out[..SIDE].copy_from_slice(&column);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_any_length_are_columns() {
        for length in [0, 1, 7, 8, 9, 16, 31, 64] {
            for stride in [LINES, 20, 64] {
                let value = |i: usize, c: usize| (1000 * i + c) as f32;
                let lines: Vec<Vec<f32>> = (0..LINES)
                    .map(|i| (0..length).map(|c| value(i, c)).collect())
                    .collect();
                let mut panel = vec![-1.0; length * stride];
                write_columns(
                    std::array::from_fn(|i| &lines[i][..]),
                    stride,
                    &mut panel,
                    &[],
                );
                for (c, row) in panel.chunks(stride).enumerate() {
                    for (i, &found) in row.iter().enumerate() {
                        let expected = if i < LINES { value(i, c) } else { -1.0 };
                        assert_eq!(found, expected, "{length} {stride}: line {i}, column {c}");
                    }
                }
            }
        }
    }
}
