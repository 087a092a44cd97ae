//! Binary glTF 2.0: a scene as animated skeletons with a simple skin, for Blender, game engines and
//! web viewers.
//!
//! Metres, +y up, bodies face +z, as glTF wants it. Each figure is a tree of nodes below a node of
//! the figure's name, which puts several figures beside one another and is all that stands between
//! the figure's own coordinates and those of the file. Every joint is a node of its name. The bind
//! pose is the first frame, with all joints unturned.
//!
//! Positions say nothing of rotations, so each joint takes the shortest turn, from its parent's,
//! that brings the bone to its child to where the child is. A joint where several bones begin
//! turns as fits its children best; each of the bones then begins with a node of its own in the same
//! place, named as `pelvis_to_left_hip`, which turns it the rest of the way. Where a bone does not
//! keep its length, the translation of the joint at its end is animated as well: the joints are
//! where the scene has them, in every frame. Between frames interpolation is linear.
//!
//! A lone root with an orientation is a node with a box that moves and turns.

mod buffer;
mod mesh;
mod rig;
mod turn;

use std::path::Path;

use gltf_json as json;
use json::animation::{Channel, Interpolation, Property, Sampler, Target};
use json::scene::UnitQuaternion;
use json::validation::Checked::Valid;
use json::{Index, Node};

use crate::export::{self, ExportError};
use crate::scene::{Figure, Scene};
use buffer::Buffer;
use mesh::Mesh;
use rig::Rig;

/// Metres between figures that stand beside one another.
const APART: f32 = 1.0;

/// Writes a scene as a binary glTF file.
///
/// # Errors
/// Those of [`must_be_exportable`](crate::must_be_exportable); [`ExportError::Write`].
pub fn write(scene: &Scene, out: &Path) -> Result<(), ExportError> {
    export::check(scene, out)?;
    export::write(out, &encode(scene))
}

/// The file.
fn encode(scene: &Scene) -> Vec<u8> {
    let mut document = Document::default();
    let spacing = scene.figures.iter().map(width).fold(0.0, f32::max) + APART;
    for (index, figure) in scene.figures.iter().enumerate() {
        document.figure(figure, [spacing * index as f32, 0.0, 0.0]);
    }
    document.finish(&scene.title)
}

/// Metres that a figure takes from side to side, over all its frames.
fn width(figure: &Figure) -> f32 {
    let sides = || figure.positions.chunks_exact(3).map(|place| place[0]);
    sides().fold(f32::MIN, f32::max) - sides().fold(f32::MAX, f32::min)
}

/// A glTF document that grows figure by figure.
#[derive(Default)]
struct Document {
    root: json::Root,
    buffer: Buffer,
    roots: Vec<Index<Node>>,
    channels: Vec<Channel>,
    samplers: Vec<Sampler>,
}

impl Document {
    fn figure(&mut self, figure: &Figure, place: [f32; 3]) {
        let rig = Rig::new(figure);
        let first = self.root.nodes.len() + 1;
        let node = |index: usize| Index::new((first + index) as u32);
        // The node of the figure, those of its joints, and, for a skin, that of the mesh.
        let holder = self.root.push(Node {
            name: Some(figure.name.clone()),
            translation: Some(place),
            children: Some(vec![node(0)]),
            ..Node::default()
        });
        self.roots.push(holder);
        for (index, joint) in rig.nodes.iter().enumerate() {
            let below = rig.nodes.iter().enumerate();
            let children: Vec<_> = below
                .filter(|(_, other)| other.parent == Some(index))
                .map(|(child, _)| node(child))
                .collect();
            self.root.push(Node {
                name: Some(joint.name.clone()),
                translation: Some(joint.translations[0]),
                rotation: Some(gltf_quaternion(joint.rotations[0])),
                children: (!children.is_empty()).then_some(children),
                ..Node::default()
            });
        }
        let nodes: Vec<Index<Node>> = (0..rig.nodes.len()).map(node).collect();
        self.animate(figure, &rig, &nodes);
        self.dress(figure, &rig, &nodes, place);
    }

    /// The animation of a figure's nodes.
    fn animate(&mut self, figure: &Figure, rig: &Rig, nodes: &[Index<Node>]) {
        let times: Vec<f32> = (0..figure.frames())
            .map(|frame| (frame as f64 / figure.fps) as f32)
            .collect();
        let times = self.buffer.scalars(&mut self.root, &times);
        for (joint, node) in rig.nodes.iter().zip(nodes) {
            let still = joint
                .translations
                .iter()
                .all(|t| *t == joint.translations[0]);
            if !still {
                let values = self.buffer.vectors(&mut self.root, &joint.translations);
                self.channel(*node, Property::Translation, times, values);
            }
            let still = joint
                .rotations
                .iter()
                .all(|turn| *turn == joint.rotations[0]);
            if !still {
                let turns: Vec<[f32; 4]> = joint.rotations.iter().map(|q| q.to_gltf()).collect();
                let values = self.buffer.quaternions(&mut self.root, &turns);
                self.channel(*node, Property::Rotation, times, values);
            }
        }
    }

    fn channel(
        &mut self,
        node: Index<Node>,
        path: Property,
        input: Index<json::Accessor>,
        output: Index<json::Accessor>,
    ) {
        let sampler = Index::new(self.samplers.len() as u32);
        self.samplers.push(Sampler {
            extensions: None,
            extras: json::Extras::default(),
            input,
            interpolation: Valid(Interpolation::Linear),
            output,
        });
        self.channels.push(Channel {
            sampler,
            target: Target {
                extensions: None,
                extras: json::Extras::default(),
                node,
                path: Valid(path),
            },
            extensions: None,
            extras: json::Extras::default(),
        });
    }

    /// The mesh of a figure: a skin over its bones, or the body of a lone root.
    fn dress(&mut self, figure: &Figure, rig: &Rig, nodes: &[Index<Node>], place: [f32; 3]) {
        if figure.joints() == 1 {
            let mesh = if figure.orientations.is_some() {
                Mesh::body()
            } else {
                Mesh::ball()
            };
            let mesh = mesh.push(&mut self.root, &mut self.buffer, &figure.name);
            self.root.nodes[nodes[0].value()].mesh = Some(mesh);
            return;
        }
        let bind = rig.bind(place);
        let mesh = Mesh::skin(figure, rig, &bind);
        let mesh = mesh.push(&mut self.root, &mut self.buffer, &figure.name);
        let inverse: Vec<[f32; 16]> = bind
            .iter()
            .map(|[x, y, z]| {
                let mut matrix = [0.0; 16];
                for diagonal in [0, 5, 10, 15] {
                    matrix[diagonal] = 1.0;
                }
                matrix[12..15].copy_from_slice(&[-x, -y, -z]);
                matrix
            })
            .collect();
        let inverse = self.buffer.matrices(&mut self.root, &inverse);
        let skin = self.root.push(json::Skin {
            extensions: None,
            extras: json::Extras::default(),
            inverse_bind_matrices: Some(inverse),
            joints: nodes.to_vec(),
            name: Some(figure.name.clone()),
            skeleton: Some(nodes[0]),
        });
        // A mesh with a skin stands at the top: where its node is does not count.
        let node = self.root.push(Node {
            name: Some(format!("{} skin", figure.name)),
            mesh: Some(mesh),
            skin: Some(skin),
            ..Node::default()
        });
        self.roots.push(node);
    }

    fn finish(mut self, title: &str) -> Vec<u8> {
        let name = (!title.is_empty()).then(|| title.to_string());
        let scene = self.root.push(json::Scene {
            extensions: None,
            extras: json::Extras::default(),
            name: name.clone(),
            nodes: self.roots,
        });
        self.root.scene = Some(scene);
        if !self.channels.is_empty() {
            self.root.animations.push(json::Animation {
                extensions: None,
                extras: json::Extras::default(),
                channels: self.channels,
                name,
                samplers: self.samplers,
            });
        }
        self.root.asset.generator = Some("kinegrad".to_string());
        let bytes = self.buffer.finish(&mut self.root);
        let document = self.root.to_string().expect("plain data");
        container(document.into_bytes(), bytes)
    }
}

fn gltf_quaternion(turn: turn::Turn) -> UnitQuaternion {
    UnitQuaternion(turn.to_gltf())
}

/// The chunks of a GLB file: the document filled up with blanks and the buffer with zeros to whole
/// words.
fn container(mut document: Vec<u8>, mut buffer: Vec<u8>) -> Vec<u8> {
    document.resize(document.len().next_multiple_of(4), b' ');
    buffer.resize(buffer.len().next_multiple_of(4), 0);
    let length = 12 + 8 + document.len() + 8 + buffer.len();
    let mut file = Vec::with_capacity(length);
    file.extend(b"glTF");
    file.extend(2u32.to_le_bytes());
    file.extend((length as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", document), (b"BIN\0", buffer)] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(chunk);
    }
    file
}

#[cfg(test)]
mod tests;
