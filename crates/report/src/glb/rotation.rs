//! Rotations in double precision, so that ends of joint chains are exact.

use crate::scene::cross;

/// A unit quaternion (w, x, y, z).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rotation(pub [f64; 4]);

/// Maximum iterations of the search for the best rotation.
const STEPS: usize = 60;

impl Rotation {
    pub const IDENTITY: Self = Self([1.0, 0.0, 0.0, 0.0]);

    /// The normalized quaternion; the identity for zeros.
    pub fn unit(parts: [f64; 4]) -> Self {
        let norm = parts.iter().map(|part| part * part).sum::<f64>().sqrt();
        match norm.is_finite() && norm > 1e-12 {
            true => Self(parts.map(|part| part / norm)),
            false => Self::IDENTITY,
        }
    }

    /// Rounded to single precision.
    pub fn rounded(self) -> Self {
        Self(self.0.map(|part| f64::from(part as f32)))
    }

    /// In glTF order, (x, y, z, w).
    pub fn to_gltf(self) -> [f32; 4] {
        let [w, x, y, z] = self.0.map(|part| part as f32);
        [x, y, z, w]
    }

    /// The same rotation with the sign nearer to `before`.
    pub fn after(self, before: Self) -> Self {
        let dot: f64 = self.0.iter().zip(before.0).map(|(a, b)| a * b).sum();
        let sign = if dot < 0.0 { -1.0 } else { 1.0 };
        Self(self.0.map(|part| sign * part))
    }

    pub fn inverse(self) -> Self {
        let [w, x, y, z] = self.0;
        Self([w, -x, -y, -z])
    }

    /// The product: `first`, then this rotation.
    pub fn times(self, first: Self) -> Self {
        let ([aw, ax, ay, az], [bw, bx, by, bz]) = (self.0, first.0);
        Self::unit([
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ])
    }

    pub fn rotate(self, v: [f64; 3]) -> [f64; 3] {
        let [w, x, y, z] = self.0;
        let axis = [x, y, z];
        let once = cross(axis, v);
        let twice = cross(axis, once);
        [0, 1, 2].map(|i| v[i] + 2.0 * (w * once[i] + twice[i]))
    }

    /// The shortest rotation between two directions; the identity if a direction has no length.
    pub fn between(from: [f64; 3], to: [f64; 3]) -> Self {
        let lengths = dot(from, from).sqrt() * dot(to, to).sqrt();
        if lengths < 1e-12 {
            return Self::IDENTITY;
        }
        let cosine = dot(from, to) / lengths;
        if cosine < -1.0 + 1e-9 {
            // Half a turn, about any orthogonal axis.
            let smallest = (0..3).min_by(|a, b| from[*a].abs().total_cmp(&from[*b].abs()));
            let mut other = [0.0; 3];
            other[smallest.expect("three axes")] = 1.0;
            let [x, y, z] = cross(from, other);
            return Self::unit([0.0, x, y, z]);
        }
        let [x, y, z] = cross(from, to).map(|part| part / lengths);
        Self::unit([1.0 + cosine, x, y, z])
    }

    /// The least-squares rotation of directions at rest to their targets; undetermined degrees of
    /// freedom stay as in `before`.
    ///
    /// Source: P. Davenport's q-method for G. Wahba's problem (SIAM Review 7(3), 1965): the
    /// quaternion is the eigenvector of the largest eigenvalue of a symmetric matrix, found by
    /// power iteration.
    pub fn fitting(pairs: &[([f64; 3], [f64; 3])], before: Self) -> Self {
        let mut b = [[0.0; 3]; 3];
        let mut weight = 0.0;
        for (rest, now) in pairs {
            weight += (dot(*rest, *rest) * dot(*now, *now)).sqrt();
            for (row, now) in b.iter_mut().zip(now) {
                for (entry, rest) in row.iter_mut().zip(rest) {
                    *entry += now * rest;
                }
            }
        }
        if weight < 1e-12 {
            return before;
        }
        let trace = b[0][0] + b[1][1] + b[2][2];
        let skew = [b[2][1] - b[1][2], b[0][2] - b[2][0], b[1][0] - b[0][1]];
        let mut k = [[0.0; 4]; 4];
        k[0][0] = trace;
        for i in 0..3 {
            k[0][i + 1] = skew[i];
            k[i + 1][0] = skew[i];
            for j in 0..3 {
                k[i + 1][j + 1] = b[i][j] + b[j][i] - if i == j { trace } else { 0.0 };
            }
        }
        // Eigenvalues lie within plus or minus the weight; after the shift, the largest eigenvalue
        // has the largest magnitude. The share of `before` decides between equally good rotations.
        for (i, row) in k.iter_mut().enumerate() {
            row[i] += weight;
            for (j, entry) in row.iter_mut().enumerate() {
                *entry += 1e-3 * weight * before.0[i] * before.0[j];
            }
        }
        let mut q = before.0;
        for _ in 0..STEPS {
            // The bones' nodes correct the remaining error.
            let next = k.map(|row| row.iter().zip(q).map(|(a, b)| a * b).sum());
            let next = Self::unit(next).0;
            let moved: f64 = next.iter().zip(q).map(|(a, b)| (a - b).abs()).sum();
            q = next;
            if moved < 1e-9 {
                break;
            }
        }
        Self::unit(q)
    }
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: [f64; 3], b: [f64; 3], tolerance: f64) -> bool {
        (0..3).all(|i| (a[i] - b[i]).abs() < tolerance)
    }

    #[test]
    fn the_shortest_turn_arrives() {
        let directions = [
            [1.0, 0.0, 0.0],
            [0.0, -2.0, 0.0],
            [0.3, 0.4, -0.5],
            [-1.0, 0.0, 0.0],
        ];
        for from in directions {
            for to in directions {
                let scale = (dot(from, from) / dot(to, to)).sqrt();
                let turned = Rotation::between(from, to).rotate(from);
                assert!(
                    near(turned, to.map(|value| scale * value), 1e-9),
                    "{from:?} {to:?}"
                );
            }
        }
        assert_eq!(
            Rotation::between([0.0; 3], [1.0, 0.0, 0.0]),
            Rotation::IDENTITY
        );
    }

    #[test]
    fn a_rotation_is_found_from_what_it_turned() {
        let known = Rotation::unit([0.7, 0.2, -0.6, 0.3]);
        let rest = [[0.1, -0.4, 0.0], [-0.1, -0.4, 0.05], [0.0, 0.5, 0.1]];
        let pairs = rest.map(|v| (v, known.rotate(v)));
        let found = Rotation::fitting(&pairs, Rotation::IDENTITY);
        for v in rest {
            assert!(near(found.rotate(v), known.rotate(v), 1e-2), "{found:?}");
        }
        let again = Rotation::fitting(&pairs, found);
        assert!(near(again.rotate(rest[0]), known.rotate(rest[0]), 1e-3));
        assert_eq!(Rotation::fitting(&[], known), known);
    }
}
