use std::borrow::Cow;
use std::collections::HashMap;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Seek};
use std::path::Path;

use kinegrad_data::file::regular;
use kinegrad_models::parameters::{HostParameter, ParameterInfo};
use kinegrad_output::Unfinished;
use safetensors::tensor::Metadata;
use safetensors::{Dtype, SafeTensorError, SafeTensors, View};
use serde::{Deserialize, Serialize};

use super::are_finite;
use super::state::{State, file_of, sha256_of};
use crate::Error;
use crate::memory;
use crate::optim::Moments;

/// The weights of a checkpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Weights {
    /// The trained weights.
    Model,
    /// Their moving average.
    Ema,
}

impl Weights {
    /// File name in a checkpoint.
    pub fn file(self) -> &'static str {
        match self {
            Self::Model => "model.safetensors",
            Self::Ema => "ema.safetensors",
        }
    }
}

pub(super) const OPTIMIZER: &str = "optimizer.safetensors";

/// A float32 tensor that safetensors can write.
struct HostView<'a> {
    shape: &'a [usize],
    values: &'a [f32],
}

impl View for HostView<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }
    fn shape(&self) -> &[usize] {
        self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(bytemuck::cast_slice(self.values))
    }
    fn data_len(&self) -> usize {
        size_of_val(self.values)
    }
}

/// Writes and flushes one file of tensors; returns its checksum.
pub(super) fn write<'a>(
    path: &Path,
    tensors: impl IntoIterator<Item = (String, &'a [usize], &'a [f32])>,
) -> Result<String, Error> {
    let views = tensors
        .into_iter()
        .map(|(name, shape, values)| (name, HostView { shape, values }));
    // Python loaders of torch models read the key `format`.
    let metadata = HashMap::from([("format".to_string(), "pt".to_string())]);
    let unfinished = Unfinished::new(path).map_err(Error::io("create", path))?;
    let written = safetensors::serialize_to_file(views, Some(metadata), unfinished.path());
    written.map_err(|error| match error {
        SafeTensorError::IoError(error) => Error::io("write", path)(error),
        other => unreachable!("names are unique and shapes fit: {other}"),
    })?;
    unfinished.finish().map_err(Error::io("write", path))?;
    let mut file = File::open(path).map_err(Error::io("open", path))?;
    sha256_of(&mut file).map_err(Error::io("read", path))
}

/// Reads the optimizer's running means in the order of `infos`; empty for frozen parameters.
pub(super) fn read_optimizer(
    path: &Path,
    state: &State,
    infos: &[ParameterInfo],
) -> Result<Vec<Moments>, Error> {
    let mut by_name: HashMap<String, Vec<f32>> = read(path, state, OPTIMIZER)?
        .into_iter()
        .map(|p| (p.info.name, p.values))
        .collect();
    let moments = infos.iter().map(|info| {
        let mut take = |moment: &str| by_name.remove(&format!("{}.{moment}", info.name));
        Moments {
            exp_avg: take("exp_avg").unwrap_or_default(),
            exp_avg_sq: take("exp_avg_sq").unwrap_or_default(),
        }
    });
    Ok(moments.collect())
}

/// Reads the tensors in `file` of the checkpoint in `path`, verified against `state`.
pub(super) fn read(path: &Path, state: &State, file: &str) -> Result<Vec<HostParameter>, Error> {
    let damaged = |reason: String| Error::CheckpointDamaged {
        path: path.to_path_buf(),
        reason: format!("{file}: {reason}"),
    };
    let checksum = state.checksums.get(file).map(String::as_str);
    let intact = file_of(path, file, |file| read_intact(file, checksum))?;
    let bytes = intact.map_err(damaged)?;
    let parsed = SafeTensors::deserialize(&bytes).map_err(|error| damaged(error.to_string()))?;
    let mut parameters = parsed
        .iter()
        .map(|(name, view)| {
            if view.dtype() != Dtype::F32 {
                return Err(damaged(format!("`{name}` is {:?}, not F32", view.dtype())));
            }
            let values: Vec<f32> = bytemuck::pod_collect_to_vec(view.data());
            if !are_finite(&values) {
                let reason = format!("`{name}` contains a number that is not finite");
                return Err(damaged(reason));
            }
            let info = ParameterInfo {
                name: name.to_string(),
                shape: view.shape().to_vec(),
            };
            Ok(HostParameter { info, values })
        })
        .collect::<Result<Vec<_>, Error>>()?;
    // The library returns the tensors in any order.
    parameters.sort_by(|a, b| a.info.name.cmp(&b.info.name));
    Ok(parameters)
}

/// The bytes of the intact file of tensors at `path`, or its fault.
///
/// A damaged file may have any length. A file is read into memory only if its length equals the
/// length in its header and fits in memory, and its checksum matches.
fn read_intact(path: &Path, checksum: Option<&str>) -> io::Result<Result<Vec<u8>, String>> {
    let length = regular(path)?;
    let mut file = File::open(path)?;
    match stated_length(&mut file)? {
        Some(stated) if stated == length => {}
        Some(stated) => {
            let reason = format!("{length} bytes found, its header states {stated}");
            return Ok(Err(reason));
        }
        None => return Ok(Err("its header cannot be read".into())),
    }
    // Reading also copies the numbers. Lack of memory is not damage, so no older checkpoint is
    // taken.
    let needed = length.saturating_mul(2);
    if let Some(free) = memory::available()
        && needed > free
    {
        let [needed, free] = [needed, free].map(memory::size);
        let message = format!("reading it needs {needed}, {free} of memory are free");
        return Err(io::Error::new(ErrorKind::OutOfMemory, message));
    }
    file.rewind()?;
    if checksum != Some(&*sha256_of(&mut file)?) {
        return Ok(Err("the checksum does not match".into()));
    }
    file.rewind()?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(length as usize)?;
    file.take(length).read_to_end(&mut bytes)?;
    Ok(Ok(bytes))
}

/// Longest header that is read, as in the library.
const MAX_HEADER_BYTES: u64 = 100_000_000;

/// The length of a file of tensors according to its header; `None` without a header.
fn stated_length(file: &mut File) -> io::Result<Option<u64>> {
    let mut start = Vec::new();
    (&*file).take(8).read_to_end(&mut start)?;
    let Ok(length) = start.try_into().map(u64::from_le_bytes) else {
        return Ok(None);
    };
    if length > MAX_HEADER_BYTES {
        return Ok(None);
    }
    let mut header = Vec::new();
    file.take(length).read_to_end(&mut header)?;
    let Ok(metadata) = serde_json::from_slice::<Metadata>(&header) else {
        return Ok(None);
    };
    let ends = metadata.tensors().into_values();
    let end = ends.map(|tensor| tensor.data_offsets.1 as u64).max();
    Ok((8 + length).checked_add(end.unwrap_or(0)))
}
