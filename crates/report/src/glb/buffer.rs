//! The numbers of a glTF file.

use gltf_json as json;
use json::accessor::{ComponentType, GenericComponentType, Type};
use json::buffer::{Target, View};
use json::validation::Checked::Valid;
use json::validation::USize64;
use json::{Accessor, Index, Value};

/// The one buffer of a file, in which every array begins at a whole word.
#[derive(Default)]
pub(super) struct Buffer {
    bytes: Vec<u8>,
}

/// An array that becomes an accessor.
struct Array<'a> {
    bytes: &'a [u8],
    count: usize,
    component: ComponentType,
    shape: Type,
    target: Option<Target>,
    /// Lowest and highest number of each component.
    range: Option<(Value, Value)>,
}

impl Buffer {
    /// Moments of an animation, with their range.
    pub fn scalars(&mut self, root: &mut json::Root, values: &[f32]) -> Index<Accessor> {
        let rows: Vec<[f32; 1]> = values.iter().map(|value| [*value]).collect();
        self.floats(root, &rows, Type::Scalar, None, true)
    }

    /// Translations over time.
    pub fn vectors(&mut self, root: &mut json::Root, values: &[[f32; 3]]) -> Index<Accessor> {
        self.floats(root, values, Type::Vec3, None, true)
    }

    /// Rotations (x, y, z, w) over time.
    pub fn quaternions(&mut self, root: &mut json::Root, values: &[[f32; 4]]) -> Index<Accessor> {
        self.floats(root, values, Type::Vec4, None, true)
    }

    /// Matrices, column by column.
    pub fn matrices(&mut self, root: &mut json::Root, values: &[[f32; 16]]) -> Index<Accessor> {
        self.floats(root, values, Type::Mat4, None, false)
    }

    /// Places or directions of the vertices of a mesh.
    pub fn vertices(&mut self, root: &mut json::Root, values: &[[f32; 3]]) -> Index<Accessor> {
        self.floats(root, values, Type::Vec3, Some(Target::ArrayBuffer), true)
    }

    /// How much each joint moves each vertex.
    pub fn weights(&mut self, root: &mut json::Root, values: &[[f32; 4]]) -> Index<Accessor> {
        self.floats(root, values, Type::Vec4, Some(Target::ArrayBuffer), false)
    }

    /// The joints that move each vertex.
    pub fn joints(&mut self, root: &mut json::Root, values: &[[u16; 4]]) -> Index<Accessor> {
        let numbers = values.as_flattened().iter();
        let bytes: Vec<u8> = numbers.flat_map(|number| number.to_le_bytes()).collect();
        let array = Array {
            bytes: &bytes,
            count: values.len(),
            component: ComponentType::U16,
            shape: Type::Vec4,
            target: Some(Target::ArrayBuffer),
            range: None,
        };
        self.push(root, array)
    }

    /// The corners of triangles.
    pub fn indices(&mut self, root: &mut json::Root, values: &[u32]) -> Index<Accessor> {
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect();
        let array = Array {
            bytes: &bytes,
            count: values.len(),
            component: ComponentType::U32,
            shape: Type::Scalar,
            target: Some(Target::ElementArrayBuffer),
            range: None,
        };
        self.push(root, array)
    }

    fn floats<const N: usize>(
        &mut self,
        root: &mut json::Root,
        rows: &[[f32; N]],
        shape: Type,
        target: Option<Target>,
        ranged: bool,
    ) -> Index<Accessor> {
        let numbers = rows.as_flattened().iter();
        let bytes: Vec<u8> = numbers.flat_map(|number| number.to_le_bytes()).collect();
        let extreme = |of: fn(f32, f32) -> f32| {
            let rows = rows.iter().copied();
            let found = rows.reduce(|a, b| std::array::from_fn(|i| of(a[i], b[i])));
            Value::from(found.expect("there are values").to_vec())
        };
        let array = Array {
            bytes: &bytes,
            count: rows.len(),
            component: ComponentType::F32,
            shape,
            target,
            range: ranged.then(|| (extreme(f32::min), extreme(f32::max))),
        };
        self.push(root, array)
    }

    fn push(&mut self, root: &mut json::Root, array: Array<'_>) -> Index<Accessor> {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let view = root.push(View {
            buffer: Index::new(0),
            byte_length: USize64::from(array.bytes.len()),
            byte_offset: Some(USize64::from(self.bytes.len())),
            byte_stride: None,
            name: None,
            target: array.target.map(Valid),
            extensions: None,
            extras: json::Extras::default(),
        });
        self.bytes.extend(array.bytes);
        let (min, max) = array.range.unzip();
        root.push(Accessor {
            buffer_view: Some(view),
            byte_offset: None,
            count: USize64::from(array.count),
            component_type: Valid(GenericComponentType(array.component)),
            extensions: None,
            extras: json::Extras::default(),
            type_: Valid(array.shape),
            min,
            max,
            name: None,
            normalized: false,
            sparse: None,
        })
    }

    /// The bytes, whose length the document then states.
    pub fn finish(self, root: &mut json::Root) -> Vec<u8> {
        root.buffers.push(json::Buffer {
            byte_length: USize64::from(self.bytes.len()),
            name: None,
            uri: None,
            extensions: None,
            extras: json::Extras::default(),
        });
        self.bytes
    }
}
