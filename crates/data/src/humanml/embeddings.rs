//! Embeddings of captions: one safetensors file with `[captions, 512]` for each clip.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use half::f16;
use kinegrad_motion::humanml::TEXT_CHANNELS;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

use crate::file::{MAX_TENSOR_BYTES, read_file};
use crate::magnitude::{allowed, first_unusable};
use crate::{Digest, Error, FileError, atomic, npy};

const HINT: &str = "`kinegrad text embed` makes the file (docs/dataset.md); data.humanml3d.text_embeddings = \
                    \"\" does without";

/// The embeddings of all captions of a dataset, in memory.
#[derive(Debug)]
pub(super) struct Embeddings {
    /// Embeddings of each clip, in the order of its captions.
    clips: HashMap<String, Vec<Arc<[f32]>>>,
    /// Checksums of the embedded captions, for clips with a checksum in the file.
    captions: HashMap<String, String>,
    file: String,
    pub digest: Digest,
}

impl Embeddings {
    /// Parses the file called `file`, whose checksum is `digest`. Fails with
    /// [`FileError::Unusable`] for another kind of file, another tensor shape or type, and values
    /// that are not finite.
    pub fn parse(bytes: &[u8], file: &str, digest: Digest) -> Result<Self, FileError> {
        let tensors = SafeTensors::deserialize(bytes).map_err(|error| {
            let found = format!("no safetensors file ({error})");
            FileError::unexpected(file, found, "one tensor for each clip", HINT)
        })?;
        let clips = tensors
            .iter()
            .map(|(id, tensor)| Ok((id.to_owned(), rows(id, &tensor, file)?)))
            .collect::<Result<_, FileError>>()?;
        let captions = SafeTensors::read_metadata(bytes).ok();
        let captions = captions.and_then(|(_, metadata)| metadata.metadata().clone());
        Ok(Self {
            clips,
            captions: captions.unwrap_or_default(),
            file: file.to_owned(),
            digest,
        })
    }

    /// The embeddings of the captions of clip `id`. Fails with [`FileError::Unusable`] if
    /// embeddings are missing or do not match the captions.
    pub fn of(&self, id: &str, captions: &[&str]) -> Result<&[Arc<[f32]>], FileError> {
        let found = match self.clips.get(id) {
            Some(rows) if rows.len() == captions.len() => {
                let known = self.captions.get(id);
                match known.is_none_or(|known| *known == checksum(captions)) {
                    true => return Ok(rows),
                    false => "embeddings of other captions".to_owned(),
                }
            }
            Some(rows) => format!("{} rows", rows.len()),
            None => "no such tensor".to_owned(),
        };
        Err(FileError::unexpected(
            format!("{}, tensor `{id}`", self.file),
            found,
            format!(
                "{} rows, one for each line of texts/{id}.txt",
                captions.len()
            ),
            HINT,
        ))
    }
}

/// Reads one embedding by name: `FILE#KEY` for the first row of a tensor, `FILE#KEY:N` for row N.
/// Fails with [`FileError`] for an invalid name, an unreadable file, and a tensor that is not an
/// embedding.
pub fn read_embedding(name: &str) -> Result<Vec<f32>, FileError> {
    let expected = "FILE#KEY or FILE#KEY:N, with the key of a tensor and a row";
    let refused = |found: &str| FileError::unexpected(name, found, expected, HINT);
    let (path, key) = name.rsplit_once('#').ok_or_else(|| refused("no `#`"))?;
    let (key, row) = match key.rsplit_once(':') {
        Some((key, row)) => (key, row.parse().map_err(|_| refused("no row number"))?),
        None => (key, 0usize),
    };
    let bytes = read_file(path.as_ref(), MAX_TENSOR_BYTES);
    let bytes = bytes.map_err(FileError::read(path.as_ref()))?;
    let tensors = SafeTensors::deserialize(&bytes)
        .map_err(|error| refused(&format!("no safetensors file ({error})")))?;
    let tensor = tensors
        .tensor(key)
        .map_err(|_| refused(&format!("no tensor `{key}`")))?;
    let tensor = match *tensor.shape() {
        // The tensor is a single embedding.
        [TEXT_CHANNELS] => {
            let shape = vec![1, TEXT_CHANNELS];
            TensorView::new(tensor.dtype(), shape, tensor.data())
                .map_err(|error| refused(&error.to_string()))?
        }
        _ => tensor,
    };
    let rows = rows(key, &tensor, path)?;
    let found = rows.get(row).ok_or_else(|| {
        let found = format!("{} rows in `{key}`", rows.len());
        refused(&found)
    })?;
    Ok(found.to_vec())
}

fn rows(id: &str, tensor: &TensorView, file: &str) -> Result<Vec<Arc<[f32]>>, FileError> {
    let unexpected = |found: String, expected: &str| {
        FileError::unexpected(format!("{file}, tensor `{id}`"), found, expected, HINT)
    };
    let values = numbers(tensor)
        .ok_or_else(|| unexpected(format!("{:?} numbers", tensor.dtype()), "F32 or F16"))?;
    match *tensor.shape() {
        [_, TEXT_CHANNELS] => {}
        ref found => {
            let expected = format!("[captions, {TEXT_CHANNELS}]");
            return Err(unexpected(format!("shape {found:?}"), &expected));
        }
    }
    if let Some(place) = first_unusable(&values) {
        let (row, channel) = (place / TEXT_CHANNELS, place % TEXT_CHANNELS);
        let found = format!("{} in row {row}, channel {channel}", values[place]);
        return Err(unexpected(found, &allowed(values[place]).0));
    }
    let rows = values.chunks_exact(TEXT_CHANNELS);
    Ok(rows.map(Arc::from).collect())
}

/// The numbers of a tensor in single or half precision; `None` for other types.
pub(super) fn numbers(tensor: &TensorView) -> Option<Vec<f32>> {
    match tensor.dtype() {
        Dtype::F32 => Some(npy::numbers(tensor.data(), f32::from_le_bytes).collect()),
        Dtype::F16 => {
            let half = |bytes| f16::from_le_bytes(bytes).to_f32();
            Some(npy::numbers(tensor.data(), half).collect())
        }
        _ => None,
    }
}

/// Checksum of captions.
fn checksum(captions: &[&str]) -> String {
    Digest::of(captions.join("\n").as_bytes()).to_string()
}

/// Writes a file of embeddings atomically: `[texts, 512]` float32 under each name. `of` contains
/// the captions of the clips; readers reject the file if the captions change. Fails with
/// [`Error::Io`]. Panics for a repeated name or a row of another width.
pub fn write_embeddings(
    path: &Path,
    texts: Vec<(&str, Vec<&[f32]>)>,
    of: &[(&str, Vec<&str>)],
) -> Result<(), Error> {
    let of = of.iter();
    let of = of.map(|(id, captions)| ((*id).to_owned(), checksum(captions)));
    atomic::write(path, &serialize(texts.into_iter(), of.collect()))
}

/// The bytes of a file of embeddings: `[captions, 512]` float32 for each clip.
pub(super) fn serialize<'a>(
    clips: impl Iterator<Item = (&'a str, Vec<&'a [f32]>)>,
    captions: HashMap<String, String>,
) -> Vec<u8> {
    let clips: Vec<(&str, usize, Vec<u8>)> = clips
        .map(|(id, rows)| {
            let values = rows.iter().flat_map(|row| row.iter());
            let bytes = values.flat_map(|value| value.to_le_bytes()).collect();
            (id, rows.len(), bytes)
        })
        .collect();
    let views = clips.iter().map(|(id, captions, bytes)| {
        let shape = vec![*captions, TEXT_CHANNELS];
        let view = TensorView::new(Dtype::F32, shape, bytes);
        (*id, view.expect("so many bytes"))
    });
    let captions = (!captions.is_empty()).then_some(captions);
    safetensors::serialize(views, captions).expect("ids are unique")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(dtype: Dtype, shape: &[usize], bytes: &[u8]) -> Result<Embeddings, String> {
        let view = TensorView::new(dtype, shape.to_vec(), bytes).unwrap();
        let file = safetensors::serialize([("000021", view)], None).unwrap();
        Embeddings::parse(&file, "e.safetensors", Digest::of(&file)).map_err(|e| e.to_string())
    }

    #[test]
    fn rows_are_read_and_counted() {
        let rows = [[0.5f32; 512], [-2.0; 512]];
        let two = || [("a", vec![&rows[0][..], &rows[1]])].into_iter();
        let parsed =
            |bytes: &[u8]| Embeddings::parse(bytes, "e.safetensors", Digest::of(bytes)).unwrap();
        let read = parsed(&serialize(two(), HashMap::new()));
        assert_eq!(read.of("a", &["x", "y"]).unwrap()[1][..], rows[1]);
        // A file with checksums of the captions.
        let of = HashMap::from([("a".to_owned(), checksum(&["x", "y"]))]);
        let tied = parsed(&serialize(two(), of));
        assert!(tied.of("a", &["x", "y"]).is_ok());
        let message = tied.of("a", &["x", "z"]).unwrap_err().to_string();
        assert!(
            message.contains("embeddings of other captions"),
            "{message}"
        );
        let message = read.of("a", &["x", "y", "z"]).unwrap_err().to_string();
        assert_eq!(
            message,
            "e.safetensors, tensor `a`: found 2 rows, expected 3 rows, one for each line of \
             texts/a.txt"
        );
        let message = read.of("b", &["x"]).unwrap_err().to_string();
        assert!(message.contains("`b`: found no such tensor"), "{message}");
    }

    #[test]
    fn half_precision_is_understood() {
        let bytes: Vec<u8> = (0..512).flat_map(|_| 0x3800u16.to_le_bytes()).collect();
        let read = parse(Dtype::F16, &[1, 512], &bytes).unwrap();
        assert_eq!(read.of("000021", &["x"]).unwrap()[0][..], [0.5; 512]);
    }

    #[test]
    fn another_width_type_or_file_is_refused() {
        let message = parse(Dtype::F32, &[1, 768], &[0; 4 * 768]).unwrap_err();
        assert!(
            message.contains("tensor `000021`: found shape [1, 768], expected [captions, 512]"),
            "{message}"
        );
        let message = parse(Dtype::F64, &[1, 512], &[0; 8 * 512]).unwrap_err();
        assert!(message.contains("found F64 numbers, expected F32 or F16"));
        let mut bytes = vec![0; 4 * 512];
        bytes[40..44].copy_from_slice(&f32::NAN.to_le_bytes());
        let message = parse(Dtype::F32, &[1, 512], &bytes).unwrap_err();
        assert!(message.contains("NaN in row 0, channel 10"), "{message}");
        let message = Embeddings::parse(b"PK", "e.safetensors", Digest::of(b""));
        let message = message.unwrap_err().to_string();
        assert!(message.contains("found no safetensors file"), "{message}");
    }
}
