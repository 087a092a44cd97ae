//! Reference tensors computed elsewhere.
//!
//! A golden test reads all numbers and sizes from its file, so that the same test passes on files
//! made with another seed. The folder is `KINEGRAD_GOLDEN` when that is set, and then a missing
//! file fails; otherwise it is `data_fixtures/golden`, which holds the small files only, and a
//! test whose file is not there has nothing to compare and returns.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor, TensorData};
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
        Some(Self::read(&path))
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

    /// The tensor `name` on `device`.
    pub fn tensor<const D: usize>(&self, name: &str, device: &Device) -> Tensor<D> {
        self.get(name).tensor(device)
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

    /// The values on `device`.
    pub fn tensor<const D: usize>(&self, device: &Device) -> Tensor<D> {
        Tensor::from_data(TensorData::new(self.f32s(), self.shape.clone()), device)
    }

    /// Asserts `max|actual - reference| <= tolerance * max|reference|` over the whole tensor and
    /// returns the measured ratio.
    ///
    /// # Panics
    /// Panics if the sizes differ, a value is not finite, or the bound is exceeded.
    #[track_caller]
    pub fn assert_close(&self, what: &str, actual: &[f64], tolerance: f64) -> f64 {
        assert_eq!(actual.len(), self.values.len(), "{what}: number of values");
        let scale = self.values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let mut worst = 0.0f64;
        for (index, (a, r)) in actual.iter().zip(&self.values).enumerate() {
            assert!(a.is_finite(), "{what}[{index}] is {a}");
            worst = worst.max((a - r).abs());
        }
        let error = if scale == 0.0 { worst } else { worst / scale };
        assert!(
            error <= tolerance,
            "{what}: error {error:.3e} exceeds {tolerance:.1e}"
        );
        println!("{what}: error {error:.1e} of {tolerance:.0e}");
        error
    }

    /// Asserts `|actual - reference| <= absolute + relative |reference|` of every value and
    /// returns the largest absolute difference.
    ///
    /// # Panics
    /// Panics if the sizes differ, a value is not finite, or the bound is exceeded.
    #[track_caller]
    pub fn assert_within<const D: usize>(
        &self,
        what: &str,
        actual: Tensor<D>,
        absolute: f64,
        relative: f64,
    ) -> f64 {
        let actual = actual.try_into_vec_as::<f32>().expect("a float32 tensor");
        assert_eq!(actual.len(), self.values.len(), "{what}: number of values");
        let mut worst = 0.0f64;
        for (index, (&a, r)) in actual.iter().zip(&self.values).enumerate() {
            assert!(a.is_finite(), "{what}[{index}] is {a}");
            let error = (f64::from(a) - r).abs();
            let bound = absolute + relative * r.abs();
            assert!(
                error <= bound,
                "{what}[{index}]: {a} for {r}, off by {error:.3e} of {bound:.1e}"
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
        let widened: Vec<f64> = actual.iter().map(|&v| f64::from(v)).collect();
        self.assert_close(what, &widened, tolerance)
    }

    /// [`assert_close`](Self::assert_close) for a tensor.
    #[track_caller]
    pub fn assert_close_tensor<const D: usize>(
        &self,
        what: &str,
        actual: Tensor<D>,
        tolerance: f64,
    ) -> f64 {
        assert_eq!(actual.dims().to_vec(), self.shape, "{what}: shape");
        let values = actual.try_into_vec_as::<f32>().expect("a float32 tensor");
        self.assert_close_f32(what, &values, tolerance)
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
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}
