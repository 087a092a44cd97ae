//! Rotations as six numbers: the first two rows of the matrix.
//!
//! Averaged numbers become rotations on export only. Source: GenMM; docs/sources/genmm.md.

use kinegrad_motion::Quaternion;
use kinegrad_motion::channel_encoding::from_columns;

/// The first two rows of the matrix of a unit quaternion.
pub fn from_quaternion(rotation: Quaternion) -> [f64; 6] {
    let rows = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let [[a, b, c], [d, e, f]] = rows.map(|axis| rotation.conjugate().rotate(axis));
    [a, b, c, d, e, f]
}

/// The rotation with approximately these first two matrix rows: the first keeps its direction, the
/// second is made orthogonal.
pub fn to_quaternion(rows: [f64; 6]) -> Quaternion {
    from_columns(&rows).conjugate()
}
