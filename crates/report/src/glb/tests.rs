use std::collections::HashMap;

use gltf::animation::util::ReadOutputs;
use gltf::{Gltf, Node};

use super::rotation::{Rotation, dot};
use super::*;
use crate::scene::tests::{body, dancer};

/// A chain with a fork; all bones except one keep their lengths.
fn walker(frames: usize) -> SceneObject {
    let parents = [None, Some(0), Some(1), Some(1), Some(2), Some(0), Some(5)];
    let bones = [
        [0.0, 0.0, 0.0],
        [0.0, 0.3, 0.0],
        [0.2, 0.1, 0.0],
        [-0.2, 0.1, 0.0],
        [0.3, 0.0, 0.0],
        [0.1, -0.4, 0.0],
        [0.0, -0.4, 0.05],
    ];
    let mut positions = Vec::new();
    for frame in 0..frames {
        let t = frame as f64 / 20.0;
        let mut turns = vec![Rotation::IDENTITY; bones.len()];
        let mut places = vec![[50.0 + 0.5 * t, 0.9, -1.5 * t]; bones.len()];
        for joint in 1..bones.len() {
            let parent = parents[joint].unwrap();
            let swing = (joint as f64 + 2.0 * t).sin();
            let own = Rotation::unit([1.0, 0.4 * swing, 0.7 * t, 0.3 * (t + joint as f64).cos()]);
            turns[joint] = turns[parent].times(own);
            let stretch = if joint == 4 { 1.0 + 0.1 * swing } else { 1.0 };
            let arm = turns[joint].rotate(bones[joint].map(|value: f64| stretch * value));
            places[joint] = [0, 1, 2].map(|axis| places[parent][axis] + arm[axis]);
        }
        positions.extend(places.as_flattened().iter().map(|value| *value as f32));
    }
    let names = [
        "hips",
        "chest",
        "left_arm",
        "head",
        "left_hand",
        "leg",
        "foot",
    ];
    SceneObject {
        name: "walker".into(),
        fps: 20.0,
        positions,
        joint_names: names.map(String::from).to_vec(),
        parents: parents.to_vec(),
        ..SceneObject::default()
    }
}

/// Times and values.
type Track = (Vec<f32>, Vec<[f32; 4]>);

/// A file as read by an independent program.
struct Reader {
    gltf: Gltf,
    /// Times and values by node; the flag is true for rotations.
    tracks: HashMap<(usize, bool), Track>,
}

impl Reader {
    fn new(bytes: &[u8]) -> Self {
        // Parsing checks the document by the rules of the format.
        let gltf = Gltf::from_slice(bytes).expect("a valid file");
        let blob = gltf.blob.clone().expect("with a buffer");
        let mut tracks = HashMap::new();
        for animation in gltf.animations() {
            for channel in animation.channels() {
                let reader = channel.reader(|_| Some(&blob));
                let times: Vec<f32> = reader.read_inputs().unwrap().collect();
                let (turns, values): (bool, Vec<[f32; 4]>) = match reader.read_outputs().unwrap() {
                    ReadOutputs::Translations(all) => {
                        (false, all.map(|[x, y, z]| [x, y, z, 0.0]).collect())
                    }
                    ReadOutputs::Rotations(all) => (true, all.into_f32().collect()),
                    _ => panic!("nothing else moves"),
                };
                assert_eq!(times.len(), values.len());
                tracks.insert((channel.target().node().index(), turns), (times, values));
            }
        }
        Self { gltf, tracks }
    }

    /// World position and rotation of an object's nodes, by node name.
    fn world(&self, object: &str, frame: usize) -> HashMap<String, ([f64; 3], Rotation)> {
        let scene = self.gltf.default_scene().unwrap();
        let root = scene
            .nodes()
            .find(|node| node.name() == Some(object))
            .unwrap();
        let mut world = HashMap::new();
        self.visit(&root, frame, ([0.0; 3], Rotation::IDENTITY), &mut world);
        world
    }

    fn visit(
        &self,
        node: &Node<'_>,
        frame: usize,
        (origin, above): ([f64; 3], Rotation),
        world: &mut HashMap<String, ([f64; 3], Rotation)>,
    ) {
        let (mut translation, mut rotation, _) = node.transform().decomposed();
        if let Some((_, values)) = self.tracks.get(&(node.index(), false)) {
            let [x, y, z, _] = values[frame];
            translation = [x, y, z];
        }
        if let Some((_, values)) = self.tracks.get(&(node.index(), true)) {
            rotation = values[frame];
        }
        let moved = above.rotate(translation.map(f64::from));
        let place = [0, 1, 2].map(|axis| origin[axis] + moved[axis]);
        let [x, y, z, w] = rotation.map(f64::from);
        assert!(((x * x + y * y + z * z + w * w).sqrt() - 1.0).abs() < 1e-6);
        let turn = above.times(Rotation::unit([w, x, y, z]));
        for child in node.children() {
            self.visit(&child, frame, (place, turn), world);
        }
        world.insert(node.name().unwrap().to_string(), (place, turn));
    }
}

fn scene(objects: Vec<SceneObject>) -> Scene {
    Scene {
        title: "test".into(),
        objects,
        ..Scene::default()
    }
}

fn encoded(scene: &Scene) -> Vec<u8> {
    let rigs: Vec<Rig> = scene.objects.iter().map(Rig::new).collect();
    encode(scene, &rigs)
}

/// An object whose `joints` are the root and its children.
fn wide(joints: usize) -> SceneObject {
    SceneObject {
        positions: (0..3 * joints).map(|index| index as f32 * 1e-3).collect(),
        joint_names: (0..joints).map(|joint| format!("joint {joint}")).collect(),
        parents: (0..joints).map(|joint| (joint > 0).then_some(0)).collect(),
        ..walker(1)
    }
}

#[test]
fn more_joints_than_a_skin_can_name_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("wide.glb");
    let error = write(&scene(vec![wide(70_000)]), &out)
        .unwrap_err()
        .to_string();
    assert!(error.contains("at most 65536 are written"), "{error}");
    assert!(!out.exists());
}

#[test]
fn joints_are_where_the_scene_has_them() {
    for object in [walker(60), body(60)] {
        let reader = Reader::new(&encoded(&scene(vec![object.clone()])));
        for frame in 0..60 {
            let world = reader.world(&object.name, frame);
            for (joint, name) in object.joint_names.iter().enumerate() {
                let known = object.joint(frame, joint);
                let found = world[name].0;
                for axis in 0..3 {
                    let apart = (found[axis] - f64::from(known[axis])).abs();
                    assert!(apart < 1e-5, "{name} of frame {frame} is {apart} m off");
                }
            }
        }
        let (times, _) = reader.tracks.values().next().unwrap();
        assert_eq!((times[0], times[59]), (0.0, 59.0 / 20.0));
    }
}

#[test]
fn bones_of_fixed_length_only_turn() {
    let object = walker(30);
    let reader = Reader::new(&encoded(&scene(vec![object.clone()])));
    let mut moved: Vec<String> = Vec::new();
    for node in reader.gltf.nodes() {
        if reader.tracks.contains_key(&(node.index(), false)) {
            moved.push(node.name().unwrap().into());
        }
    }
    moved.sort();
    assert_eq!(moved, ["hips", "left_hand"]);
    // The root turns with the body; ends of chains turn with their parents.
    let turned = |name: &str| {
        let node = reader
            .gltf
            .nodes()
            .find(|node| node.name() == Some(name))
            .unwrap();
        reader.tracks.contains_key(&(node.index(), true))
    };
    assert!(turned("hips") && turned("chest") && turned("chest_to_head") && !turned("foot"));
}

#[test]
fn rotations_are_continuous() {
    let reader = Reader::new(&encoded(&scene(vec![walker(200)])));
    for ((_, turns), (_, values)) in &reader.tracks {
        for pair in values.windows(2).filter(|_| *turns) {
            let product: f32 = pair[0].iter().zip(pair[1]).map(|(a, b)| a * b).sum();
            assert!(product > 0.95, "{pair:?}");
        }
    }
}

#[test]
fn the_skin_follows_its_bones() {
    let object = walker(40);
    let reader = Reader::new(&encoded(&scene(vec![object.clone()])));
    let blob = reader.gltf.blob.clone().unwrap();
    let skin = reader.gltf.skins().next().unwrap();
    let joints: Vec<String> = skin
        .joints()
        .map(|node| node.name().unwrap().into())
        .collect();
    let inverse: Vec<[[f32; 4]; 4]> = skin
        .reader(|_| Some(&blob))
        .read_inverse_bind_matrices()
        .unwrap()
        .collect();
    let primitive = reader
        .gltf
        .meshes()
        .next()
        .unwrap()
        .primitives()
        .next()
        .unwrap();
    let vertices = primitive.reader(|_| Some(&blob));
    let places: Vec<[f32; 3]> = vertices.read_positions().unwrap().collect();
    let movers: Vec<u16> = vertices
        .read_joints(0)
        .unwrap()
        .into_u16()
        .map(|j| j[0])
        .collect();
    assert!(
        vertices
            .read_weights(0)
            .unwrap()
            .into_f32()
            .all(|w| w == [1.0, 0.0, 0.0, 0.0])
    );
    for frame in [0, 17, 39] {
        let world = reader.world("walker", frame);
        for (place, mover) in places.iter().zip(&movers) {
            let column = inverse[usize::from(*mover)][3];
            let local = [0, 1, 2].map(|axis| f64::from(place[axis] + column[axis]));
            let (origin, turn) = world[&joints[usize::from(*mover)]];
            let arm = turn.rotate(local);
            let place = [0, 1, 2].map(|axis| origin[axis] + arm[axis]);
            // No vertex is far from all bones.
            let nearest = (1..object.joints()).map(|joint| {
                let from = object
                    .joint(frame, object.parents[joint].unwrap())
                    .map(f64::from);
                let to = object.joint(frame, joint).map(f64::from);
                distance(place, from, to)
            });
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            assert!(nearest < 0.1, "{nearest} in frame {frame}");
        }
    }
}

/// From a point to a line.
fn distance(point: [f64; 3], from: [f64; 3], to: [f64; 3]) -> f64 {
    let minus = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|i| a[i] - b[i]);
    let (along, away) = (minus(to, from), minus(point, from));
    let part = (dot(along, away) / dot(along, along)).clamp(0.0, 1.0);
    let rest = minus(away, along.map(|value| part * value));
    dot(rest, rest).sqrt()
}

#[test]
fn a_phrase_is_a_box_that_moves_and_turns() {
    let object = dancer(45, 0.3);
    let reader = Reader::new(&encoded(&scene(vec![object.clone()])));
    for frame in 0..45 {
        let (place, turn) = reader.world("phrase", frame)["root"];
        let known = object.joint(frame, 0);
        assert!((0..3).all(|axis| (place[axis] - f64::from(known[axis])).abs() < 1e-6));
        let forward = turn.rotate([0.0, 0.0, 1.0]);
        let yaw = 0.3 + 2.0 * frame as f64 / 30.0;
        assert!((forward[0] - yaw.sin()).abs() < 1e-6 && (forward[2] - yaw.cos()).abs() < 1e-6);
    }
    let node = reader
        .gltf
        .nodes()
        .find(|node| node.name() == Some("root"))
        .unwrap();
    assert!(node.mesh().is_some() && node.skin().is_none());
}

#[test]
fn objects_stand_beside_one_another_under_nodes_of_their_own() {
    let mut second = dancer(10, 0.0);
    second.name = "second".into();
    let reader = Reader::new(&encoded(&scene(vec![walker(10), second, body(1)])));
    let names: Vec<_> = reader
        .gltf
        .default_scene()
        .unwrap()
        .nodes()
        .map(|n| n.name().unwrap().to_string())
        .collect();
    assert_eq!(
        names,
        ["walker", "walker skin", "second", "body", "body skin"]
    );
    let first = reader.world("walker", 0)["walker"].0;
    let second = reader.world("second", 0)["second"].0;
    assert_eq!(first, [0.0; 3]);
    assert!(second[0] > 1.0);
    assert_eq!(reader.gltf.animations().count(), 1);
}

#[test]
fn numbers_are_aligned_and_have_their_ranges() {
    let bytes = encoded(&scene(vec![walker(7)]));
    assert_eq!(bytes.len() % 4, 0);
    assert_eq!(
        u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize,
        bytes.len()
    );
    let reader = Reader::new(&bytes);
    for accessor in reader.gltf.accessors() {
        let view = accessor.view().unwrap();
        assert_eq!(view.offset() % 4, 0);
        assert_eq!(accessor.count() * accessor.size(), view.length());
    }
    for animation in reader.gltf.animations() {
        for sampler in animation.samplers() {
            let input = sampler.input();
            let max = input.max().unwrap()[0].as_f64().unwrap();
            assert!((max - 0.3).abs() < 1e-6 && input.min().unwrap()[0].as_f64() == Some(0.0));
        }
    }
}

#[test]
fn a_lone_frame_and_points_without_length_are_written() {
    let mut object = body(1);
    object.positions.fill(0.5);
    let reader = Reader::new(&encoded(&scene(vec![object])));
    assert_eq!(reader.gltf.animations().count(), 0);
    assert_eq!(reader.world("body", 0)["head"].0, [0.5; 3]);
}

/// The walker at any angles, in its own hierarchy.
fn capture(frames: usize) -> SceneObject {
    let mut object = walker(frames);
    let joints = object.joints();
    let rest = walker(1);
    let offset = |joint: usize| {
        let from = object.parents[joint].map_or([0.0; 3], |parent| rest.joint(0, parent));
        let to = rest.joint(0, joint);
        [0, 1, 2].map(|axis| to[axis] - from[axis])
    };
    let offsets: Vec<[f32; 3]> = (0..joints).map(offset).collect();
    let turn = |index: usize| {
        let [x, y, z] = [0.4, 0.9, 1.7].map(|part| (part * index as f64).sin());
        Rotation::unit([0.6, x, y, z]).0.map(|part| part as f32)
    };
    let mut translations = offsets.repeat(frames);
    for frame in 0..frames {
        // The root moves, and one joint slides.
        translations[frame * joints][1] += 0.1 * frame as f32;
        translations[frame * joints + 4][0] += 0.01 * frame as f32;
    }
    object.hierarchy = Some(crate::scene::Hierarchy {
        offsets,
        translations,
        rotations: (0..frames * joints).map(turn).collect(),
    });
    object
}

#[test]
fn a_hierarchy_keeps_its_nodes_rotations_and_rest_pose() {
    let object = capture(9);
    let hierarchy = object.hierarchy.clone().unwrap();
    let reader = Reader::new(&encoded(&scene(vec![object.clone()])));
    let nodes: Vec<Node<'_>> = reader.gltf.nodes().collect();
    // The object, its joints and its skin.
    assert_eq!(nodes.len(), 1 + object.joints() + 1);
    for (joint, name) in object.joint_names.iter().enumerate() {
        let node = nodes.iter().find(|node| node.name() == Some(name)).unwrap();
        let (translation, rotation, _) = node.transform().decomposed();
        assert_eq!(translation, hierarchy.offsets[joint]);
        assert_eq!(rotation, [0.0, 0.0, 0.0, 1.0]);
        let below: Vec<&str> = node.children().map(|child| child.name().unwrap()).collect();
        let known: Vec<&str> = object.children()[joint]
            .iter()
            .map(|&child| object.joint_names[child].as_str())
            .collect();
        assert_eq!(below, known);
        let (_, turns) = &reader.tracks[&(node.index(), true)];
        for (frame, [x, y, z, w]) in turns.iter().enumerate() {
            let known = hierarchy.rotations[frame * object.joints() + joint];
            let dot: f32 = [w, x, y, z].iter().zip(known).map(|(a, b)| **a * b).sum();
            assert!(1.0 - dot.abs() < 1e-6, "{name} in frame {frame}");
        }
        let moves = reader.tracks.contains_key(&(node.index(), false));
        assert_eq!(moves, [0, 4].contains(&joint), "{name}");
    }
}

#[test]
fn files_are_written_whole() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("walker.glb");
    write(&scene(vec![walker(3)]), &out).unwrap();
    assert_eq!(
        std::fs::read(&out).unwrap(),
        encoded(&scene(vec![walker(3)]))
    );
    assert!(write(&scene(vec![]), &out).is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}
