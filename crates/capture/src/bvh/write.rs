//! Writing BVH text.

use kinegrad_motion::Quaternion;

use kinegrad_settings::InvalidSetting;

use super::euler::degrees;
use super::{Axis, Bvh, CHANNELS, Channel, Joint};
use crate::error::{require, require_positive};
use crate::{Error, RootPose};

/// Turns of every written joint, in the order of most BVH files.
const ZXY: [Axis; 3] = [Axis::Z, Axis::X, Axis::Y];

impl Joint {
    /// A joint for [`Bvh::from_rotations`] and [`Bvh::from_poses`]: a one-line `name` without braces,
    /// an earlier `parent`, its `offset` in the file's units, and, without a child, the end of its
    /// bone. It has no channels yet.
    pub fn new(
        name: String,
        parent: Option<usize>,
        offset: [f64; 3],
        end_site: Option<[f64; 3]>,
    ) -> Self {
        Self {
            name,
            parent,
            offset,
            channels: Vec::new(),
            end_sites: end_site.into_iter().collect(),
            first_channel: 0,
        }
    }
}

impl Bvh {
    /// A file of `root` positions `[frames, 3]` in the file's units and `rotations` `[frames,
    /// joints]`, row by row, relative to the parents.
    ///
    /// The joints are in depth-first order. The root has six channels, every other joint three,
    /// `Zrotation Xrotation Yrotation`. Angles are unwrapped, so that they can be interpolated.
    ///
    /// # Errors
    /// [`Error::Setting`] for a frame time that is not positive, joints that are not a tree, a name
    /// that the text cannot contain, no frames, a wrong number of rotations, or a value that is not
    /// finite.
    pub fn from_rotations(
        figure: &[Joint],
        frame_time: f64,
        root: &[[f64; 3]],
        rotations: &[Quaternion],
    ) -> Result<Self, Error> {
        check(figure, frame_time, root, rotations)?;
        let order = depth_first(figure);
        let mut place = vec![0; figure.len()];
        let mut joints: Vec<Joint> = Vec::with_capacity(figure.len());
        let mut first_channel = 0;
        for (index, &of_figure) in order.iter().enumerate() {
            place[of_figure] = index;
            let mut joint = figure[of_figure].clone();
            joint.channels = ZXY.map(Channel::Rotation).to_vec();
            match &mut joint.parent {
                Some(parent) => *parent = place[*parent],
                None => {
                    joint.offset = [0.0; 3];
                    let position = [Axis::X, Axis::Y, Axis::Z].map(Channel::Position);
                    joint.channels.splice(0..0, position);
                }
            }
            joint.first_channel = first_channel;
            first_channel += joint.channels.len();
            joints.push(joint);
        }
        let mut values = Vec::with_capacity(root.len() * first_channel);
        let mut angles = vec![[0.0; 3]; figure.len()];
        for (root, rotations) in root.iter().zip(rotations.chunks_exact(figure.len())) {
            values.extend(root);
            for &joint in &order {
                angles[joint] = degrees(rotations[joint], ZXY, angles[joint]);
                values.extend(angles[joint]);
            }
        }
        Ok(Self {
            joints,
            frame_time,
            channels: first_channel,
            values,
            frames_beyond: 0,
            milliseconds: None,
        })
    }

    /// A file of joints with their own channels and the motion `locals`, `[frames, joints]` row by
    /// row, as [`reposed`](Self::reposed) writes it.
    ///
    /// # Errors
    /// [`Error::Setting`] for joints that are not a tree or have no channels, and those of
    /// [`reposed`](Self::reposed).
    pub fn from_poses(
        mut joints: Vec<Joint>,
        frame_time: f64,
        locals: &[RootPose],
    ) -> Result<Self, Error> {
        check_joints(&joints)?;
        let mut channels = 0;
        for joint in &mut joints {
            joint.first_channel = channels;
            channels += joint.channels.len();
        }
        let some = "at least one channel";
        require(channels > 0, "channels", "none", some)?;
        let blank = Self {
            joints,
            frame_time,
            channels,
            values: vec![0.0; channels],
            frames_beyond: 0,
            milliseconds: None,
        };
        blank.reposed(frame_time, locals)
    }

    /// The file's text, numbers to six decimals; [`Bvh::parse`] reads this text back.
    pub fn to_text(&self) -> String {
        Self::figures_to_text(std::slice::from_ref(self))
    }

    /// The text of a file with a ROOT for each figure; [`Bvh::parse_figures`] reads this text back.
    ///
    /// # Panics
    /// Panics without figures, or if their frames differ in number.
    pub fn figures_to_text(figures: &[Self]) -> String {
        let first = figures.first().expect("one figure or more");
        let frames = first.frames();
        assert!(figures.iter().all(|figure| figure.frames() == frames));
        let mut text = "HIERARCHY\n".to_string();
        for figure in figures {
            figure.write_hierarchy(&mut text);
        }
        let frame_time = first.frame_time;
        text += &format!("MOTION\nFrames: {frames}\nFrame Time: {frame_time}\n");
        for t in 0..frames {
            let numbers = figures.iter().flat_map(|figure| figure.frame(t));
            let numbers: Vec<String> = numbers.map(|v| format!("{v:.6}")).collect();
            line(&mut text, 0, &numbers.join(" "));
        }
        text
    }

    fn write_hierarchy(&self, text: &mut String) {
        let mut open: Vec<usize> = Vec::new();
        for (index, joint) in self.joints.iter().enumerate() {
            while open.last().copied() != joint.parent {
                open.pop();
                line(text, open.len(), "}");
            }
            let kind = joint.parent.map_or("ROOT", |_| "JOINT");
            line(text, open.len(), &format!("{kind} {}", joint.name));
            line(text, open.len(), "{");
            open.push(index);
            line(text, open.len(), &offset(joint.offset));
            if !joint.channels.is_empty() {
                let names: Vec<&str> = joint.channels.iter().map(channel_name).collect();
                let channels = format!("CHANNELS {} {}", names.len(), names.join(" "));
                line(text, open.len(), &channels);
            }
            for end in &joint.end_sites {
                line(text, open.len(), "End Site");
                line(text, open.len(), "{");
                line(text, open.len() + 1, &offset(*end));
                line(text, open.len(), "}");
            }
        }
        for depth in (0..open.len()).rev() {
            line(text, depth, "}");
        }
    }
}

fn check(
    figure: &[Joint],
    frame_time: f64,
    root: &[[f64; 3]],
    rotations: &[Quaternion],
) -> Result<(), InvalidSetting> {
    let allowed = "a positive number of seconds: 0.05 for 20 frames per second";
    require_positive("frame_time", frame_time, allowed)?;
    check_joints(figure)?;
    let some = !figure.is_empty() && !root.is_empty();
    let found = format!("{} joints in {} frames", figure.len(), root.len());
    require(some, "figure", found, "at least one joint and one frame")?;
    let enough = rotations.len() == root.len() * figure.len();
    let found = format!("a list of {}", rotations.len());
    let allowed = "one rotation for each joint and frame";
    require(enough, "rotations", found, allowed)?;
    let finite = root.as_flattened().iter().all(|value| value.is_finite());
    require(finite, "root", "not finite", "finite numbers")?;
    let finite = rotations.iter().all(|rotation| rotation.norm().is_finite());
    require(finite, "rotations", "not finite", "unit quaternions")
}

/// Checks names, tree and lengths of joints.
fn check_joints(figure: &[Joint]) -> Result<(), InvalidSetting> {
    for (index, joint) in figure.iter().enumerate() {
        let name = &joint.name;
        let bad = |c: char| c.is_control() || c == '{' || c == '}';
        let plain = !name.is_empty() && name.trim() == name && !name.contains(bad);
        let found = format!("`{}`", name.escape_debug());
        let allowed = "a name of one line without braces and without blanks around it";
        require(plain, "name", found, allowed)?;
        let sound = joint.parent.map_or(index == 0, |parent| parent < index);
        let found = format!("{:?} for joint {index}", joint.parent);
        let allowed = "a joint before it, and none for the first joint alone";
        require(sound, "parent", found, allowed)?;
        let mut offsets = joint.offset.iter().chain(joint.end_sites.as_flattened());
        let found = format!("not finite for joint {index}");
        let allowed = "finite numbers in the file's units";
        require(offsets.all(|v| v.is_finite()), "offset", found, allowed)?;
    }
    Ok(())
}

/// The joints in the order of the text: each followed by its descendants.
fn depth_first(figure: &[Joint]) -> Vec<usize> {
    let mut order = Vec::with_capacity(figure.len());
    let mut children = vec![Vec::new(); figure.len()];
    for (child, joint) in figure.iter().enumerate() {
        if let Some(parent) = joint.parent {
            children[parent].push(child);
        }
    }
    let mut waiting = vec![0];
    while let Some(joint) = waiting.pop() {
        order.push(joint);
        // The loop takes joints from the end, so the first child is last.
        waiting.extend(children[joint].iter().rev());
    }
    order
}

/// Most tabs before a line, so that text grows with the joints alone.
const MOST_TABS: usize = 64;

fn line(text: &mut String, depth: usize, content: &str) {
    text.extend(std::iter::repeat_n('\t', depth.min(MOST_TABS)));
    text.push_str(content);
    text.push('\n');
}

fn offset([x, y, z]: [f64; 3]) -> String {
    format!("OFFSET {x:.6} {y:.6} {z:.6}")
}

fn channel_name(channel: &Channel) -> &'static str {
    let named = CHANNELS.iter().find(|(_, known)| known == channel);
    named.expect("every channel has a name").0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn joint(name: &str, parent: Option<usize>) -> Joint {
        let end_site = parent.map(|_| [0.0, 0.25, 0.0]);
        Joint::new(name.to_string(), parent, [1.0, 2.0, -0.5], end_site)
    }

    /// Joints that are not in depth-first order: the second child of the root comes before its
    /// grandchild.
    fn figure() -> [Joint; 4] {
        [
            joint("hips", None),
            joint("left leg", Some(0)),
            joint("right leg", Some(0)),
            joint("left foot", Some(1)),
        ]
    }

    #[test]
    fn mistakes_in_a_figure_are_named() {
        let still = [Quaternion::IDENTITY; 4];
        let write = |figure: &[Joint], frame_time, root: &[[f64; 3]]| {
            let bvh = Bvh::from_rotations(figure, frame_time, root, &still);
            bvh.unwrap_err().to_string()
        };
        let root = [[0.0; 3]];
        assert!(write(&figure(), 0.0, &root).contains("`frame_time` is 0"));
        assert!(write(&figure(), 0.05, &[]).contains("4 joints in 0 frames"));
        assert!(write(&figure()[..3], 0.05, &root).contains("a list of 4"));
        assert!(write(&figure(), 0.05, &[[f64::NAN; 3]]).contains("`root`"));
        let mut spoiled = figure();
        spoiled[1].parent = Some(1);
        assert!(write(&spoiled, 0.05, &root).contains("for joint 1"));
        spoiled = figure();
        spoiled[2].name = "right\nleg".to_string();
        assert!(write(&spoiled, 0.05, &root).contains("right\\nleg"));
    }

    #[test]
    fn a_quarter_turn_about_x_keeps_its_heading() {
        let turns = [[0.0, 0.0, 0.7], [90f64.to_radians(), 0.0, 0.0]];
        let [yaw, pitch] = turns.map(Quaternion::from_rotation_vector);
        let [z, x, y] = degrees(yaw * pitch, ZXY, [0.0, 0.0, 25.0]).map(f64::to_radians);
        assert!((y - 25f64.to_radians()).abs() < 1e-9);
        let about = |axis: usize, angle: f64| {
            let mut turn = [0.0; 3];
            turn[axis] = angle;
            Quaternion::from_rotation_vector(turn)
        };
        let back = about(2, z) * about(0, x) * about(1, y);
        assert!((back.dot(yaw * pitch).abs() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn angles_continue_beyond_half_a_turn_and_over_the_poles() {
        let about = |axis: usize, angle: f64| {
            let mut turn = [0.0; 3];
            turn[axis] = angle.to_radians();
            Quaternion::from_rotation_vector(turn)
        };
        // Three turns about each axis in steps of 7 degrees, with the others at an angle.
        for axis in 0..3 {
            let mut before = [0.0; 3];
            for step in 0..155 {
                let turn = about(axis, 7.0 * f64::from(step));
                let rotation = about(2, 0.3) * turn * about((axis + 1) % 3, 0.2);
                let angles = degrees(rotation, ZXY, before);
                let most = angles.iter().zip(before).map(|(a, b)| (a - b).abs());
                let most = most.fold(0.0, f64::max);
                assert!(
                    most < 16.0,
                    "axis {axis}, step {step}: {before:?} {angles:?}"
                );
                let [z, x, y] = angles;
                let back = about(2, z) * about(0, x) * about(1, y);
                assert!((back.dot(rotation).abs() - 1.0).abs() < 1e-9);
                before = angles;
            }
            let named = [1, 2, 0][axis];
            assert!((before[named] - 1078.0).abs() < 3.0, "{before:?}");
        }
    }

    proptest! {
        #[test]
        fn a_written_figure_is_read_back(
            turns in proptest::collection::vec(proptest::array::uniform3(-3.0..3.0f64), 8),
        ) {
            let rotations: Vec<Quaternion> =
                turns.into_iter().map(Quaternion::from_rotation_vector).collect();
            let root = [[0.5, 1.0, -0.25], [4.0, 0.0, 0.125]];
            let bvh = Bvh::from_rotations(&figure(), 0.05, &root, &rotations).unwrap();
            let read = Bvh::parse(bvh.to_text().as_bytes(), "figure.bvh").unwrap();
            prop_assert_eq!(read.joints(), bvh.joints());
            prop_assert_eq!((read.frames(), read.frame_time()), (2, 0.05));
            // Root, left leg, left foot, right leg.
            for t in 0..2 {
                let world = read.world(t);
                prop_assert_eq!(world[0].position, root[t]);
                let of_file = [0, 1, 3, 2].map(|joint| rotations[4 * t + joint]);
                let expected = [
                    of_file[0],
                    of_file[0] * of_file[1],
                    of_file[0] * of_file[1] * of_file[2],
                    of_file[0] * of_file[3],
                ];
                for (pose, expected) in world.iter().zip(expected) {
                    prop_assert!((pose.orientation.dot(expected).abs() - 1.0).abs() < 1e-12);
                }
            }
        }
    }
}
