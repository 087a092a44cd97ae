//! Binary glTF 2.0: a scene as animated skeletons with a simple skin, for Blender, game engines and
//! web viewers.
//!
//! Units are meters, +y is up, and bodies face +z, as glTF prescribes. Each object is a tree of
//! nodes below a node with the object's name; the translation of this node puts objects side by
//! side. Every joint is a node with the joint's name.
//!
//! An object with a [`Hierarchy`](crate::scene::Hierarchy) has one node per joint and the rotations
//! of its file. The bind pose, and the transform of the nodes at rest, is the rest pose of the file.
//! A translation is animated only if it leaves the rest position.
//!
//! The positions of other objects do not determine rotations. The bind pose is then the first frame
//! with identity rotations. Each joint gets the shortest rotation, relative to its
//! parent's rotation, that points the bone at its child. A joint with several children gets the
//! best-fitting rotation. Each bone of this joint begins with an extra node at the same position,
//! which adds the remaining rotation and has a name like `pelvis_to_left_hip`. If a bone changes
//! its length, the translation of its end joint is animated too, so joints are exact in every
//! frame. Interpolation between frames is linear.
//!
//! A lone root with an orientation is a node with a box.

mod document;
mod mesh;
mod rig;
mod rotation;

use std::path::Path;

use serde_json::json;

use crate::export::{self, ExportError};
use crate::scene::{Scene, SceneObject, children_of};
use document::{Document, push};
use mesh::Mesh;
use rig::Rig;

/// Gap between objects side by side, meters.
const GAP: f32 = 1.0;

/// Writes a scene as a binary glTF file.
///
/// # Errors
/// The errors of [`must_be_exportable`](crate::must_be_exportable); [`ExportError::TooManyJoints`],
/// [`ExportError::Write`].
pub fn write(scene: &Scene, out: &Path) -> Result<(), ExportError> {
    export::check(scene, out)?;
    let rigs: Vec<Rig> = scene.objects.iter().map(Rig::new).collect();
    for (object, rig) in scene.objects.iter().zip(&rigs) {
        let nodes = rig.nodes.len();
        if nodes > export::MOST_NODES {
            return Err(ExportError::TooManyJoints {
                out: out.to_path_buf(),
                object: object.name.clone(),
                nodes,
            });
        }
    }
    export::write(out, &encode(scene, &rigs))
}

/// The file of a scene with the `rigs` of its objects.
fn encode(scene: &Scene, rigs: &[Rig]) -> Vec<u8> {
    let mut document = Document::default();
    let spacing = scene.objects.iter().map(width).fold(0.0, f32::max) + GAP;
    for (index, (object, rig)) in scene.objects.iter().zip(rigs).enumerate() {
        add(
            &mut document,
            object,
            rig,
            [spacing * index as f32, 0.0, 0.0],
        );
    }
    document.finish(&scene.title, mesh::material())
}

/// Extent along x over all frames, meters.
fn width(object: &SceneObject) -> f32 {
    let x = || object.positions.chunks_exact(3).map(|place| place[0]);
    x().fold(f32::MIN, f32::max) - x().fold(f32::MAX, f32::min)
}

/// Adds an object: a node for the object, nodes for its joints, an animation and a mesh.
fn add(document: &mut Document, object: &SceneObject, rig: &Rig, place: [f32; 3]) {
    let first = document.nodes.len() + 1;
    let holder = push(
        &mut document.nodes,
        json!({ "name": object.name, "translation": place, "children": [first] }),
    );
    document.roots.push(holder);
    let children = children_of(rig.nodes.iter().map(|node| node.parent));
    for (joint, children) in rig.nodes.iter().zip(children) {
        let mut node = json!({
            "name": joint.name,
            "translation": joint.rest.0,
            "rotation": joint.rest.1.to_gltf(),
        });
        if !children.is_empty() {
            let children = children.into_iter().map(|child| first + child);
            node["children"] = children.collect();
        }
        document.nodes.push(node);
    }
    animate(document, object, rig, first);
    add_mesh(document, object, rig, first, place);
}

/// Adds the animation of moving nodes; `first` is the node of the first joint.
fn animate(document: &mut Document, object: &SceneObject, rig: &Rig, first: usize) {
    let times = (0..object.frames()).map(|frame| [(frame as f64 / object.fps) as f32]);
    let times = document.ranged(&times.collect::<Vec<_>>(), None);
    for (index, joint) in rig.nodes.iter().enumerate() {
        let (translations, rotations) = (&joint.translations, &joint.rotations);
        let mut outputs = Vec::new();
        if translations.iter().any(|value| *value != joint.rest.0) {
            outputs.push(("translation", document.ranged(translations, None)));
        }
        if rotations.iter().any(|value| *value != joint.rest.1) {
            let rotations: Vec<[f32; 4]> = rotations.iter().map(|q| q.to_gltf()).collect();
            outputs.push(("rotation", document.ranged(&rotations, None)));
        }
        for (path, output) in outputs {
            let sampler = json!({ "input": times, "interpolation": "LINEAR", "output": output });
            let sampler = push(&mut document.samplers, sampler);
            let target = json!({ "node": first + index, "path": path });
            let channel = json!({ "sampler": sampler, "target": target });
            document.channels.push(channel);
        }
    }
}

/// Adds a skin over the bones, or the body of a lone root.
fn add_mesh(
    document: &mut Document,
    object: &SceneObject,
    rig: &Rig,
    first: usize,
    place: [f32; 3],
) {
    if object.joints() == 1 {
        let is_oriented = object.orientations.is_some();
        let mesh = if is_oriented {
            Mesh::body()
        } else {
            Mesh::ball()
        };
        let mesh = mesh.push(document, &object.name);
        document.nodes[first]["mesh"] = json!(mesh);
        return;
    }
    let bind = rig.bind(place);
    let mesh = Mesh::skin(object, rig, &bind).push(document, &object.name);
    let inverse = bind.iter().map(|[x, y, z]| {
        let mut matrix = [0.0; 16];
        for diagonal in [0, 5, 10, 15] {
            matrix[diagonal] = 1.0;
        }
        matrix[12..15].copy_from_slice(&[-x, -y, -z]);
        matrix
    });
    let inverse = document.floats(&inverse.collect::<Vec<_>>(), None);
    let joints: Vec<usize> = (first..first + rig.nodes.len()).collect();
    let skin = json!({
        "inverseBindMatrices": inverse, "joints": joints, "name": object.name, "skeleton": first,
    });
    let skin = push(&mut document.skins, skin);
    // The transform of a node with a skin is ignored, so it has no parent.
    let node = json!({ "name": format!("{} skin", object.name), "mesh": mesh, "skin": skin });
    let node = push(&mut document.nodes, node);
    document.roots.push(node);
}

#[cfg(test)]
mod tests;
