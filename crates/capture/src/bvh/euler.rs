//! Angles about three axes in any order.

use kinegrad_motion::Quaternion;

use super::Axis;

/// The intrinsic angles in degrees about `axes` of a quaternion of any nonzero norm. Of all angles
/// of the same rotation, those nearest to `before` are taken.
pub(super) fn degrees(rotation: Quaternion, axes: [Axis; 3], before: [f64; 3]) -> [f64; 3] {
    let rotation = rotation.normalised();
    let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e| rotation.rotate(e));
    // The matrix with the axes in the order of the turns. If that order is left-handed, every angle
    // changes its sign.
    let entry = |row: usize, column: usize| columns[axes[column] as usize][axes[row] as usize];
    let cyclic = (axes[0] as usize + 1) % 3 == axes[1] as usize;
    let signed = |angles: [f64; 3]| angles.map(|angle| if cyclic { angle } else { -angle });
    let first_before = signed(before);
    let sine = entry(0, 2).clamp(-1.0, 1.0);
    if sine.abs() > 1.0 - 1e-12 {
        // After a middle angle of a quarter turn, the other two axes coincide: the last angle stays
        // and the first takes the rest.
        let both = entry(2, 1).atan2(entry(1, 1)).to_degrees();
        let last = first_before[2];
        let first = both - last * sine.signum();
        return nearest(signed([first, sine.asin().to_degrees(), last]), before);
    }
    let first = (-entry(1, 2)).atan2(entry(2, 2)).to_degrees();
    let middle = sine.asin().to_degrees();
    let last = (-entry(0, 1)).atan2(entry(0, 0)).to_degrees();
    // The two triples of angles of the same rotation.
    let both = [
        [first, middle, last],
        [first + 180.0, 180.0 - middle, last + 180.0],
    ];
    let [one, other] = both.map(|angles| nearest(signed(angles), before));
    let distance = |angles: [f64; 3]| -> f64 {
        let apart = angles.iter().zip(before).map(|(a, b)| (a - b).abs());
        apart.sum()
    };
    if distance(other) < distance(one) {
        other
    } else {
        one
    }
}

/// Shifts each angle by full turns to be nearest to the angle before; degrees.
fn nearest(angles: [f64; 3], before: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| angles[i] - 360.0 * ((angles[i] - before[i]) / 360.0).round())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const ORDERS: [[Axis; 3]; 6] = [
        [Axis::X, Axis::Y, Axis::Z],
        [Axis::Y, Axis::Z, Axis::X],
        [Axis::Z, Axis::X, Axis::Y],
        [Axis::Z, Axis::Y, Axis::X],
        [Axis::Y, Axis::X, Axis::Z],
        [Axis::X, Axis::Z, Axis::Y],
    ];

    fn turn(axes: [Axis; 3], angles: [f64; 3]) -> Quaternion {
        axes.into_iter()
            .zip(angles)
            .map(|(axis, angle)| {
                let mut vector = [0.0; 3];
                vector[axis as usize] = angle.to_radians();
                Quaternion::from_rotation_vector(vector)
            })
            .fold(Quaternion::IDENTITY, |all, turn| all * turn)
    }

    proptest! {
        #[test]
        fn angles_come_back_in_every_order(
            order in 0..6usize,
            angles in proptest::array::uniform3(-700.0..700.0f64),
            pole: bool,
        ) {
            let axes = ORDERS[order];
            let mut angles = angles;
            if pole {
                angles[1] = 90.0;
            }
            let rotation = turn(axes, angles);
            let found = degrees(rotation, axes, angles);
            for (found, angle) in found.iter().zip(angles) {
                prop_assert!((found - angle).abs() < 1e-4, "{found} {angle}");
            }
            let far = turn(axes, degrees(rotation, axes, [0.0; 3]));
            prop_assert!((far.dot(rotation).abs() - 1.0).abs() < 1e-9);
        }
    }
}
