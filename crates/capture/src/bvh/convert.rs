//! The same motion in other units and axes.

use super::{Axis, Bvh, Channel};
use crate::error::require_positive;
use crate::{Error, UpAxis};

impl Bvh {
    /// The same take with every length times `scale` and the axis `up` turned to +y. Joints, order of
    /// channels and frame time stay. A scale of 100 converts metres to centimetres.
    ///
    /// # Errors
    /// [`Error::Setting`] if `scale` is not positive or a length overflows.
    pub fn converted(&self, scale: f64, up: UpAxis) -> Result<Self, Error> {
        let allowed = "a positive number: 0.01 for centimetres to metres";
        require_positive("scale", scale, allowed)?;
        let lengths = |offset: [f64; 3]| up.to_y_up(offset.map(|value| scale * value));
        let mut converted = self.clone();
        let mut factors = vec![1.0; self.channels];
        for joint in &mut converted.joints {
            joint.offset = lengths(joint.offset);
            for end in &mut joint.end_sites {
                *end = lengths(*end);
            }
            let factors = &mut factors[joint.first_channel..];
            for (channel, factor) in joint.channels.iter_mut().zip(factors) {
                if matches!(channel, Channel::Position(_)) {
                    *factor = scale;
                }
                let (Channel::Position(axis) | Channel::Rotation(axis)) = channel;
                let (named, sign) = y_up(up, *axis);
                *axis = named;
                *factor *= sign;
            }
        }
        for frame in converted.values.chunks_exact_mut(self.channels) {
            for (value, factor) in frame.iter_mut().zip(&factors) {
                *value *= factor;
            }
        }
        let offsets = converted.joints.iter().flat_map(|joint| joint.offset);
        let mut numbers = converted.values.iter().copied().chain(offsets);
        let largest = numbers.find(|value| !value.is_finite()).unwrap_or(1.0);
        let allowed = "a number with which all lengths are finite";
        require_positive("scale", largest.abs(), allowed)?;
        Ok(converted)
    }
}

/// The axis of the y-up frame that an axis becomes, and its sign.
fn y_up(up: UpAxis, axis: Axis) -> (Axis, f64) {
    match (up, axis) {
        (UpAxis::Y, _) | (UpAxis::Z, Axis::X) => (axis, 1.0),
        (UpAxis::Z, Axis::Y) => (Axis::Z, -1.0),
        (UpAxis::Z, Axis::Z) => (Axis::Y, 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TAKE: &str = "HIERARCHY\nROOT hips { OFFSET 1 2 3\n\
         CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
         JOINT arm { OFFSET 0 2 -1 CHANNELS 4 Zposition Yrotation Xrotation Zrotation\n\
         End Site { OFFSET 1 1 1 } } }\nMOTION\nFrames: 2\nFrame Time: 0.05\n\
         10 20 30 40 -50 60 3 20 30 -40\n1 2 3 400 5 -6 -1 80 -30 140\n";

    #[test]
    fn a_take_that_is_converted_is_the_same_motion() {
        let take = Bvh::parse(TAKE.as_bytes(), "take.bvh").unwrap();
        for (scale, up) in [(0.01, UpAxis::Y), (2.5, UpAxis::Z), (1.0, UpAxis::Z)] {
            let converted = take.converted(scale, up).unwrap();
            let text = converted.to_text();
            let read = Bvh::parse(text.as_bytes(), "converted.bvh").unwrap();
            assert_eq!((read.frames(), read.frame_time()), (2, 0.05));
            for t in 0..2 {
                for (old, new) in take.world(t).iter().zip(read.world(t)) {
                    let known = up.to_y_up(old.position.map(|value| scale * value));
                    let apart = |axis: usize| (known[axis] - new.position[axis]).abs();
                    assert!((0..3).all(|axis| apart(axis) < 1e-5), "{known:?} {new:?}");
                    let dot = up.turn_to_y_up(old.orientation).dot(new.orientation);
                    assert!(1.0 - dot.abs() < 1e-9);
                }
            }
        }
        assert_eq!(take.converted(1.0, UpAxis::Y).unwrap(), take);
    }

    #[test]
    fn a_scale_that_makes_no_lengths_is_refused() {
        let take = Bvh::parse(TAKE.as_bytes(), "take.bvh").unwrap();
        for scale in [0.0, -1.0, f64::NAN, 1e308] {
            let error = take.converted(scale, UpAxis::Y).unwrap_err();
            assert!(error.to_string().contains("`scale`"), "{error}");
        }
    }
}
