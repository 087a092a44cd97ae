//! [`ChannelEncoding::decode`] on tensors, with gradients: decodes predicted channels to the 25
//! channels.

use std::f64::consts::TAU;

use burn::tensor::Tensor;
use kinegrad_motion::channel_encoding::{LEAST_HARMONICS, LEAST_SQUARE};
use kinegrad_motion::phrase::QUATERNION;
use kinegrad_motion::{ChannelEncoding, OrientationEncoding, PhaseEncoding};

use crate::network::rotation::hemisphere;

/// Square of the radius below which the gradient of an angle stops growing.
const LEAST_RADIUS_SQUARE: f64 = 1e-4;

/// The 25 channels of predicted motion: a phase in [0, 1) with a gradient without wraps, and unit
/// quaternions without changes of sign. Gradients are finite everywhere, and treat signs, wraps and
/// the choice of a formula as constants.
///
/// # Shapes
/// - x: `[batch, channels, time]`, the channels of `targets` in physical units
/// - output: `[batch, 25, time]`
pub fn decode(targets: ChannelEncoding, x: Tensor<3>) -> Tensor<3> {
    if targets.are_stored_channels() {
        return x;
    }
    let part = |range: std::ops::Range<usize>| x.clone().narrow(1, range.start, range.len());
    let orientation = part(targets.orientation_channels());
    let phase = part(targets.phase_channels());
    Tensor::cat(
        vec![
            part(0..QUATERNION.start),
            match targets.orientation {
                OrientationEncoding::Quaternion => orientation,
                OrientationEncoding::CanonicalQuaternion => canonical_signs(unit(orientation)),
                OrientationEncoding::Rotation6d => canonical_signs(nearest_rotations(orientation)),
            },
            part(targets.angular_velocity_channels()),
            match targets.phase {
                PhaseEncoding::Scalar => phase,
                PhaseEncoding::SinCos | PhaseEncoding::Harmonics => turns_of(phase),
            },
            part(targets.style_channels()),
        ],
        1,
    )
}

/// The angle in turns from 0 to 1, `[batch, 1, time]`, from sines and cosines of the angle and its
/// multiples, `[batch, 2 multiples, time]`, as in [`ChannelEncoding::decode`].
fn turns_of(pairs: Tensor<3>) -> Tensor<3> {
    let multiples = pairs.dims()[1] / 2;
    let first = turns(pairs.clone().narrow(1, 0, 2));
    if multiples == 1 {
        return first;
    }
    let (mut moved, mut all) = (first.zeros_like(), first.zeros_like() + LEAST_HARMONICS);
    for k in 1..=multiples {
        let pair = pairs.clone().narrow(1, 2 * (k - 1), 2);
        let rest = turns(pair.clone()) - first.clone() * k as f64;
        let whole = rest.clone().without_autodiff().round();
        let weight = pair.square().sum_dim(1) * (k * k) as f64;
        moved = moved + weight.clone() * (rest - whole) / k as f64;
        all = all + weight;
    }
    let turn = first + moved / all;
    let whole = turn.clone().without_autodiff().floor();
    let turn = turn - whole;
    // Just below a whole turn rounds to it.
    let known = turn.clone().without_autodiff();
    turn - known.greater_equal_elem(1.0).float()
}

/// The angle of `[batch, (sine, cosine), time]` in turns from 0 to 1: `[batch, 1, time]`.
pub(crate) fn turns(circle: Tensor<3>) -> Tensor<3> {
    let component = |x: &Tensor<3>, index: usize| x.clone().narrow(1, index, 1);
    let known = circle.clone().without_autodiff();
    let (s0, c0) = (component(&known, 0), component(&known, 1));
    let angle = s0.clone().atan2(c0.clone()) / TAU;
    let wrapped = angle.clone() + angle.lower_elem(0.0).float();
    // Just below a whole turn rounds to it.
    let whole = wrapped.clone().greater_equal_elem(1.0);
    let wrapped = wrapped.mask_fill(whole, 0.0);
    // The gradient of atan2, NaN at zero, is (c ds - s dc) / r^2: a term with value 0 adds this
    // gradient.
    let square = (s0.clone().square() + c0.clone().square()).clamp_min(LEAST_RADIUS_SQUARE);
    let around = component(&circle, 0) * c0 - component(&circle, 1) * s0;
    around / square / TAU + wrapped
}

/// `x` divided by its Euclidean norm over the channels; values near zero are divided by a small
/// number.
fn unit(x: Tensor<3>) -> Tensor<3> {
    let square = x.clone().square().sum_dim(1);
    x / square.clamp_min(LEAST_SQUARE).sqrt()
}

/// Unit quaternions `[batch, 4, time]`, of any sign, for the first two matrix columns `[batch, 6,
/// time]`. The rotations' orthonormal columns are nearest to the given columns, as in
/// [`nearest_rotation`](kinegrad_motion::channel_encoding::nearest_rotation).
fn nearest_rotations(columns: Tensor<3>) -> Tensor<3> {
    let parts = |x: &Tensor<3>| [0, 1, 2].map(|index| x.clone().narrow(1, index, 1));
    let cross = |p: &Tensor<3>, q: &Tensor<3>, r: &Tensor<3>, s: &Tensor<3>| {
        p.clone() * q.clone() - r.clone() * s.clone()
    };
    let normal = |a: &[Tensor<3>; 3], b: &[Tensor<3>; 3]| {
        let ([ax, ay, az], [bx, by, bz]) = (a, b);
        [
            cross(ay, bz, az, by),
            cross(az, bx, ax, bz),
            cross(ax, by, ay, bx),
        ]
    };
    let a = columns.clone().narrow(1, 0, 3);
    let b = columns.narrow(1, 3, 3);
    let area = Tensor::cat(normal(&parts(&a), &parts(&b)).to_vec(), 1);
    let s = area.square().sum_dim(1).clamp_min(LEAST_SQUARE).sqrt();
    let dot = |x: &Tensor<3>, y: &Tensor<3>| (x.clone() * y.clone()).sum_dim(1);
    let (p, q, r) = (dot(&a, &a), dot(&b, &b), dot(&a, &b));
    let scale = ((p.clone() + q.clone() + s.clone() * 2.0).sqrt() * s.clone()).recip();
    let first = (a.clone() * (q + s.clone()) - b.clone() * r.clone()) * scale.clone();
    let second = (b * (p + s) - a * r) * scale;
    let (a, b) = (parts(&first), parts(&second));
    let [cx, cy, cz] = normal(&a, &b);
    let ([ax, ay, az], [bx, by, bz]) = (a, b);
    // In the matrix 4 q q^T, the row with the largest diagonal element (at least 1) is a multiple
    // of q.
    let (wx, wy, wz) = (
        bz.clone() - cy.clone(),
        cx.clone() - az.clone(),
        ay.clone() - bx.clone(),
    );
    let (xy, xz, yz) = (ay + bx, cx + az, bz + cy);
    let diagonal = [
        ax.clone() + by.clone() + cz.clone(),
        ax.clone() - by.clone() - cz.clone(),
        by.clone() - ax.clone() - cz.clone(),
        cz - ax - by,
    ]
    .map(|trace| trace + 1.0);
    let known = diagonal.clone().map(Tensor::without_autodiff);
    let chosen = Tensor::cat(known.to_vec(), 1).argmax(1);
    let [ww, xx, yy, zz] = diagonal;
    let rows = [
        [&ww, &wx, &wy, &wz],
        [&wx, &xx, &xy, &xz],
        [&wy, &xy, &yy, &yz],
        [&wz, &xz, &yz, &zz],
    ];
    let picked = rows.into_iter().enumerate().map(|(index, row)| {
        let row = Tensor::cat(row.map(Clone::clone).to_vec(), 1);
        row * chosen.clone().equal_elem(index as i64).float()
    });
    let row = picked.reduce(|sum, row| sum + row).expect("four rows");
    unit(row)
}

/// Negates unit quaternions `[batch, 4, time]` so that the first has `w >= 0` and each lies in the
/// hemisphere of its predecessor. The gradient treats the signs as constants.
fn canonical_signs(quaternion: Tensor<3>) -> Tensor<3> {
    let first = quaternion.clone().without_autodiff().narrow(2, 0, 1);
    sign_continuous(quaternion * hemisphere(first.narrow(1, 0, 1)))
}

/// Negates quaternions `[batch, 4, time]` so that each lies in the hemisphere of its predecessor.
/// The gradient treats the signs as constants.
pub(crate) fn sign_continuous(quaternion: Tensor<3>) -> Tensor<3> {
    let time = quaternion.dims()[2];
    if time < 2 {
        return quaternion;
    }
    let known = quaternion.clone().inner();
    let dots = (known.clone().narrow(2, 1, time - 1) * known.narrow(2, 0, time - 1)).sum_dim(1);
    let flips = hemisphere(dots);
    let signs = Tensor::cat(vec![flips.clone().narrow(2, 0, 1).ones_like(), flips], 2).cumprod(2);
    quaternion * signs
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_kernels::host_values;
    use kinegrad_random::{Key, Purpose};

    use super::*;

    fn all() -> Vec<ChannelEncoding> {
        use OrientationEncoding::{CanonicalQuaternion, Quaternion, Rotation6d};
        let phases = [
            PhaseEncoding::Scalar,
            PhaseEncoding::SinCos,
            PhaseEncoding::Harmonics,
        ];
        let of_phase = |phase| {
            [Quaternion, CanonicalQuaternion, Rotation6d]
                .map(|orientation| ChannelEncoding { phase, orientation })
        };
        phases.into_iter().flat_map(of_phase).collect()
    }

    fn normals(seed: u64, count: usize) -> Vec<f32> {
        Key::new(seed, Purpose::Noise).normals(count)
    }

    fn tensor(values: Vec<f32>, shape: [usize; 3], device: &Device) -> Tensor<3> {
        Tensor::from_data(TensorData::new(values, shape), device)
    }

    #[test]
    fn tensors_decode_as_rows_do() {
        let (batch, time) = (3, 11);
        for targets in all() {
            let channels = targets.channels();
            let x = normals(4, batch * channels * time);
            let found = host_values(decode(
                targets,
                tensor(x.clone(), [batch, channels, time], &Device::flex()),
            ));
            for (item, (x, found)) in x
                .chunks(channels * time)
                .zip(found.chunks(25 * time))
                .enumerate()
            {
                let rows = (0..time).flat_map(|t| (0..channels).map(move |c| x[c * time + t]));
                let expected = targets.decode(rows.collect());
                for (index, expected) in expected.iter().enumerate() {
                    let (t, channel) = (index / 25, index % 25);
                    let found = found[channel * time + t];
                    let error = (found - expected).abs();
                    assert!(
                        error < 2e-5,
                        "{targets:?}, item {item}, frame {t}, channel {channel}: {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn gradients_are_those_of_differences() {
        let device = Device::flex().autodiff();
        for targets in all() {
            let shape = [2, targets.channels(), 3];
            let count: usize = shape.iter().product();
            let x = normals(9, count);
            let direction = normals(10, 2 * 25 * 3);
            let weighed = |x: Tensor<3>, device: &Device| {
                (decode(targets, x) * tensor(direction.clone(), [2, 25, 3], device)).sum()
            };
            let input = tensor(x.clone(), shape, &device).require_grad();
            let mut gradients = weighed(input.clone(), &device).backward();
            let found = host_values(input.grad_remove(&mut gradients).unwrap());
            for index in 0..count {
                let at = |step: f32| {
                    let mut moved = x.clone();
                    moved[index] += step;
                    let plain = Device::flex();
                    let value = weighed(tensor(moved, shape, &plain), &plain);
                    f64::from(value.into_scalar::<f32>())
                };
                let expected = (at(5e-3) - at(-5e-3)) / 1e-2;
                let error = (f64::from(found[index]) - expected).abs();
                let allowed = 2e-2 * expected.abs().max(1.0);
                assert!(
                    error < allowed,
                    "{targets:?}, {index}: {} for {expected}",
                    found[index]
                );
            }
        }
    }

    #[test]
    fn nothing_breaks_at_zero_and_at_half_turns() {
        let device = Device::flex().autodiff();
        let targets = ChannelEncoding {
            phase: PhaseEncoding::SinCos,
            orientation: OrientationEncoding::Rotation6d,
        };
        let channels = targets.channels();
        // Zeros; no rotation; half a turn about each axis; two equal columns.
        let columns: [[f32; 6]; 6] = [
            [0.0; 6],
            [1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            [1.0, 0.0, 0.0, 0.0, -1.0, 0.0],
            [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0],
            [1.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        ];
        let mut x = vec![0.0; columns.len() * channels];
        for (frame, columns) in x.chunks_mut(channels).zip(columns) {
            frame[targets.orientation_channels()].copy_from_slice(&columns);
        }
        let x = tensor(x, [columns.len(), channels, 1], &device).require_grad();
        let decoded = decode(targets, x.clone());
        let mut gradients = decoded.clone().square().sum().backward();
        let gradient = host_values(x.grad_remove(&mut gradients).unwrap());
        let decoded = host_values(decoded);
        assert!(
            decoded
                .iter()
                .chain(&gradient)
                .all(|value| value.is_finite())
        );
        for frame in decoded.chunks(25) {
            let square: f32 = frame[QUATERNION].iter().map(|part| part * part).sum();
            assert!((square - 1.0).abs() < 1e-5, "{square}");
        }
    }
}
