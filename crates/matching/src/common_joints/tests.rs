//! Skeletons that differ in joints, names, sizes and rest poses.

use kinegrad_motion::Quaternion;

use super::*;
use crate::motion_matrix::tests::{example, text};
use crate::{Job, Length};

fn parsed(file: &str, text: &str) -> Example {
    Example {
        file: file.to_string(),
        bvh: Bvh::parse(text.as_bytes(), file).unwrap(),
    }
}

fn walk() -> Example {
    example("walk.bvh", 60, 1.0 / 30.0)
}

/// The walk with other names, twice the size, and a tail at the hips.
fn other() -> Example {
    let names = [
        ("Root", "Reference"),
        ("Hips", "pelvis"),
        ("LeftLeg", "thigh_l"),
        ("LeftFoot", "foot_l"),
        ("RightLeg", "thigh_r"),
        ("RightFoot", "foot_r"),
    ];
    let text = text(60, 1.0 / 30.0);
    let text = names
        .iter()
        .fold(text, |text, (from, to)| text.replace(from, to));
    let tail = "JOINT tail\n{\nOFFSET 0 0 -10\nCHANNELS 0\n}\n}\n}\nMOTION";
    let text = text.replace("}\n}\nMOTION", tail);
    let mut other = parsed("other.bvh", &text);
    other.bvh = other.bvh.converted(2.0, UpAxis::Y).unwrap();
    other
}

fn names(text: &str) -> JointNames {
    JointNames::read(text, "map.toml").unwrap()
}

fn map() -> JointNames {
    names(
        "[joints]\nHips = 'pelvis'\nLeftLeg = 'thigh_l'\nLeftFoot = ['foot_l']\n\
         RightLeg = 'thigh_r'\nRightFoot = 'foot_r'\nRoot = []\n",
    )
}

fn unified(
    examples: &mut [Example],
    names: Option<&JointNames>,
) -> Result<Option<CommonJoints>, Error> {
    Job::default().unify(examples, names)
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    length(minus(a, b))
}

#[test]
fn a_body_of_another_size_and_other_names_moves_the_same() {
    let mut examples = [walk(), other()];
    let common = unified(&mut examples, Some(&map())).unwrap().unwrap();
    let joints = ["Hips", "LeftLeg", "LeftFoot", "RightLeg", "RightFoot"];
    assert_eq!(common.joints, joints);
    assert_eq!(common.left_out["walk.bvh"], ["Root"]);
    assert_eq!(common.left_out["other.bvh"], ["Reference", "tail"]);
    let [one, other] = &examples;
    assert_eq!(one.bvh.joints().len(), 5);
    let known = walk();
    for t in 0..60 {
        let old = known.bvh.world(t);
        let worlds = one.bvh.world(t).into_iter().zip(other.bvh.world(t));
        for ((new, of_other), old) in worlds.zip(&old[1..]) {
            assert!(apart(new.position, old.position) < 1e-4);
            assert!(apart(of_other.position, old.position) < 1e-3, "{t}");
            assert!(1.0 - new.orientation.dot(of_other.orientation).abs() < 1e-9);
        }
    }
    let job = Job {
        length: Some(Length::Frames(90)),
        ..Job::default()
    };
    let made = job.make(&examples).unwrap();
    assert_eq!((made.bvh.frames(), made.bvh.joints().len()), (90, 5));
}

#[test]
fn one_skeleton_is_left_as_it_is_and_smaller_ones_are_matched_by_name() {
    let mut examples = [walk(), walk()];
    assert_eq!(unified(&mut examples, None).unwrap(), None);
    assert_eq!(examples[0].bvh, walk().bvh);
    // The same joints with prefixes and with toes.
    let more = text(60, 1.0 / 30.0)
        .replace("JOINT ", "JOINT mixamorig:")
        .replace(
            "End Site\n{\nOFFSET 0 -40 12\n}",
            "JOINT Toe\n{\nOFFSET 0 -40 12\nCHANNELS 0\n}",
        );
    let mut examples = [walk(), parsed("more.bvh", &more)];
    let common = unified(&mut examples, None).unwrap().unwrap();
    assert_eq!(common.joints.len(), 6);
    assert_eq!(common.left_out["more.bvh"], ["Toe", "Toe"]);
    assert!(!common.left_out.contains_key("walk.bvh"));
}

#[test]
fn a_joint_that_each_lacks_needs_a_map() {
    let toe = text(60, 1.0 / 30.0).replace("RightFoot", "RightToe");
    let toe = || parsed("toe.bvh", &toe);
    let error = unified(&mut [walk(), toe()], None).unwrap_err();
    assert_eq!(
        error.to_string(),
        "toe.bvh: the skeletons differ: 1 of its joints are not in walk.bvh (`RightToe`), and 1 the \
         other way round (`RightFoot`)"
    );
    let by_map = |text: &str| unified(&mut [walk(), toe()], Some(&names(text)));
    let common = by_map("[joints]\nRightFoot = 'RightToe'\n")
        .unwrap()
        .unwrap();
    assert!(common.joints.len() == 6 && common.left_out.is_empty());
    // An empty table matches the joints of one name.
    let common = by_map("[joints]\n").unwrap().unwrap();
    assert_eq!(common.joints.len(), 5);
    let refused = |text: &str| by_map(text).unwrap_err().to_string();
    assert!(refused("[joints]\nTail = 'RightToe'\n").contains("walk.bvh has no joint `Tail`"));
    assert!(refused("[joints]\nHips = 'Tail'\n").contains("no other file has a joint `Tail`"));
    let crossed = "[joints]\nLeftLeg = 'LeftFoot'\nLeftFoot = 'LeftLeg'\n";
    assert!(
        refused(crossed).contains("is below"),
        "{}",
        refused(crossed)
    );
    let twice = JointNames::read("[joints]\na = 'c'\nb = 'c'\n", "map.toml").unwrap_err();
    assert!(
        twice.to_string().contains("two joints are called `c`"),
        "{twice}"
    );
}

#[test]
fn rest_poses_and_axes_may_differ() {
    // The legs point down in the walk, and along +x with other axes in the other file, whose rest
    // pose lies on its side.
    let turn = Quaternion::from_rotation_vector([0.0, 0.0, std::f64::consts::FRAC_PI_2]);
    let known = walk();
    let joints = known.bvh.joints();
    let mut figure = joints.to_vec();
    for joint in &mut figure {
        joint.offset = turn.rotate(joint.offset);
        joint
            .end_sites
            .iter_mut()
            .for_each(|end| *end = turn.rotate(*end));
    }
    let rotated: Vec<Quaternion> = (0..60)
        .flat_map(|t| {
            let world: Vec<Quaternion> = known.bvh.world(t).iter().map(|p| p.orientation).collect();
            let worlds: Vec<Quaternion> = world.iter().map(|&w| w * turn.conjugate()).collect();
            let within = |index: usize| match joints[index].parent {
                Some(parent) => worlds[parent].conjugate() * worlds[index],
                None => worlds[index],
            };
            (0..joints.len()).map(within).collect::<Vec<_>>()
        })
        .collect();
    // The hips become the root, because only a root moves in such a file.
    let hips: Vec<[f64; 3]> = (0..60).map(|t| known.bvh.world(t)[1].position).collect();
    let figure: Vec<_> = figure[1..]
        .iter()
        .cloned()
        .map(|mut joint| {
            joint.parent = joint.parent.and_then(|parent| parent.checked_sub(1));
            joint.name = joint.name.replace("Foot", "Ankle");
            joint
        })
        .collect();
    let rotations: Vec<Quaternion> = rotated
        .chunks(6)
        .flat_map(|frame| [&[frame[0] * frame[1]][..], &frame[2..]].concat())
        .collect();
    let lying = Bvh::from_rotations(&figure, 1.0 / 30.0, &hips, &rotations).unwrap();
    let lying = Example {
        file: "lying.bvh".to_string(),
        bvh: lying,
    };
    let map = names("[joints]\nLeftFoot = 'LeftAnkle'\nRightFoot = 'RightAnkle'\n");
    let mut examples = [walk(), lying];
    unified(&mut examples, Some(&map)).unwrap().unwrap();
    for t in 0..60 {
        for (new, old) in examples[1]
            .bvh
            .world(t)
            .iter()
            .zip(&known.bvh.world(t)[1..])
        {
            assert!(apart(new.position, old.position) < 1e-3, "{t}");
            assert!(
                1.0 - new.orientation.dot(old.orientation).abs() < 1e-6,
                "{t}"
            );
        }
    }
}
