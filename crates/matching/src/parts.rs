//! Body parts, each matched by itself.

use std::collections::{HashMap, HashSet};

use kinegrad_capture::{Joint, bare_name};
use kinegrad_motion::vector::length;
use kinegrad_settings::read_toml;
use serde::{Deserialize, Serialize};

use crate::{Channels, Error, MotionMatrix};

/// A bone chain shorter than this part of the longest is not a limb: fingers, ears, a tail.
const LIMB: f64 = 0.25;

/// Most parts of a file that share a joint. Each part is matched by itself.
const MOST_PARTS: usize = 16;

/// A body part.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Its name.
    pub name: String,
    /// Indices of its joints; neighbouring parts share the joint that connects them.
    pub joints: Vec<usize>,
    /// True if the root trajectory belongs to it.
    pub root_trajectory: bool,
}

/// A file of body parts.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Document {
    part: Vec<Entry>,
}

/// A part in a file.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    /// Joints by name.
    #[serde(default)]
    joints: Vec<String>,
    /// Joints with their descendants.
    #[serde(default)]
    below: Vec<String>,
    #[serde(default)]
    root_trajectory: bool,
}

/// Common parts: name, words in the joint names, and true if the root trajectory belongs to the
/// part.
const COMMON: [(&str, &str, bool); 3] = [
    ("legs", "leg thigh shin knee ankle foot toe hipjoint", true),
    (
        "arms",
        "arm shoulder elbow wrist hand clavicle collar",
        false,
    ),
    ("head", "neck head", false),
];

impl Part {
    /// Its channels.
    pub fn channels(&self, layout: &MotionMatrix) -> Channels {
        let joints = self.joints.iter();
        let mut channels: Vec<usize> = joints.flat_map(|&j| layout.channels_of(j)).collect();
        if self.root_trajectory {
            channels.extend(layout.root_channels());
        }
        channels.sort_unstable();
        Channels {
            name: self.name.clone(),
            channels,
        }
    }

    /// Parts by the branches of the skeleton: the trunk, and a limb for each long chain below the
    /// trunk. A limb includes the trunk joint above. The root trajectory belongs to the trunk and
    /// the legs.
    pub fn automatic(layout: &MotionMatrix) -> Vec<Self> {
        let joints = layout.joints();
        let reach = reach(joints);
        let long = |joint: usize| length(joints[joint].offset) + reach[joint] >= LIMB * reach[0];
        let parent_of = |joint: usize| joints[joint].parent.expect("only the root has none");
        let mut long_children = vec![0; joints.len()];
        for joint in (1..joints.len()).filter(|&joint| long(joint)) {
            long_children[parent_of(joint)] += 1;
        }
        let is_branch = |joint: usize| long_children[joint] > 1;
        let branches = or_below(joints, (0..joints.len()).map(is_branch).collect());
        let mut limbs = Vec::new();
        let mut in_trunk = vec![true; joints.len()];
        for joint in 1..joints.len() {
            let parent = parent_of(joint);
            if is_branch(parent) && long(joint) && !branches[joint] {
                let subtree: Vec<usize> = subtree(joints, joint).collect();
                subtree.iter().for_each(|&below| in_trunk[below] = false);
                limbs.push(Self {
                    name: bare_name(&joints[joint].name).to_string(),
                    joints: [vec![parent], subtree].concat(),
                    root_trajectory: layout.carries_body(parent),
                });
            }
        }
        let trunk = Self {
            name: "trunk".to_string(),
            joints: (0..joints.len()).filter(|&joint| in_trunk[joint]).collect(),
            root_trajectory: true,
        };
        [vec![trunk], limbs].concat()
    }

    /// [`automatic`](Self::automatic) with the limbs at the root joint in the trunk: matched apart from
    /// the root trajectory, legs would slide.
    pub fn supported(layout: &MotionMatrix) -> Vec<Self> {
        let mut parts = Self::automatic(layout);
        let (limbs, legs): (Vec<Self>, Vec<Self>) =
            parts.drain(1..).partition(|limb| !limb.root_trajectory);
        let trunk = &mut parts[0].joints;
        trunk.extend(legs.into_iter().flat_map(|leg| leg.joints));
        trunk.sort_unstable();
        trunk.dedup();
        [parts, limbs].concat()
    }

    /// The whole body as one part.
    pub fn body(layout: &MotionMatrix) -> Self {
        Self {
            name: "body".to_string(),
            joints: (0..layout.joints().len()).collect(),
            root_trajectory: true,
        }
    }

    /// The parts of a TOML file: tables `[[part]]` with `name`, `joints` (names), `below` (joints
    /// with their descendants) and `root_trajectory` (true if it belongs to the part). All other
    /// joints form a part called `rest`.
    ///
    /// # Errors
    /// Fails for a malformed file, unknown joints, and parts without joints.
    pub fn read(text: &str, file: &str, layout: &MotionMatrix) -> Result<Vec<Self>, Error> {
        let hint = "docs/matching.md describes files of parts";
        let parsed: Document = read_toml(text, file, hint)?;
        if parsed.part.is_empty() {
            return Err(Error::file(file, "has no `[[part]]`", hint));
        }
        let mut parts: Vec<Self> = Vec::with_capacity(parsed.part.len());
        let mut names = HashSet::new();
        let by_name = by_name(layout.joints());
        let mut uses = vec![0; layout.joints().len()];
        for entry in parsed.part {
            if !names.insert(entry.name.clone()) {
                let problem = format!("two parts are called `{}`", entry.name);
                return Err(Error::file(file, problem, hint));
            }
            let joint = |name: &String| {
                let found = by_name.get(name.as_str()).copied();
                found.ok_or_else(|| no_joint(layout, name, file))
            };
            let mut joints: Vec<usize> =
                entry.joints.iter().map(joint).collect::<Result<_, _>>()?;
            let tops: Vec<usize> = entry.below.iter().map(joint).collect::<Result<_, _>>()?;
            joints.extend(subtrees(layout.joints(), tops));
            joints.sort_unstable();
            joints.dedup();
            if joints.is_empty() {
                let problem = format!("part `{}` has no joints", entry.name);
                return Err(Error::file(file, problem, hint));
            }
            for &joint in &joints {
                uses[joint] += 1;
                if uses[joint] > MOST_PARTS {
                    let joint = &layout.joints()[joint].name;
                    let problem = format!("joint `{joint}` is in more than {MOST_PARTS} parts");
                    return Err(Error::file(file, problem, hint));
                }
            }
            parts.push(Self {
                name: entry.name,
                joints,
                root_trajectory: entry.root_trajectory,
            });
        }
        let mut rest = Self::body(layout);
        rest.name = "rest".to_string();
        rest.joints.retain(|&joint| uses[joint] == 0);
        rest.root_trajectory = parts.iter().all(|part| !part.root_trajectory);
        if !rest.joints.is_empty() {
            if names.contains(&rest.name) {
                let problem =
                    "a part is called `rest`, and joints are left over that are called so";
                return Err(Error::file(file, problem, hint));
            }
            parts.push(rest);
        } else if rest.root_trajectory {
            let travels = layout.root_joint;
            for part in &mut parts {
                part.root_trajectory = part.joints.contains(&travels);
            }
        }
        Ok(parts)
    }

    /// The part of a name: one of `parts`; `legs`, `arms` or `head` by the words in joint names; or
    /// a joint with its descendants. `origin`: the origin of the name, for messages.
    ///
    /// # Errors
    /// The error lists the known names.
    pub fn named(
        name: &str,
        parts: &[Self],
        layout: &MotionMatrix,
        origin: &str,
    ) -> Result<Self, Error> {
        if let Some(part) = parts.iter().find(|part| part.name == name) {
            return Ok(part.clone());
        }
        let joints = layout.joints();
        let of = |joints: Vec<usize>, root_trajectory| Self {
            name: name.to_string(),
            joints,
            root_trajectory,
        };
        if let Some((_, words, has_root)) = COMMON.iter().find(|(common, ..)| *common == name) {
            let called = |joint: usize, words: &str| {
                let joint = bare_name(&joints[joint].name).to_lowercase();
                words.split(' ').any(|word| joint.contains(word))
            };
            let is_above = COMMON.map(|(common, words, _)| {
                let of_words: Vec<bool> = (0..joints.len()).map(|j| called(j, words)).collect();
                (common == name, or_below(joints, of_words))
            });
            // A joint called hip is the joint of a thigh or of the whole body.
            let thigh = |hip: usize| {
                let only_legs = |(own, above): &(bool, Vec<bool>)| above[hip] == *own;
                name == "legs" && called(hip, "hip") && is_above.iter().all(only_legs)
            };
            let tops = (1..joints.len())
                .filter(|&joint| !layout.carries_body(joint))
                .filter(|&joint| called(joint, words) || thigh(joint));
            let mut found = subtrees(joints, tops);
            if !found.is_empty() {
                // The joint above the legs rotates the legs, so it belongs to this part.
                let above = (0..joints.len()).filter(|&joint| layout.carries_body(joint));
                found.extend(above.filter(|_| *has_root));
                found.sort_unstable();
                found.dedup();
                return Ok(of(found, *has_root));
            }
        }
        if let Some(joint) = by_name(joints).get(name).copied() {
            let below: Vec<usize> = subtree(joints, joint).collect();
            let has_root = below.contains(&layout.root_joint);
            return Ok(of(below, has_root));
        }
        let parts = parts.iter().map(|part| format!("`{}`", part.name));
        let parts: Vec<String> = parts.collect();
        let hint = format!(
            "parts: {}; or a joint, with its descendants; or `legs`, `arms`, `head`, where joints are \
             called so",
            parts.join(", ")
        );
        let problem = format!("there is no part or joint `{name}`");
        Err(Error::file(origin, problem, hint))
    }
}

/// The joints named foot, toe or ankle.
pub fn feet(joints: &[Joint]) -> Vec<usize> {
    let is_foot = |joint: &usize| {
        let name = bare_name(&joints[*joint].name).to_lowercase();
        let mut words = ["foot", "toe", "ankle"].iter();
        words.any(|word| name.contains(word))
    };
    (0..joints.len()).filter(is_foot).collect()
}

/// The error for an unknown joint of a file.
fn no_joint(layout: &MotionMatrix, name: &str, file: &str) -> Error {
    let names = layout.joints().iter().map(|joint| bare_name(&joint.name));
    let names: Vec<&str> = names.collect();
    let problem = format!("no joint is named `{name}`");
    Error::file(file, problem, format!("joints: {}", names.join(", ")))
}

/// The first joint of each name, with and without its namespace.
pub(crate) fn by_name(joints: &[Joint]) -> HashMap<&str, usize> {
    let mut found = HashMap::new();
    for (index, joint) in joints.iter().enumerate() {
        for name in [&joint.name, bare_name(&joint.name)] {
            found.entry(name).or_insert(index);
        }
    }
    found
}

/// True for each joint for which, or for a descendant of which, `holds` is true.
fn or_below(joints: &[Joint], mut holds: Vec<bool>) -> Vec<bool> {
    for joint in (1..joints.len()).rev() {
        let parent = joints[joint].parent.expect("only the root has none");
        holds[parent] |= holds[joint];
    }
    holds
}

/// A joint and its descendants, which follow it in file order.
pub(crate) fn subtree(joints: &[Joint], top: usize) -> impl Iterator<Item = usize> {
    let is_below = move |joint: &usize| joints[*joint].parent.is_some_and(|parent| parent >= top);
    std::iter::once(top).chain((top + 1..joints.len()).take_while(is_below))
}

/// Some joints and their descendants, in order.
fn subtrees(joints: &[Joint], tops: impl IntoIterator<Item = usize>) -> Vec<usize> {
    let mut inside = vec![false; joints.len()];
    tops.into_iter().for_each(|top| inside[top] = true);
    for (index, joint) in joints.iter().enumerate() {
        inside[index] |= joint.parent.is_some_and(|parent| inside[parent]);
    }
    (0..joints.len()).filter(|&joint| inside[joint]).collect()
}

/// Length of the longest bone chain below each joint.
fn reach(joints: &[Joint]) -> Vec<f64> {
    let end = |joint: &Joint| {
        let ends = joint.end_sites.iter().map(|&end| length(end));
        ends.fold(0.0, f64::max)
    };
    let mut reach: Vec<f64> = joints.iter().map(end).collect();
    for joint in (1..joints.len()).rev() {
        let parent = joints[joint].parent.expect("only the root has none");
        reach[parent] = reach[parent].max(length(joints[joint].offset) + reach[joint]);
    }
    reach
}

#[cfg(test)]
mod tests {
    use kinegrad_capture::Bvh;

    use super::*;
    use crate::MatrixOptions;
    use crate::motion_matrix::tests::example;

    fn walk() -> MotionMatrix {
        let walk = example("walk.bvh", 20, 1.0 / 30.0);
        MotionMatrix::new(&[walk], MatrixOptions::default()).unwrap()
    }

    #[test]
    fn limbs_hang_on_the_trunk_by_a_shared_joint() {
        let layout = walk();
        let parts = Part::automatic(&layout);
        let named: Vec<_> = parts.iter().map(|part| part.name.as_str()).collect();
        assert_eq!(named, ["trunk", "LeftLeg", "RightLeg"]);
        assert_eq!(parts[0].joints, [0, 1]);
        assert_eq!(parts[1].joints, [1, 2, 3]);
        assert!(parts.iter().all(|part| part.root_trajectory));
        let mut all: Vec<usize> = parts
            .iter()
            .flat_map(|p| p.channels(&layout).channels)
            .collect();
        all.sort_unstable();
        all.dedup();
        assert!(all.into_iter().eq(0..layout.channels()));
        assert_eq!(feet(layout.joints()), [3, 5]);
    }

    #[test]
    fn parts_are_read_and_the_rest_is_one() {
        let layout = walk();
        let text = "[[part]]\nname = 'left'\nbelow = ['LeftLeg']\n";
        let parts = Part::read(text, "parts.toml", &layout).unwrap();
        assert_eq!(parts[0].joints, [2, 3]);
        assert_eq!(
            (parts[1].name.as_str(), parts[1].root_trajectory),
            ("rest", true)
        );
        assert_eq!(parts[1].joints, [0, 1, 4, 5]);
        for (text, message) in [
            (
                "[[part]]\nname = 'a'\njoints = ['Tail']\n",
                "no joint is named `Tail`",
            ),
            ("[[part]]\nname = 'a'\n", "part `a` has no joints"),
            (
                "[[part]]\nname = 'a'\njonts = []\n",
                "unknown key `part[0].jonts`",
            ),
        ] {
            let error = Part::read(text, "parts.toml", &layout)
                .unwrap_err()
                .to_string();
            assert!(error.contains(message), "{error}");
        }
    }

    /// The layout of a body of `count` joints, each the child of the one before if it is a chain,
    /// and else of the root.
    fn large(count: usize, is_chain: bool) -> MotionMatrix {
        let channels = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation";
        let mut text = format!("HIERARCHY\nROOT hip0\n{{ OFFSET 0 0 0 {channels}\n");
        for joint in 1..count {
            text += &format!("JOINT hip{joint}\n{{ OFFSET 0 1 0 {channels}\n");
            text += if is_chain { "" } else { "}\n" };
        }
        text += &"}\n".repeat(if is_chain { count } else { 1 });
        text += "MOTION\nFrames: 2\nFrame Time: 0.1\n";
        text += &("0 ".repeat(6 * count) + "\n");
        text += &("1 ".repeat(6 * count) + "\n");
        let bvh = Bvh::parse(text.as_bytes(), "large.bvh").unwrap();
        let file = "large.bvh".to_owned();
        let example = crate::Example { file, bvh };
        MotionMatrix::new(&[example], MatrixOptions::default()).unwrap()
    }

    #[test]
    fn large_bodies_take_one_step_for_each_joint() {
        // By pairs of joints, these would take minutes.
        for is_chain in [true, false] {
            let count = 30_000;
            let layout = large(count, is_chain);
            let parts = Part::supported(&layout);
            let joints = |parts: &[Part]| parts.iter().map(|part| part.joints.len()).sum::<usize>();
            assert!(joints(&parts) >= count);
            assert!(Part::named("legs", &parts, &layout, "fixed part").is_err());
            let below: Vec<String> = (0..count).map(|joint| format!("'hip{joint}'")).collect();
            let text = format!("[[part]]\nname = 'a'\nbelow = [{}]\n", below.join(", "));
            let parts = Part::read(&text, "parts.toml", &layout).unwrap();
            assert_eq!(joints(&parts), count);
            assert_eq!(parts[0].channels(&layout).channels.len(), layout.channels());
        }
    }

    #[test]
    fn overlapping_parts_have_a_bound() {
        let part = |name: usize| format!("[[part]]\nname = '{name}'\nbelow = ['Hips']\n");
        let text: String = (0..16).map(part).collect();
        assert_eq!(Part::read(&text, "parts.toml", &walk()).unwrap().len(), 17);
        let text: String = (0..5000).map(part).collect();
        let message = Part::read(&text, "parts.toml", &walk())
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("joint `Hips` is in more than 16 parts"),
            "{message}"
        );
    }

    #[test]
    fn names_mean_parts_words_or_joints() {
        let layout = walk();
        let parts = Part::automatic(&layout);
        let of = |name: &str| {
            Part::named(name, &parts, &layout, "fixed part")
                .map(|part| (part.joints, part.root_trajectory))
        };
        assert_eq!(of("LeftLeg").unwrap(), (vec![1, 2, 3], true));
        assert_eq!(of("legs").unwrap(), (vec![1, 2, 3, 4, 5], true));
        assert_eq!(of("RightFoot").unwrap(), (vec![5], false));
        assert!(of("arms").unwrap_err().to_string().contains("`arms`"));
    }

    #[test]
    fn hips_above_knees_are_of_the_legs_and_those_of_the_body_are_not() {
        // The right hip has an arm below it, like the hips of a body.
        let names = [
            ("LeftLeg", "left_hip"),
            ("LeftFoot", "left_ankle"),
            ("RightLeg", "RightHip"),
            ("RightFoot", "RightHand"),
        ];
        let mut walk = example("walk.bvh", 20, 1.0 / 30.0);
        let text = names.iter().fold(walk.bvh.to_text(), |text, (from, to)| {
            text.replace(from, to)
        });
        walk.bvh = Bvh::parse(text.as_bytes(), "walk.bvh").unwrap();
        let layout = MotionMatrix::new(&[walk], MatrixOptions::default()).unwrap();
        let legs = Part::named("legs", &[], &layout, "fixed part").unwrap();
        assert_eq!((legs.joints, legs.root_trajectory), (vec![1, 2, 3], true));
    }
}
