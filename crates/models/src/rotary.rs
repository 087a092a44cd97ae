//! Rotary positions (Su et al. 2021, <https://arxiv.org/abs/2104.09864>).

use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_kernels::{LinearMap, linear_map};

/// Rotates channels of each head by the frame's position. The product of a query and a key then
/// depends only on the distance between their frames:
///
/// ```text
/// [a_i | b_i] -> [a_i cos(t f_i) - b_i sin(t f_i) | a_i sin(t f_i) + b_i cos(t f_i)]
/// f_i = 10000^(-i / h)
/// ```
///
/// `a` and `b` are the halves of the first `2 h` channels of a head. The other channels are not
/// rotated.
#[derive(Clone, Debug)]
pub struct Rotation {
    /// Rotated channels of a head.
    channels: usize,
    /// `[1 or batch, time, 1, half]`.
    cos: Tensor<4>,
    sin: Tensor<4>,
}

impl Rotation {
    /// Rotates the first `channels` (even) channels of each head, in the motions with a true entry
    /// in `turns`. A single entry applies to all motions.
    pub fn new(channels: usize, time: usize, turns: &[bool], device: &Device) -> Self {
        let positions: Vec<usize> = (0..time).collect();
        Self::at(channels, &positions, turns, device)
    }

    /// [`new`](Self::new) for tokens at these positions, `[time]`.
    pub fn at(channels: usize, positions: &[usize], turns: &[bool], device: &Device) -> Self {
        let (half, time) = (channels / 2, positions.len());
        let angles = angles(half, positions.iter().copied());
        let table = |of: fn(f64) -> f64| {
            let angles = &angles;
            let values = turns.iter().flat_map(|turns| {
                let factor = f64::from(u8::from(*turns));
                angles.iter().map(move |angle| of(factor * angle) as f32)
            });
            let data = TensorData::new(values.collect::<Vec<_>>(), [turns.len(), time, 1, half]);
            Tensor::from_data(data, device)
        };
        Self {
            channels,
            cos: table(f64::cos),
            sin: table(f64::sin),
        }
    }

    /// # Shapes
    /// - x, output: `[batch, channels, time]`, the channels of a head contiguous
    pub fn turn(&self, x: Tensor<3>, num_heads: usize) -> Tensor<3> {
        let [batch, channels, time] = x.dims();
        let (head, half) = (channels / num_heads, self.channels / 2);
        // Kernels write the channels of a frame contiguously in memory.
        let heads = x.swap_dims(1, 2).reshape([batch, time, num_heads, head]);
        let part = |first, count| heads.clone().narrow(3, first, count);
        let (a, b) = (part(0, half), part(half, half));
        let mut turned = vec![
            a.clone() * self.cos.clone() - b.clone() * self.sin.clone(),
            a * self.sin.clone() + b * self.cos.clone(),
        ];
        if self.channels < head {
            turned.push(part(self.channels, head - self.channels));
        }
        Tensor::cat(turned, 3)
            .reshape([batch, time, channels])
            .swap_dims(1, 2)
    }
}

/// The angles of the frequencies at each position, `[time, half]`. Computed in double precision on the
/// host, like the timestep embedding.
fn angles(half: usize, positions: impl Iterator<Item = usize>) -> Vec<f64> {
    let frequencies = (0..half).map(|i| 10_000f64.powf(-(i as f64) / half as f64));
    let frequencies: Vec<f64> = frequencies.collect();
    let of_frame = |t| {
        frequencies
            .iter()
            .map(move |frequency| t as f64 * frequency)
    };
    positions.flat_map(of_frame).collect()
}

/// Rotates all channels of each head, an even number ([`Rotation`]).
///
/// # Shapes
/// - x, output: `[batch, channels, time]`, the channels of a head contiguous
pub fn rotate(x: Tensor<3>, num_heads: usize) -> Tensor<3> {
    let [_, channels, time] = x.dims();
    let half = channels / num_heads / 2;
    let angles = angles(half, 0..time);
    // As columns, because a sample's frames are contiguous.
    let table = |of: fn(f64) -> f64| {
        let columns = (0..half).flat_map(|i| angles.iter().skip(i).step_by(half));
        columns.map(|angle| of(*angle) as f32).collect()
    };
    let (cos, sin) = (table(f64::cos), table(f64::sin));
    linear_map(
        x,
        Arc::new(Rotated {
            num_heads,
            cos,
            sin,
        }),
    )
}

/// The rotation of all motions as a map of one.
#[derive(Debug)]
struct Rotated {
    num_heads: usize,
    /// `[half, time]`.
    cos: Vec<f32>,
    sin: Vec<f32>,
}

impl Rotated {
    /// Rotates by the angles times `sign`.
    fn turn(&self, values: &[f32], turned: &mut [f32], sign: f32) {
        let head = values.len() / self.num_heads;
        let heads = values.chunks(head).zip(turned.chunks_mut(head));
        for (values, turned) in heads {
            let (a, b) = values.split_at(head / 2);
            let (turned_a, turned_b) = turned.split_at_mut(head / 2);
            for (index, (cos, sin)) in self.cos.iter().zip(&self.sin).enumerate() {
                let (a, b, sin) = (a[index], b[index], sign * sin);
                turned_a[index] = a * cos - b * sin;
                turned_b[index] = a * sin + b * cos;
            }
        }
    }
}

impl LinearMap for Rotated {
    fn shape(&self, channels: usize, frames: usize) -> [usize; 2] {
        [channels, frames]
    }

    fn apply(&self, values: &[f32], mapped: &mut [f32]) {
        self.turn(values, mapped, 1.0);
    }

    fn adjoint(&self, gradient: &[f32], mapped: &mut [f32]) {
        self.turn(gradient, mapped, -1.0);
    }

    fn composed(&self, x: Tensor<3>) -> Tensor<3> {
        let [_, channels, time] = x.dims();
        let head = channels / self.num_heads;
        Rotation::new(head, time, &[true], &x.device()).turn(x, self.num_heads)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADS: usize = 3;

    /// The same vector `values` in every frame.
    fn constant(values: &[f32], time: usize) -> Tensor<3> {
        let repeated: Vec<f32> = values.iter().flat_map(|&v| vec![v; time]).collect();
        let data = TensorData::new(repeated, [1, values.len(), time]);
        Tensor::from_data(data, &Device::flex())
    }

    /// Products of queries and keys of each head: `[heads, time, time]`.
    fn scores(time: usize) -> Vec<f32> {
        let values = |phase: f32| -> Vec<f32> {
            let channels = HEADS * 6;
            (0..channels)
                .map(|i| (1.3 * i as f32 + phase).sin())
                .collect()
        };
        let heads = |phase: f32| {
            let turned = rotate(constant(&values(phase), time), HEADS);
            turned.reshape([HEADS, 6, time])
        };
        let products = heads(0.0).swap_dims(1, 2).matmul(heads(2.0));
        products.try_into_vec_as::<f32>().expect("float32")
    }

    #[test]
    fn products_depend_on_the_distance_of_two_frames_alone() {
        let time = 7;
        let scores = scores(time);
        for head in scores.chunks(time * time) {
            let at = |query: usize, key: usize| head[query * time + key];
            for query in 1..time {
                for key in 1..time {
                    assert!((at(query, key) - at(query - 1, key - 1)).abs() < 1e-5);
                }
            }
            let spread = (1..time).map(|key| (at(0, key) - at(0, 0)).abs());
            assert!(spread.fold(0.0, f32::max) > 0.05, "{head:?}");
        }
    }

    #[test]
    fn the_first_frame_and_all_norms_stay() {
        let x = constant(&[0.5, -1.0, 2.0, 3.0], 4);
        let turned = rotate(x.clone(), 1);
        let first = |x: &Tensor<3>| x.clone().narrow(2, 0, 1);
        assert_eq!(first(&turned).into_data(), first(&x).into_data());
        let lengths = |x: Tensor<3>| x.square().sum_dim(1);
        let apart = (lengths(turned) - lengths(x)).abs().max();
        assert!(apart.into_scalar::<f32>() < 1e-5);
    }
}
