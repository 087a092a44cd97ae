//! Reference tensors computed elsewhere.
//!
//! A golden test reads all numbers and sizes from its file, so that the same test passes on files
//! made with another seed. The folder is `KINEGRAD_GOLDEN` when that is set, and then a missing
//! file fails; otherwise it is `data_fixtures/golden`, which holds the small files only, and a
//! test whose file is not there has nothing to compare and returns.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use safetensors::{Dtype, SafeTensors};

/// One file of reference tensors, held in memory.
pub struct Golden {
    path: PathBuf,
    bytes: Vec<u8>,
    metadata: HashMap<String, String>,
}

/// One reference tensor: its shape and its values, widened to f64.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Sizes, outermost first; empty for a scalar.
    pub shape: Vec<usize>,
    /// Values in row-major order.
    pub values: Vec<f64>,
}

impl Golden {
    /// Opens `{family}/{file}`, or returns `None` when the small set does not hold it.
    ///
    /// # Panics
    /// Panics if `KINEGRAD_GOLDEN` is set and the file is missing, or if it cannot be parsed.
    pub fn open(family: &str, file: &str) -> Option<Self> {
        Self::locate(family, file).map(|path| Self::read(&path))
    }

    /// The path of `{family}/{file}`, or `None` when the small set does not hold it.
    ///
    /// # Panics
    /// Panics if `KINEGRAD_GOLDEN` is set and the file is missing.
    pub fn locate(family: &str, file: &str) -> Option<PathBuf> {
        let set = std::env::var_os("KINEGRAD_GOLDEN").filter(|folder| !folder.is_empty());
        let root = match &set {
            // Tests run in their package's folder; a relative folder is meant from the root.
            Some(folder) => workspace().join(folder),
            None => workspace().join("data_fixtures/golden"),
        };
        let path = root.join(family).join(file);
        if !path.exists() {
            assert!(
                set.is_none(),
                "KINEGRAD_GOLDEN is set and {} is missing",
                path.display()
            );
            eprintln!(
                "{} is not among the small fixtures: nothing compared",
                path.display()
            );
            return None;
        }
        Some(path)
    }

    /// The file at `path`.
    ///
    /// # Panics
    /// Panics if it is not there or cannot be parsed.
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
        self.metadata
            .get(key)
            .unwrap_or_else(|| panic!("{} has no metadata `{key}`", self.path.display()))
    }

    /// The whole metadata.
    pub fn all_metadata(&self) -> &HashMap<String, String> {
        &self.metadata
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

    /// Names that begin with `prefix`, sorted, with the prefix taken off.
    pub fn names_under(&self, prefix: &str) -> Vec<String> {
        self.names()
            .iter()
            .filter_map(|name| name.strip_prefix(prefix).map(str::to_string))
            .collect()
    }

    /// Whether the file holds a tensor of that name.
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

    /// The float64 twin of `out.{name}` or `grad.{name}` (the reference), or the entry itself
    /// where the file holds only one.
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

    /// The tensor `name`, or `None` if the file leaves it out.
    pub fn find(&self, name: &str) -> Option<Reference> {
        self.has(name).then(|| self.get(name))
    }

    /// Asserts `max|actual - reference| <= tolerance` over the whole tensor `name`.
    ///
    /// # Panics
    /// As [`Reference::largest_difference`], and if the bound is exceeded.
    #[track_caller]
    pub fn compare(&self, name: &str, actual: &[f64], tolerance: f64) {
        let error = self.get(name).largest_difference(name, actual);
        self.bound(name, error, tolerance);
    }

    /// [`compare`](Self::compare), relative to the largest magnitude of the reference.
    #[track_caller]
    pub fn compare_relative(&self, name: &str, actual: &[f64], tolerance: f64) {
        self.bound(name, self.get(name).relative_error(name, actual), tolerance);
    }

    /// [`bound`], under the file's name.
    #[track_caller]
    pub fn bound(&self, what: &str, error: f64, tolerance: f64) {
        bound(&format!("{} {what}", self.name()), error, tolerance);
    }

    /// The file's name without its extension.
    pub fn name(&self) -> String {
        let stem = self.path.file_stem().unwrap_or_default();
        stem.to_string_lossy().into_owned()
    }
}

impl Reference {
    /// The values in single precision.
    pub fn f32s(&self) -> Vec<f32> {
        self.values.iter().map(|&v| v as f32).collect()
    }

    /// The values as non-negative integers.
    pub fn indices(&self) -> Vec<usize> {
        self.values.iter().map(|&v| v as usize).collect()
    }

    /// The only value.
    ///
    /// # Panics
    /// Panics if there are several.
    pub fn scalar(&self) -> f64 {
        assert_eq!(self.values.len(), 1, "not a scalar: shape {:?}", self.shape);
        self.values[0]
    }

    /// The values as vectors of N.
    ///
    /// # Panics
    /// Panics if some are left over.
    pub fn vectors<const N: usize>(&self) -> Vec<[f64; N]> {
        let (vectors, rest) = self.values.as_chunks::<N>();
        assert!(rest.is_empty(), "{:?} in vectors of {N}", self.shape);
        vectors.to_vec()
    }

    /// `max|actual - reference|` over the whole tensor.
    ///
    /// # Panics
    /// Panics if the sizes differ or a value is not finite.
    #[track_caller]
    pub fn largest_difference(&self, what: &str, actual: &[f64]) -> f64 {
        differences(what, actual, &self.values).fold(0.0, f64::max)
    }

    /// `max|actual - reference| / max|reference|`; where the reference is 0 everywhere, the
    /// difference itself.
    ///
    /// # Panics
    /// As [`largest_difference`](Self::largest_difference).
    #[track_caller]
    pub fn relative_error(&self, what: &str, actual: &[f64]) -> f64 {
        let scale = self.values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let worst = self.largest_difference(what, actual);
        if scale == 0.0 { worst } else { worst / scale }
    }

    /// Asserts `max|actual - reference| <= tolerance * max|reference|` over the whole tensor and
    /// returns the measured ratio.
    ///
    /// # Panics
    /// Panics if the sizes differ, a value is not finite, or the bound is exceeded.
    #[track_caller]
    pub fn assert_close(&self, what: &str, actual: &[f64], tolerance: f64) -> f64 {
        let error = self.relative_error(what, actual);
        bound(what, error, tolerance);
        error
    }

    /// Asserts `|actual - reference| <= absolute + relative |reference|` of every value and
    /// returns the largest absolute difference.
    ///
    /// # Panics
    /// Panics if the sizes differ, a value is not finite, or the bound is exceeded.
    #[track_caller]
    pub fn assert_within_f32(
        &self,
        what: &str,
        actual: &[f32],
        absolute: f64,
        relative: f64,
    ) -> f64 {
        let mut worst = 0.0f64;
        let actual = wide(actual);
        let errors = differences(what, &actual, &self.values).zip(&self.values);
        for (index, (error, r)) in errors.enumerate() {
            let bound = absolute + relative * r.abs();
            assert!(
                error <= bound,
                "{what}[{index}]: off {r} by {error:.3e} of {bound:.1e}"
            );
            worst = worst.max(error);
        }
        println!("{what}: error {worst:.1e} of {absolute:.0e}");
        worst
    }

    /// The part `index` of the first axis.
    ///
    /// # Panics
    /// Panics if there are not so many.
    pub fn part(&self, index: usize) -> Self {
        let (&parts, shape) = self.shape.split_first().expect("an axis");
        let size = self.values.len() / parts;
        Self {
            shape: shape.to_vec(),
            values: self.values[index * size..(index + 1) * size].to_vec(),
        }
    }

    /// The same without axes of one element between the second and the last: `[batch, channels, 1,
    /// time]` as `[batch, channels, time]`.
    #[must_use]
    pub fn flat(&self) -> Self {
        let last = self.shape.len() - 1;
        let kept = self.shape.iter().enumerate();
        let kept = kept.filter(|&(axis, &size)| size != 1 || axis < 2 || axis == last);
        Self {
            shape: kept.map(|(_, &size)| size).collect(),
            values: self.values.clone(),
        }
    }

    /// [`assert_close`](Self::assert_close) for single-precision values.
    #[track_caller]
    pub fn assert_close_f32(&self, what: &str, actual: &[f32], tolerance: f64) -> f64 {
        self.assert_close(what, &wide(actual), tolerance)
    }
}

/// The differences of two lists, place by place.
///
/// # Panics
/// Panics if the sizes differ, and later where a value of `actual` is not finite.
#[track_caller]
pub fn differences<'a>(
    what: &'a str,
    actual: &'a [f64],
    reference: &'a [f64],
) -> impl Iterator<Item = f64> + 'a {
    assert_eq!(actual.len(), reference.len(), "{what}: number of values");
    let pairs = actual.iter().zip(reference).enumerate();
    pairs.map(move |(index, (a, r))| {
        assert!(a.is_finite(), "{what}[{index}] is {a}");
        (a - r).abs()
    })
}

/// Single-precision values, widened.
pub fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&value| f64::from(value)).collect()
}

/// Prints an error beside its bound, and asserts that it keeps it.
///
/// # Panics
/// Panics if it does not, or if it is not a number.
#[track_caller]
pub fn bound(what: &str, error: f64, tolerance: f64) {
    println!("{what}: error {error:.1e} of {tolerance:.0e}");
    assert!(
        error <= tolerance,
        "{what}: error {error:.3e} exceeds {tolerance:.1e}"
    );
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
