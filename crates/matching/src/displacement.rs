//! Root trajectories as displacements between frames.

use kinegrad_capture::Axis;

/// The displacements of a path, `[frames]`: the difference to the frame before, on every axis
/// except `absolute`, which keeps its value. As in the published program, frame 0 gets the place of
/// frame 1: the first displacement of a path from the origin. Source: docs/sources/genmm.md.
pub fn displacements(path: &[[f64; 3]], absolute: Option<Axis>) -> Vec<[f64; 3]> {
    let of = |t: usize, axis: usize| match t {
        _ if absolute.is_some_and(|absolute| absolute as usize == axis) => path[t][axis],
        0 => path[1.min(path.len() - 1)][axis],
        _ => path[t][axis] - path[t - 1][axis],
    };
    let of_frame = |t: usize| [0, 1, 2].map(|axis| of(t, axis));
    (0..path.len()).map(of_frame).collect()
}

/// The path of displacements, `[frames]`, from `start`: their running sum on every axis except
/// `absolute`. The sum ignores frame 0.
pub fn places(
    displacements: &[[f64; 3]],
    start: [f64; 3],
    absolute: Option<Axis>,
) -> Vec<[f64; 3]> {
    let mut place = start;
    let next = |(t, moved): (usize, &[f64; 3])| {
        for axis in 0..3 {
            match absolute.is_some_and(|absolute| absolute as usize == axis) {
                true => place[axis] = moved[axis],
                false if t > 0 => place[axis] += moved[axis],
                false => {}
            }
        }
        place
    };
    displacements.iter().enumerate().map(next).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_path_comes_back(
            path in proptest::collection::vec(proptest::array::uniform3(-9.0..9.0f64), 1..20),
        ) {
            for absolute in [None, Some(Axis::X), Some(Axis::Y), Some(Axis::Z)] {
                let back = places(&displacements(&path, absolute), path[0], absolute);
                for (back, place) in back.as_flattened().iter().zip(path.as_flattened()) {
                    prop_assert!((back - place).abs() < 1e-9);
                }
            }
        }
    }
}
