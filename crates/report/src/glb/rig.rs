//! From joint positions to nodes with translations and rotations.

use super::rotation::Rotation;
use crate::scene::SceneObject;

/// A translation that stays this near to that of the first frame, in metres, is that of the first
/// frame: bones of fixed length need no animation.
const STILL: f64 = 5e-6;

/// The nodes of an object, each after its parent.
pub(super) struct Rig {
    pub nodes: Vec<RigNode>,
    /// The node of each of the object's joints.
    pub joints: Vec<usize>,
}

/// A node and how it moves.
pub(super) struct RigNode {
    pub name: String,
    pub parent: Option<usize>,
    /// The joint at the end of the bone that this node turns, if it is one alone.
    pub bone_to: Option<usize>,
    /// The joints that it turns as fits them best.
    fits: Vec<usize>,
    /// The object's joint at its place.
    at: usize,
    /// Within the parent, one per frame.
    pub translations: Vec<[f32; 3]>,
    /// Within the parent, one per frame.
    pub rotations: Vec<Rotation>,
}

impl Rig {
    pub fn new(object: &SceneObject) -> Self {
        let mut rig = Self::tree(object);
        let mut before = vec![Rotation::IDENTITY; rig.nodes.len()];
        for frame in 0..object.frames() {
            rig.pose(object, frame, &mut before);
        }
        rig
    }

    /// The nodes before they move: parents first, whatever the order of the joints.
    fn tree(object: &SceneObject) -> Self {
        let children = |joint: usize| -> Vec<usize> {
            let all = 0..object.joints();
            all.filter(|child| object.parents[*child] == Some(joint))
                .collect()
        };
        let mut nodes: Vec<RigNode> = Vec::new();
        let mut joints = vec![0; object.joints()];
        let mut waiting = vec![(0, None)];
        while let Some((joint, parent)) = waiting.pop() {
            let below = children(joint);
            let name = object.joint_names.get(joint).cloned();
            let name = name.unwrap_or_else(|| format!("joint_{joint}"));
            let place = nodes.len();
            joints[joint] = place;
            let lone = (below.len() == 1).then(|| below[0]);
            let fits = if below.len() > 1 {
                below.clone()
            } else {
                vec![]
            };
            nodes.push(RigNode::new(name.clone(), parent, joint, lone, fits));
            for child in below.iter().rev() {
                let mut turned_by = place;
                if below.len() > 1 {
                    let end = object.joint_names.get(*child).cloned();
                    let end = end.unwrap_or_else(|| format!("joint_{child}"));
                    turned_by = nodes.len();
                    let name = format!("{name}_to_{end}");
                    nodes.push(RigNode::new(name, Some(place), joint, Some(*child), vec![]));
                }
                waiting.push((*child, Some(turned_by)));
            }
        }
        Self { nodes, joints }
    }

    /// Adds a frame; `before` are the turns of all nodes in the world in the frame before.
    fn pose(&mut self, object: &SceneObject, frame: usize, before: &mut [Rotation]) {
        let place = |frame: usize, joint: usize| object.joint(frame, joint).map(f64::from);
        let bone = |frame: usize, from: usize, to: usize| {
            let (a, b) = (place(frame, from), place(frame, to));
            [0, 1, 2].map(|axis| b[axis] - a[axis])
        };
        // Where each node is and how it lies, as a reader of the file finds it: rounding in a node
        // is made up for by the next.
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
            } else if let Some(end) = node.bone_to {
                let now = above.inverse().rotate(bone(frame, node.at, end));
                Rotation::between(bone(0, node.at, end), now)
            } else if node.fits.is_empty() || frame == 0 {
                Rotation::IDENTITY
            } else {
                let ends = node.fits.iter();
                let pairs: Vec<_> = ends
                    .map(|end| (bone(0, node.at, *end), bone(frame, node.at, *end)))
                    .collect();
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

    /// Where the nodes are in the bind pose, which is the first frame, with the object at `place`.
    pub fn bind(&self, place: [f32; 3]) -> Vec<[f32; 3]> {
        let mut places: Vec<[f32; 3]> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let from = node.parent.map_or(place, |parent| places[parent]);
            places.push([0, 1, 2].map(|axis| from[axis] + node.translations[0][axis]));
        }
        places
    }
}

/// Whether two translations are near enough to be one.
fn near(a: [f32; 3], b: [f32; 3]) -> bool {
    a.iter()
        .zip(b)
        .all(|(a, b)| f64::from((a - b).abs()) < STILL)
}

impl RigNode {
    fn new(
        name: String,
        parent: Option<usize>,
        at: usize,
        bone_to: Option<usize>,
        fits: Vec<usize>,
    ) -> Self {
        Self {
            name,
            parent,
            bone_to,
            fits,
            at,
            translations: Vec::new(),
            rotations: Vec::new(),
        }
    }
}
