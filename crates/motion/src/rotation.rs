//! Rotations as Hamilton quaternions in double precision.
//!
//! Convention (CC-MotionGen, section 2.2; docs/sources.md, section 1.1): (w, x, y, z),
//! right-handed, +y up; `a * b` turns by `b` first, then by `a`.

use std::f64::consts::PI;
use std::ops::Mul;

use nalgebra::Vector3;

use crate::vector::{length, unit};

/// A Hamilton quaternion. Unit quaternions are rotations; `q` and `-q` are the same rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quaternion {
    /// Scalar part.
    pub w: f64,
    /// First imaginary part.
    pub x: f64,
    /// Second imaginary part.
    pub y: f64,
    /// Third imaginary part.
    pub z: f64,
}

impl Quaternion {
    /// No rotation.
    pub const IDENTITY: Self = Self::new(1.0, 0.0, 0.0, 0.0);

    /// The quaternion (w, x, y, z).
    pub const fn new(w: f64, x: f64, y: f64, z: f64) -> Self {
        Self { w, x, y, z }
    }

    /// (w, x, y, z).
    pub const fn parts(self) -> [f64; 4] {
        [self.w, self.x, self.y, self.z]
    }

    /// The rotation about +y by `angle` radians, from +z towards +x.
    pub fn from_yaw(angle: f64) -> Self {
        let (sin, cos) = (0.5 * angle).sin_cos();
        Self::new(cos, 0.0, sin, 0.0)
    }

    /// The rotation about the direction of `vector` by its length in radians.
    pub fn from_rotation_vector(vector: [f64; 3]) -> Self {
        let angle = length(vector);
        // sin(angle / 2) / angle, by its series near 0.
        let factor = if angle < 1e-4 {
            0.5 - angle * angle / 48.0
        } else {
            (0.5 * angle).sin() / angle
        };
        let [x, y, z] = vector.map(|component| component * factor);
        Self::new((0.5 * angle).cos(), x, y, z)
    }

    /// The rotation vector in radians, of length at most pi, for any norm; zero for zero.
    pub fn to_rotation_vector(self) -> [f64; 3] {
        // The quaternion with w >= 0, q or -q, rotates by at most pi.
        let Self { w, x, y, z } = if self.w < 0.0 { self.scale(-1.0) } else { self };
        let sin = length([x, y, z]);
        // The angle is 2 atan2(sin, w). Unlike acos, this is accurate near 0 and pi.
        let factor = if sin > 1e-12 * w {
            2.0 * sin.atan2(w) / sin
        } else {
            2.0 / w
        };
        if w == 0.0 && sin == 0.0 {
            return [0.0; 3];
        }
        [x * factor, y * factor, z * factor]
    }

    /// The conjugate: the inverse of a unit quaternion.
    #[must_use]
    pub fn conjugate(self) -> Self {
        Self::new(self.w, -self.x, -self.y, -self.z)
    }

    /// The inner product; negative for opposite hemispheres.
    pub fn dot(self, other: Self) -> f64 {
        self.w * other.w + self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// The Euclidean norm.
    pub fn norm(self) -> f64 {
        self.dot(self).sqrt()
    }

    /// All four parts times `factor`.
    #[must_use]
    pub fn scale(self, factor: f64) -> Self {
        Self::from(self.parts().map(|part| part * factor))
    }

    /// The same direction with norm 1; the identity if the norm is zero or not finite.
    #[must_use]
    pub fn normalised(self) -> Self {
        // Scaling by the largest part first avoids overflow and underflow of squares.
        let largest = self.parts().map(f64::abs).into_iter().fold(0.0, f64::max);
        let scaled = self.scale(1.0 / largest);
        let unit = scaled.scale(1.0 / scaled.norm());
        match unit.dot(unit).is_finite() {
            true => unit,
            false => Self::IDENTITY,
        }
    }

    /// This quaternion or its negative, whichever is nearer to `other`.
    #[must_use]
    pub fn nearer_to(self, other: Self) -> Self {
        match self.dot(other) < 0.0 {
            true => self.scale(-1.0),
            false => self,
        }
    }

    /// The vector turned by this unit quaternion.
    pub fn rotate(self, vector: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = vector;
        let turned = self * Self::new(0.0, x, y, z) * self.conjugate();
        [turned.x, turned.y, turned.z]
    }

    /// Spherical interpolation between unit quaternions, along the shorter arc.
    #[must_use]
    pub fn slerp(self, other: Self, fraction: f64) -> Self {
        let turn = (other * self.conjugate()).to_rotation_vector();
        Self::from_rotation_vector(turn.map(|v| v * fraction)) * self
    }

    /// The twist about +y of the swing-twist decomposition, -pi to pi; 0 upside down.
    pub fn twist(self) -> f64 {
        let half = self.y.atan2(self.w);
        2.0 * (half - PI * (half / PI).round())
    }

    /// Heading, -pi to pi: the angle about +y from +z to the rotated +z; 0 if that is vertical.
    pub fn yaw(self) -> f64 {
        let [x, _, z] = self.rotate([0.0, 0.0, 1.0]);
        x.atan2(z)
    }
}

impl From<[f64; 4]> for Quaternion {
    fn from([w, x, y, z]: [f64; 4]) -> Self {
        Self::new(w, x, y, z)
    }
}

impl Mul for Quaternion {
    type Output = Self;

    /// The Hamilton product: first `other`, then `self`.
    fn mul(self, other: Self) -> Self {
        let (a, b) = (self, other);
        Self {
            w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
            x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
        }
    }
}

/// The shortest rotation from the direction of `from` to the direction of `to`: the quaternion
/// (|u||v| + u.v, u x v), normalized. Opposite vectors turn about +y if possible; zero vectors give
/// no rotation.
pub fn between(from: [f64; 3], to: [f64; 3]) -> Quaternion {
    let (u, v) = (Vector3::from(unit(from)), Vector3::from(unit(to)));
    let (scalar, mut axis) = (u.norm() * v.norm() + u.dot(&v), u.cross(&v));
    if scalar == 0.0 && axis.norm() == 0.0 && u.norm() > 0.0 && v.norm() > 0.0 {
        let across = |direction: Vector3<f64>| direction - u * u.dot(&direction);
        let [about_y, about_x] = [Vector3::y(), Vector3::x()].map(across);
        axis = match about_y.norm() > 1e-6 {
            true => about_y,
            false => about_x,
        };
    }
    Quaternion::new(scalar, axis.x, axis.y, axis.z).normalised()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use proptest::prelude::*;

    use super::*;
    use crate::vector::minus;

    fn close(a: [f64; 3], b: [f64; 3], tolerance: f64) -> bool {
        (0..3).all(|axis| (a[axis] - b[axis]).abs() <= tolerance)
    }

    fn unit() -> impl Strategy<Value = Quaternion> {
        prop::array::uniform4(-1.0f64..1.0)
            .prop_filter("not near zero", |q| {
                q.iter().map(|v| v * v).sum::<f64>() > 1e-2
            })
            .prop_map(|[w, x, y, z]| Quaternion { w, x, y, z }.normalised())
    }

    fn vector(bound: f64) -> impl Strategy<Value = [f64; 3]> {
        prop::array::uniform3(-bound..bound)
    }

    #[test]
    fn quarter_turns_have_the_right_sign() {
        let quarter = 0.5 * PI;
        let about = |axis: usize| {
            let mut turn = [0.0; 3];
            turn[axis] = quarter;
            Quaternion::from_rotation_vector(turn)
        };
        let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        assert!(close(about(0).rotate(y), z, 1e-15));
        assert!(close(about(1).rotate(z), x, 1e-15));
        assert!(close(about(2).rotate(x), y, 1e-15));
        assert!(close(Quaternion::from_yaw(quarter).rotate(z), x, 1e-15));
        // The right factor turns y to z first; the left factor then turns z to x.
        assert!(close((about(1) * about(0)).rotate(y), x, 1e-15));
    }

    #[test]
    fn rotation_vector_is_safe_at_zero_and_at_pi() {
        assert_eq!(Quaternion::IDENTITY.to_rotation_vector(), [0.0; 3]);
        assert_eq!(
            Quaternion::new(0.0, 0.0, 0.0, 0.0).to_rotation_vector(),
            [0.0; 3]
        );
        assert_eq!(
            Quaternion::from_rotation_vector([0.0; 3]),
            Quaternion::IDENTITY
        );
        let tiny = [1e-200, -2e-9, 3e-14];
        let back = Quaternion::from_rotation_vector(tiny).to_rotation_vector();
        assert!(close(back, tiny, 1e-24), "{back:?}");
        let half = Quaternion::new(0.0, 0.0, -1.0, 0.0).to_rotation_vector();
        assert!(close(half, [0.0, -PI, 0.0], 1e-15));
        let beyond = Quaternion::from_rotation_vector([PI + 0.1, 0.0, 0.0]).to_rotation_vector();
        assert!(close(beyond, [0.1 - PI, 0.0, 0.0], 1e-14));
    }

    #[test]
    fn normalising_is_safe_everywhere() {
        let zero = Quaternion::new(0.0, 0.0, 0.0, 0.0);
        assert_eq!(zero.normalised(), Quaternion::IDENTITY);
        assert_eq!(
            Quaternion::new(f64::NAN, 0.0, 0.0, 0.0).normalised(),
            Quaternion::IDENTITY
        );
        assert_eq!(
            Quaternion::new(1.0, f64::INFINITY, 0.0, 0.0).normalised(),
            Quaternion::IDENTITY
        );
        for size in [1e-300, 1e-9, 1.0, 1e300] {
            let q = Quaternion::new(3.0 * size, 0.0, -4.0 * size, 0.0).normalised();
            assert!(
                (q.w - 0.6).abs() < 1e-15 && (q.y + 0.8).abs() < 1e-15,
                "{size}: {q:?}"
            );
        }
    }

    #[test]
    fn slerp_takes_the_shorter_arc_at_constant_speed() {
        let (from, to) = (Quaternion::from_yaw(3.0), Quaternion::from_yaw(-3.0));
        for (fraction, yaw) in [(0.0, 3.0), (0.25, 3.0708), (0.75, -3.0708), (1.0, -3.0)] {
            for to in [to, to.scale(-1.0)] {
                let between = from.slerp(to, fraction);
                assert!((between.yaw() - yaw).abs() < 1e-4, "{fraction}");
                assert!((between.norm() - 1.0).abs() < 1e-12);
            }
        }
    }

    proptest! {
        #[test]
        fn rotation_vectors_come_back_up_to_pi(v in vector(1.8)) {
            let back = Quaternion::from_rotation_vector(v).to_rotation_vector();
            prop_assert!(close(back, v, 1e-12), "{:?}", back);
        }

        #[test]
        fn rotation_vectors_do_not_depend_on_sign_or_norm(q in unit(), size in 0.01f64..100.0) {
            let v = q.to_rotation_vector();
            prop_assert!(length(v) <= PI + 1e-12);
            prop_assert!(close(q.scale(size).to_rotation_vector(), v, 1e-12));
            // At exactly half a turn both directions are equally short.
            prop_assume!(q.w.abs() > 1e-9);
            prop_assert!(close(q.scale(-size).to_rotation_vector(), v, 1e-12));
        }

        #[test]
        fn products_turn_one_after_the_other(a in unit(), b in unit(), v in vector(10.0)) {
            let product = a * b;
            prop_assert!((product.norm() - 1.0).abs() < 1e-12);
            prop_assert!(close(product.rotate(v), a.rotate(b.rotate(v)), 1e-11));
            prop_assert!((length(a.rotate(v)) - length(v)).abs() < 1e-11);
            prop_assert!(close(a.conjugate().rotate(a.rotate(v)), v, 1e-11));
        }

        #[test]
        fn yaw_is_read_back(angle in -3.1f64..3.1) {
            prop_assert!((Quaternion::from_yaw(angle).yaw() - angle).abs() < 1e-12);
        }
    }

    #[test]
    fn opposite_directions_are_half_a_turn_apart() {
        for from in [[0.0, 0.0, -1.0], [0.0, 2.0, 0.0], [1.0, 0.0, 0.0]] {
            let to = from.map(|value| -value);
            let turned = between(from, to).rotate(from);
            assert!(length(minus(turned, to)) < 1e-12, "{from:?}: {turned:?}");
        }
        // Facing backwards is a yaw.
        let half = between([0.0, 0.0, -1.0], [0.0, 0.0, 1.0]);
        assert!((half.to_rotation_vector()[1].abs() - PI).abs() < 1e-12);
        assert_eq!(between([0.0; 3], [0.0, 1.0, 0.0]), Quaternion::IDENTITY);
    }
}
