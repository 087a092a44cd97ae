//! Nodes with translations and rotations, from a hierarchy or from joint positions.

use super::rotation::Rotation;
use crate::scene::{Hierarchy, SceneObject};

/// Deviation in meters below which a translation counts as constant: bones of fixed length need no
/// animation.
const STILL: f64 = 5e-6;

/// The nodes of an object, parents first.
pub(super) struct Rig {
    pub nodes: Vec<RigNode>,
    /// The node of each joint.
    pub joints: Vec<usize>,
}

/// An animated node.
#[derive(Clone)]
pub(super) struct RigNode {
    pub name: String,
    pub parent: Option<usize>,
    /// The joints at the ends of the node's bones.
    pub bones_to: Vec<usize>,
    /// The joints that the node's rotation fits.
    fits: Vec<usize>,
    /// The joint at the node's position.
    at: usize,
    /// Translation and rotation at rest.
    pub rest: ([f32; 3], Rotation),
    /// Within the parent, one per frame.
    pub translations: Vec<[f32; 3]>,
    /// Within the parent, one per frame.
    pub rotations: Vec<Rotation>,
}

impl RigNode {
    /// A node at a joint, without bones and motion.
    fn new(object: &SceneObject, joint: usize) -> Self {
        let name = object.joint_names.get(joint).cloned();
        Self {
            name: name.unwrap_or_else(|| format!("joint_{joint}")),
            parent: None,
            bones_to: Vec::new(),
            fits: Vec::new(),
            at: joint,
            rest: ([0.0; 3], Rotation::IDENTITY),
            translations: Vec::new(),
            rotations: Vec::new(),
        }
    }
}

impl Rig {
    pub fn new(object: &SceneObject) -> Self {
        if let Some(hierarchy) = &object.hierarchy {
            return Self::of(object, hierarchy);
        }
        let mut rig = Self::tree(object);
        let mut before = vec![Rotation::IDENTITY; rig.nodes.len()];
        for frame in 0..object.frames() {
            rig.pose(object, frame, &mut before);
        }
        for node in &mut rig.nodes {
            node.rest = (node.translations[0], node.rotations[0]);
        }
        rig
    }

    /// One node per joint, with the motion of a hierarchy.
    fn of(object: &SceneObject, hierarchy: &Hierarchy) -> Self {
        let joints = 0..object.joints();
        let nodes = joints.clone().zip(object.children());
        let nodes = nodes.map(|(joint, children)| {
            let offset = hierarchy.offsets[joint];
            let frames = hierarchy.translations.chunks_exact(object.joints());
            let at_rest = |place| if near(offset, place) { offset } else { place };
            let turns = hierarchy.rotations.chunks_exact(object.joints());
            let turns = turns.scan(Rotation::IDENTITY, |before, turns| {
                let turn = Rotation::unit(turns[joint].map(f64::from));
                *before = turn.after(*before).rounded();
                Some(*before)
            });
            RigNode {
                parent: object.parents[joint],
                bones_to: children,
                rest: (offset, Rotation::IDENTITY),
                translations: frames.map(|frame| at_rest(frame[joint])).collect(),
                rotations: turns.collect(),
                ..RigNode::new(object, joint)
            }
        });
        Self {
            nodes: nodes.collect(),
            joints: joints.collect(),
        }
    }

    /// The nodes without animation. Parents come first for any joint order.
    fn tree(object: &SceneObject) -> Self {
        let mut nodes: Vec<RigNode> = Vec::new();
        let mut joints = vec![0; object.joints()];
        let children = object.children();
        let mut waiting = vec![(0, None)];
        while let Some((joint, parent)) = waiting.pop() {
            let below = &children[joint];
            let place = nodes.len();
            joints[joint] = place;
            let mut node = RigNode {
                parent,
                ..RigNode::new(object, joint)
            };
            match below[..] {
                [child] => node.bones_to = vec![child],
                _ => node.fits = below.clone(),
            }
            let name = node.name.clone();
            nodes.push(node);
            for &child in below.iter().rev() {
                let turned_by = if below.len() > 1 { nodes.len() } else { place };
                if below.len() > 1 {
                    let end = RigNode::new(object, child).name;
                    nodes.push(RigNode {
                        name: format!("{name}_to_{end}"),
                        parent: Some(place),
                        bones_to: vec![child],
                        ..RigNode::new(object, joint)
                    });
                }
                waiting.push((child, Some(turned_by)));
            }
        }
        Self { nodes, joints }
    }

    /// Adds a frame; `before` has the world rotations of all nodes in the previous frame.
    fn pose(&mut self, object: &SceneObject, frame: usize, before: &mut [Rotation]) {
        let place = |frame: usize, joint: usize| object.joint(frame, joint).map(f64::from);
        let bone = |frame: usize, from: usize, to: usize| {
            let (a, b) = (place(frame, from), place(frame, to));
            [0, 1, 2].map(|axis| b[axis] - a[axis])
        };
        // World pose of each node as a reader computes it, so that rounding errors do not
        // accumulate.
        let mut world: Vec<([f64; 3], Rotation)> = Vec::with_capacity(self.nodes.len());
        for (node, before) in self.nodes.iter_mut().zip(before) {
            let (origin, above) = node
                .parent
                .map_or(([0.0; 3], Rotation::IDENTITY), |parent| world[parent]);
            let at = place(frame, node.at);
            let away = [0, 1, 2].map(|axis| at[axis] - origin[axis]);
            let inside = above.inverse().rotate(away).map(|value| value as f32);
            let translation = match (node.translations.first(), node.parent) {
                (Some(first), Some(_)) if near(*first, inside) => *first,
                _ => inside,
            };
            let local = if let (None, Some(turns)) = (node.parent, &object.orientations) {
                Rotation::unit(turns[frame].map(f64::from))
            } else if let [end] = node.bones_to[..] {
                let now = above.inverse().rotate(bone(frame, node.at, end));
                Rotation::between(bone(0, node.at, end), now)
            } else if node.fits.is_empty() || frame == 0 {
                Rotation::IDENTITY
            } else {
                let ends = node.fits.iter();
                let pairs = ends.map(|end| (bone(0, node.at, *end), bone(frame, node.at, *end)));
                let pairs: Vec<_> = pairs.collect();
                above.inverse().times(Rotation::fitting(&pairs, *before))
            };
            let last = node.rotations.last().copied();
            let local = local.after(last.unwrap_or(Rotation::IDENTITY)).rounded();
            *before = above.times(local);
            let moved = above.rotate(translation.map(f64::from));
            let arrived = [0, 1, 2].map(|axis| origin[axis] + moved[axis]);
            world.push((arrived, *before));
            node.translations.push(translation);
            node.rotations.push(local);
        }
    }

    /// Node positions in the bind pose, without rotations, with the object at `place`.
    pub fn bind(&self, place: [f32; 3]) -> Vec<[f32; 3]> {
        let mut places: Vec<[f32; 3]> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let from = node.parent.map_or(place, |parent| places[parent]);
            places.push([0, 1, 2].map(|axis| from[axis] + node.rest.0[axis]));
        }
        places
    }
}

/// True if two translations count as equal.
fn near(a: [f32; 3], b: [f32; 3]) -> bool {
    let mut pairs = a.iter().zip(b);
    pairs.all(|(a, b)| f64::from((a - b).abs()) < STILL)
}
