//! The JSON document of a glTF file and its one buffer.

use serde_json::{Value, json};

use crate::scene::bounds;

/// Component types and buffer targets, as numbered in the specification.
const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
pub(super) const ARRAY_BUFFER: Option<u32> = Some(34962);
const ELEMENT_ARRAY_BUFFER: Option<u32> = Some(34963);

/// A document under construction. Elements refer to one another by their index in these lists.
#[derive(Default)]
pub(super) struct Document {
    pub nodes: Vec<Value>,
    /// Nodes without a parent.
    pub roots: Vec<usize>,
    pub meshes: Vec<Value>,
    pub skins: Vec<Value>,
    pub channels: Vec<Value>,
    pub samplers: Vec<Value>,
    accessors: Vec<Value>,
    views: Vec<Value>,
    /// Every array begins at a multiple of four bytes.
    buffer: Vec<u8>,
}

/// Appends an element and returns its index.
pub(super) fn push(list: &mut Vec<Value>, element: Value) -> usize {
    list.push(element);
    list.len() - 1
}

impl Document {
    /// An accessor of single-precision numbers.
    pub fn floats<const N: usize>(&mut self, rows: &[[f32; N]], target: Option<u32>) -> usize {
        let bytes = rows.as_flattened().iter().flat_map(|v| v.to_le_bytes());
        let shape = match N {
            1 => "SCALAR",
            3 => "VEC3",
            4 => "VEC4",
            _ => "MAT4",
        };
        self.array(bytes.collect(), rows.len(), (FLOAT, shape), target)
    }

    /// [`floats`](Self::floats) with the minimum and maximum of each component.
    pub fn ranged<const N: usize>(&mut self, rows: &[[f32; N]], target: Option<u32>) -> usize {
        let accessor = self.floats(rows, target);
        let [low, high] = bounds(rows);
        self.accessors[accessor]["min"] = json!(low.as_slice());
        self.accessors[accessor]["max"] = json!(high.as_slice());
        accessor
    }

    /// An accessor of the joints that move each vertex.
    pub fn joints(&mut self, rows: &[[u16; 4]]) -> usize {
        let bytes = rows.as_flattened().iter().flat_map(|v| v.to_le_bytes());
        let kind = (UNSIGNED_SHORT, "VEC4");
        self.array(bytes.collect(), rows.len(), kind, ARRAY_BUFFER)
    }

    /// An accessor of the corners of triangles.
    pub fn indices(&mut self, values: &[u32]) -> usize {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let kind = (UNSIGNED_INT, "SCALAR");
        self.array(bytes, values.len(), kind, ELEMENT_ARRAY_BUFFER)
    }

    fn array(
        &mut self,
        bytes: Vec<u8>,
        count: usize,
        (component, shape): (u32, &str),
        target: Option<u32>,
    ) -> usize {
        let offset = self.buffer.len().next_multiple_of(4);
        self.buffer.resize(offset, 0);
        let mut view = json!({ "buffer": 0, "byteLength": bytes.len(), "byteOffset": offset });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.buffer.extend(bytes);
        let view = push(&mut self.views, view);
        let accessor = json!({
            "bufferView": view, "componentType": component, "count": count, "type": shape,
        });
        push(&mut self.accessors, accessor)
    }

    /// The GLB file: a header, the document padded with blanks and the buffer padded with zeros to
    /// multiples of four bytes.
    pub fn finish(self, title: &str, material: Value) -> Vec<u8> {
        let mut scene = json!({ "nodes": self.roots });
        let mut animation = json!({ "channels": self.channels, "samplers": self.samplers });
        if !title.is_empty() {
            scene["name"] = json!(title);
            animation["name"] = json!(title);
        }
        let animations = match self.samplers.is_empty() {
            true => vec![],
            false => vec![animation],
        };
        let lists = [
            ("accessors", self.accessors),
            ("animations", animations),
            ("buffers", vec![json!({ "byteLength": self.buffer.len() })]),
            ("bufferViews", self.views),
            ("materials", vec![material]),
            ("meshes", self.meshes),
            ("nodes", self.nodes),
            ("scenes", vec![scene]),
            ("skins", self.skins),
        ];
        // A list without elements is not valid.
        let lists = lists.into_iter().filter(|(_, list)| !list.is_empty());
        let mut document: Value = lists.collect();
        document["asset"] = json!({ "generator": "kinegrad", "version": "2.0" });
        document["scene"] = json!(0);
        let (mut text, mut buffer) = (document.to_string().into_bytes(), self.buffer);
        text.resize(text.len().next_multiple_of(4), b' ');
        buffer.resize(buffer.len().next_multiple_of(4), 0);
        let length = 12 + 8 + text.len() + 8 + buffer.len();
        let mut file = Vec::with_capacity(length);
        file.extend(b"glTF");
        file.extend(2u32.to_le_bytes());
        file.extend((length as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", text), (b"BIN\0", buffer)] {
            file.extend((chunk.len() as u32).to_le_bytes());
            file.extend(kind);
            file.extend(chunk);
        }
        file
    }
}
