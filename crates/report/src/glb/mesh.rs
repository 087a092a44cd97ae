//! Meshes: capsules over bones, a box for a lone root.

use std::collections::HashMap;
use std::f32::consts::{FRAC_PI_2, TAU};

use serde_json::{Value, json};

use super::document::{ARRAY_BUFFER, Document, push};
use super::rig::Rig;
use super::rotation::Rotation;
use crate::drawing::{DRAWING, Figure};
use crate::scene::SceneObject;

/// Number of corners around a capsule.
const SIDES: u32 = 10;
/// Number of rings in each round end of a capsule.
const RINGS: u32 = 3;
/// Color of all meshes (RGBA).
const COLOUR: [f32; 4] = [0.35, 0.5, 0.72, 1.0];

/// A triangle mesh.
#[derive(Default)]
pub(super) struct Mesh {
    places: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    triangles: Vec<u32>,
    /// The joint that moves each vertex; empty without a skin.
    joints: Vec<u16>,
}

impl Mesh {
    /// A capsule over every bone in the bind pose, moved by the bone's node.
    pub fn skin(object: &SceneObject, rig: &Rig, bind: &[[f32; 3]]) -> Self {
        let mut mesh = Self::default();
        let places: Vec<[f32; 3]> = rig.joints.iter().map(|node| bind[*node]).collect();
        let figure = Figure::of(object);
        let nodes = rig.nodes.iter().enumerate();
        let owners =
            nodes.flat_map(|(index, node)| node.bones_to.iter().map(move |&end| (end, index)));
        let owners: HashMap<usize, usize> = owners.collect();
        let bones = figure.bones.iter();
        let bones = bones.filter_map(|bone| Some((*owners.get(&bone.joint)?, bone)));
        let mut bones: Vec<_> = bones.collect();
        bones.sort_by_key(|(index, _)| *index);
        for (index, bone) in bones {
            mesh.capsule([bind[index], places[bone.joint]], bone.radius as f32);
            mesh.joints.resize(mesh.places.len(), index as u16);
        }
        if let Some([head, top]) = figure.head {
            let center = [0, 1, 2].map(|axis| (places[head][axis] + places[top][axis]) / 2.0);
            let radius = DRAWING.ball.head * figure.height;
            mesh.capsule([center; 2], radius as f32);
            mesh.joints
                .resize(mesh.places.len(), rig.joints[head] as u16);
        }
        if mesh.places.is_empty() {
            // If all bones have length 0, the root is shown.
            mesh.capsule([places[0]; 2], DRAWING.root.ball as f32);
            mesh.joints.resize(mesh.places.len(), 0);
        }
        mesh
    }

    /// A box that faces +z, with a pointer in front.
    pub fn body() -> Self {
        let mut mesh = Self::default();
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                mesh.face(axis, sign);
            }
        }
        let root = &DRAWING.root;
        let front = root.body[2];
        let ends = [front, front + root.shaft[1] + root.head[1]];
        mesh.capsule(ends.map(|z| [0.0, 0.0, z as f32]), root.shaft[0] as f32);
        mesh
    }

    /// A ball.
    pub fn ball() -> Self {
        let mut mesh = Self::default();
        mesh.capsule([[0.0; 3]; 2], DRAWING.root.ball as f32);
        mesh
    }

    /// A side of the box.
    fn face(&mut self, axis: usize, sign: f32) {
        let first = self.places.len() as u32;
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let body = DRAWING.root.body.map(|half| half as f32);
        for (along_u, along_v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            let mut place = [0.0; 3];
            place[axis] = sign * body[axis];
            place[u] = along_u * sign * body[u];
            place[v] = along_v * body[v];
            self.places.push(place);
            let mut normal = [0.0; 3];
            normal[axis] = sign;
            self.normals.push(normal);
        }
        let corners = [0, 1, 2, 0, 2, 3];
        self.triangles.extend(corners.map(|corner| first + corner));
    }

    /// A cylinder with round ends.
    fn capsule(&mut self, [from, to]: [[f32; 3]; 2], radius: f32) {
        let along = [0, 1, 2].map(|axis| f64::from(to[axis] - from[axis]));
        let turn = Rotation::between([0.0, 1.0, 0.0], along);
        let first = self.places.len() as u32;
        // Rings from pole to pole; each end has a separate equator.
        let rings = 2 * (RINGS + 1);
        for ring in 0..rings {
            let (end, step) = if ring <= RINGS {
                (from, f32::from(ring as u16) - RINGS as f32)
            } else {
                (to, (ring - RINGS - 1) as f32)
            };
            let (high, wide) = (step / RINGS as f32 * FRAC_PI_2).sin_cos();
            for side in 0..SIDES {
                let (sin, cos) = (side as f32 / SIDES as f32 * TAU).sin_cos();
                let normal = turn.rotate([wide * cos, high, wide * sin].map(f64::from));
                let normal = normal.map(|value| value as f32);
                let place = [0, 1, 2].map(|axis| end[axis] + radius * normal[axis]);
                self.places.push(place);
                self.normals.push(normal);
            }
        }
        for ring in (0..rings - 1).filter(|ring| *ring != RINGS || from != to) {
            for side in 0..SIDES {
                let next = (side + 1) % SIDES;
                let corner = |ring: u32, side: u32| first + ring * SIDES + side;
                let (a, b) = (corner(ring, side), corner(ring, next));
                let (c, d) = (corner(ring + 1, side), corner(ring + 1, next));
                // All corners of a ring coincide at the poles.
                if ring > 0 {
                    self.triangles.extend([a, c, b]);
                }
                if ring < rings - 2 {
                    self.triangles.extend([b, c, d]);
                }
            }
        }
    }

    /// Adds the mesh to a document and returns its index.
    pub fn push(self, document: &mut Document, name: &str) -> usize {
        let mut attributes = json!({
            "POSITION": document.ranged(&self.places, ARRAY_BUFFER),
            "NORMAL": document.ranged(&self.normals, ARRAY_BUFFER),
        });
        let triangles = document.indices(&self.triangles);
        if !self.joints.is_empty() {
            let joints: Vec<[u16; 4]> = self.joints.iter().map(|joint| [*joint, 0, 0, 0]).collect();
            let weights = vec![[1.0, 0.0, 0.0, 0.0]; joints.len()];
            attributes["JOINTS_0"] = json!(document.joints(&joints));
            attributes["WEIGHTS_0"] = json!(document.floats(&weights, ARRAY_BUFFER));
        }
        let primitive = json!({ "attributes": attributes, "indices": triangles, "material": 0 });
        push(
            &mut document.meshes,
            json!({ "name": name, "primitives": [primitive] }),
        )
    }
}

/// The material of all meshes.
pub(super) fn material() -> Value {
    json!({ "pbrMetallicRoughness": {
        "baseColorFactor": COLOUR, "metallicFactor": 0.0, "roughnessFactor": 0.7,
    }})
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_triangles_face_outwards() {
        for mesh in [Mesh::body(), Mesh::ball(), {
            let mut mesh = Mesh::default();
            mesh.capsule([[0.3, 0.2, 0.1], [-0.2, 0.5, 0.3]], 0.05);
            mesh
        }] {
            for corners in mesh.triangles.chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|n| mesh.places[corners[n] as usize].map(f64::from));
                let side = |from: [f64; 3], to: [f64; 3]| [0, 1, 2].map(|i| to[i] - from[i]);
                let across = crate::scene::cross(side(a, b), side(a, c));
                let normal = [0, 1, 2].map(|axis| {
                    let corners = corners.iter();
                    corners
                        .map(|n| f64::from(mesh.normals[*n as usize][axis]))
                        .sum()
                });
                assert!(
                    super::super::rotation::dot(across, normal) > 0.0,
                    "{a:?} {b:?} {c:?}"
                );
            }
        }
    }
}
