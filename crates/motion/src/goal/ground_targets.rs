//! Target positions of the root per frame.

use super::Keyframe;

/// Channels of the trajectory model, in its order: root rotation, x, z, height.
pub const TRAJECTORY_CHANNELS: usize = 4;
/// The x channel in the trajectory model and in a motion's features; z is the next channel.
pub const GROUND_X: usize = 1;

/// Ground positions in metres for some frames of a clip.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTargets {
    targets: Vec<Option<[f64; 2]>>,
}

impl GroundTargets {
    /// Only the keyframes, in a clip of `frames` frames. If a frame has two keyframes, the last
    /// counts.
    pub fn points(keyframes: &[Keyframe], frames: usize) -> Self {
        let mut targets = vec![None; frames];
        for keyframe in keyframes {
            targets[keyframe.frame] = Some(keyframe.position());
        }
        Self { targets }
    }

    /// The keyframes and straight lines between keyframes, at constant speed. Without a keyframe in
    /// frame 0, the line begins there at the origin. Frames after the last keyframe have no target.
    pub fn point_to_point(keyframes: &[Keyframe], frames: usize) -> Self {
        Self::along_lines(keyframes, frames, |from, to, steps| {
            let at = |step| {
                let share = step as f64 / steps as f64;
                [0, 1].map(|i| from[i] + (to[i] - from[i]) * share)
            };
            (0..steps).map(at).collect()
        })
    }

    /// [`point_to_point`](Self::point_to_point) with the positions of `line(from, to, steps)`: one
    /// for each step, from the position `from` on and before the position `to`.
    pub(super) fn along_lines(
        keyframes: &[Keyframe],
        frames: usize,
        line: impl Fn([f64; 2], [f64; 2], usize) -> Vec<[f64; 2]>,
    ) -> Self {
        let mut ordered: Vec<&Keyframe> = keyframes.iter().collect();
        ordered.sort_by_key(|keyframe| keyframe.frame);
        let mut targets = Self::points(keyframes, frames);
        let (mut first, mut from) = (0, [0.0; 2]);
        for keyframe in ordered {
            let to = keyframe.position();
            let frames = &mut targets.targets[first..keyframe.frame];
            if !frames.is_empty() {
                let between = line(from, to, frames.len());
                for (target, position) in frames.iter_mut().zip(between) {
                    *target = Some(position);
                }
            }
            (first, from) = (keyframe.frame, to);
        }
        targets
    }

    /// A position for each frame from `first_frame` on.
    pub fn trajectory(positions: &[[f64; 2]], first_frame: usize, frames: usize) -> Self {
        let mut targets = vec![None; frames];
        let covered = &mut targets[first_frame..][..positions.len()];
        for (target, &position) in covered.iter_mut().zip(positions) {
            *target = Some(position);
        }
        Self { targets }
    }

    /// Number of frames of the clip.
    pub fn frames(&self) -> usize {
        self.targets.len()
    }

    /// The target `[x, z]` of each frame, or `None`.
    pub fn positions(&self) -> &[Option<[f64; 2]>] {
        &self.targets
    }

    /// The frames with a target, and their targets `[x, z]`.
    pub fn masked(&self) -> impl Iterator<Item = (usize, [f64; 2])> + Clone {
        let targets = self.targets.iter().enumerate();
        targets.filter_map(|(frame, target)| target.map(|target| (frame, target)))
    }

    /// The targets as values `[channels, frames]`, metres, and their mask: 1 for x and z.
    pub fn in_channels(&self, channels: usize, frames: usize) -> [Vec<f32>; 2] {
        let mut values = vec![0.0; channels * frames];
        let mut mask = values.clone();
        for (frame, position) in self.masked() {
            for (axis, value) in position.into_iter().enumerate() {
                let place = (GROUND_X + axis) * frames + frame;
                values[place] = value as f32;
                mask[place] = 1.0;
            }
        }
        [values, mask]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keyframe(frame: usize, x: f64, z: f64) -> Keyframe {
        Keyframe { frame, x, z }
    }

    #[test]
    fn the_line_begins_at_the_origin_and_ends_at_the_last_key_frame() {
        // Unsorted on purpose.
        let keyframes = [keyframe(4, 1.0, 3.0), keyframe(2, 1.0, -1.0)];
        let line = GroundTargets::point_to_point(&keyframes, 7);
        let expected = [
            Some([0.0, 0.0]),
            Some([0.5, -0.5]),
            Some([1.0, -1.0]),
            Some([1.0, 1.0]),
            Some([1.0, 3.0]),
            None,
            None,
        ];
        assert_eq!(line.positions(), expected);
        let points = GroundTargets::points(&keyframes, 7);
        let masked: Vec<_> = points.masked().collect();
        assert_eq!(masked, [(2, [1.0, -1.0]), (4, [1.0, 3.0])]);
    }

    #[test]
    fn a_key_frame_in_frame_0_needs_no_line() {
        let line = GroundTargets::point_to_point(&[keyframe(0, 2.0, 1.0)], 3);
        assert_eq!(line.positions(), [Some([2.0, 1.0]), None, None]);
        let keyframes = [keyframe(0, 2.0, 0.0), keyframe(2, 0.0, 0.0)];
        let line = GroundTargets::point_to_point(&keyframes, 3);
        assert_eq!(line.positions()[1], Some([1.0, 0.0]));
    }

    #[test]
    fn targets_fill_two_of_four_channels() {
        let targets = GroundTargets::trajectory(&[[1.0, 2.0]], 1, 2);
        let [values, mask] = targets.in_channels(4, 2);
        assert_eq!(values, [0.0, 0.0, 0.0, 1.0, 0.0, 2.0, 0.0, 0.0]);
        assert_eq!(mask, [0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
        let [longer, _] = targets.in_channels(3, 3);
        assert_eq!(longer, [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0]);
    }
}
