//! Reference tensors computed elsewhere.
//!
//! A golden test reads all numbers and sizes from its file, so that the same test passes on files
//! made with another seed. Comparisons are counted, so that a test that compared nothing does not
//! pass: see [`counting`].

mod folder;
mod record;
mod reference;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use safetensors::{Dtype, SafeTensors};

pub use folder::Folder;
pub use record::{compared, counting};
pub use reference::{Reference, bound, differences, wide};

use reference::keep;

/// One file of reference tensors, in memory.
pub struct Golden {
    path: PathBuf,
    bytes: Vec<u8>,
    metadata: HashMap<String, String>,
}

impl Golden {
    /// The file at `path`.
    ///
    /// # Panics Panics if it is missing or cannot be parsed.
    pub fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).expect("golden file is readable");
        let (_, header) = SafeTensors::read_metadata(&bytes).expect("golden file has a header");
        Self {
            path: path.to_owned(),
            metadata: header.metadata().clone().unwrap_or_default(),
            bytes,
        }
    }

    /// A string of the file's metadata.
    ///
    /// # Panics
    /// Panics if there is none of that name.
    pub fn metadata(&self, key: &str) -> &str {
        self.find_metadata(key)
            .unwrap_or_else(|| panic!("{} has no metadata `{key}`", self.path.display()))
    }

    /// A string of the file's metadata, or `None` if the file lacks it.
    pub fn find_metadata(&self, key: &str) -> Option<&str> {
        self.metadata.get(key).map(String::as_str)
    }

    fn parsed(&self) -> SafeTensors<'_> {
        SafeTensors::deserialize(&self.bytes).expect("golden file parses")
    }

    /// Names of all tensors, sorted.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = self
            .parsed()
            .names()
            .iter()
            .map(|n| n.to_string())
            .collect();
        names.sort_unstable();
        names
    }

    /// Names that begin with `prefix`, sorted, without the prefix.
    ///
    /// # Panics
    /// Panics if there are none: a loop over them would compare nothing.
    #[track_caller]
    pub fn names_under(&self, prefix: &str) -> Vec<String> {
        let names = self.names();
        let under = names.iter().filter_map(|name| name.strip_prefix(prefix));
        let under: Vec<String> = under.map(str::to_string).collect();
        let file = self.path.display();
        assert!(!under.is_empty(), "{file} has no tensor `{prefix}*`");
        under
    }

    /// True if the file contains a tensor of that name.
    pub fn has(&self, name: &str) -> bool {
        self.parsed().tensor(name).is_ok()
    }

    /// The tensor `name`.
    ///
    /// # Panics
    /// Panics if there is none.
    pub fn get(&self, name: &str) -> Reference {
        let parsed = self.parsed();
        let view = parsed
            .tensor(name)
            .unwrap_or_else(|_| panic!("{} has no tensor `{name}`", self.path.display()));
        let bytes = view.data();
        let values = match view.dtype() {
            Dtype::F64 => each(bytes, f64::from_le_bytes),
            Dtype::F32 => each(bytes, |b| f64::from(f32::from_le_bytes(b))),
            Dtype::I64 => each(bytes, |b| i64::from_le_bytes(b) as f64),
            Dtype::I32 => each(bytes, |b| f64::from(i32::from_le_bytes(b))),
            Dtype::U8 => bytes.iter().map(|&b| f64::from(b)).collect(),
            other => panic!("`{name}` has the unexpected type {other:?}"),
        };
        Reference {
            shape: view.shape().to_vec(),
            values,
        }
    }

    /// The float64 twin of `out.{name}` or `grad.{name}` (the reference), or the entry itself if
    /// the file contains only one.
    pub fn reference(&self, name: &str) -> Reference {
        let twin = match name.split_once('.') {
            Some((kind, rest)) => format!("{kind}64.{rest}"),
            None => name.to_string(),
        };
        if self.has(&twin) {
            self.get(&twin)
        } else {
            self.get(name)
        }
    }

    /// The tensor `name`, or `None` if the file lacks it.
    pub fn find(&self, name: &str) -> Option<Reference> {
        self.has(name).then(|| self.get(name))
    }

    /// Asserts `max|actual - reference| <= tolerance` over the whole tensor `name`.
    ///
    /// # Panics
    /// As [`Reference::largest_difference`], and if the bound is exceeded.
    #[track_caller]
    pub fn compare(&self, name: &str, actual: &[f64], tolerance: f64) {
        self.compare_lists(name, actual, &self.get(name).values, tolerance);
    }

    /// Asserts `max|actual - reference| <= tolerance` over two lists.
    ///
    /// # Panics
    /// As [`differences`], and if the bound is exceeded.
    #[track_caller]
    pub fn compare_lists(&self, what: &str, actual: &[f64], reference: &[f64], tolerance: f64) {
        let error = differences(what, actual, reference).fold(0.0, f64::max);
        keep(&self.titled(what), error, tolerance);
    }

    /// Asserts that `actual` is the tensor `name`, to the last bit.
    ///
    /// # Panics
    /// Panics if it is not.
    #[track_caller]
    pub fn compare_exactly(&self, name: &str, actual: &[f64]) {
        let reference = self.get(name).values;
        compared(reference.len());
        assert_eq!(actual, reference, "{}", self.titled(name));
    }

    /// [`compare`](Self::compare), relative to the largest magnitude of the reference.
    #[track_caller]
    pub fn compare_relative(&self, name: &str, actual: &[f64], tolerance: f64) {
        let error = self.get(name).relative_error(name, actual);
        keep(&self.titled(name), error, tolerance);
    }

    /// [`bound`], under the file's name.
    #[track_caller]
    pub fn bound(&self, what: &str, error: f64, tolerance: f64) {
        bound(&self.titled(what), error, tolerance);
    }

    fn titled(&self, what: &str) -> String {
        format!("{} {what}", self.name())
    }

    /// The file's name without its extension.
    pub fn name(&self) -> String {
        let stem = self.path.file_stem().unwrap_or_default();
        stem.to_string_lossy().into_owned()
    }
}

fn each<const N: usize>(bytes: &[u8], convert: impl Fn([u8; N]) -> f64) -> Vec<f64> {
    let (chunks, rest) = bytes.as_chunks::<N>();
    assert!(
        rest.is_empty(),
        "tensor length is a multiple of its element size"
    );
    chunks.iter().map(|chunk| convert(*chunk)).collect()
}

/// The root of the repository.
pub fn workspace() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}
