//! The word vectors of the text-motion evaluator: one safetensors file.

use std::path::Path;

use kinegrad_motion::metrics::text_motion::WordVectors;
use safetensors::SafeTensors;

use super::embeddings::numbers;
use crate::FileError;
use crate::file::{MAX_TENSOR_BYTES, read_file};

/// Name of the tensor of vectors, `[words, width]`.
const TENSOR: &str = "vectors";

/// Metadata entry with the words, a JSON list.
const WORDS: &str = "words";

const HINT: &str = "docs/dataset.md shows how to make the file of the published vectors";

/// Reads a file of word vectors: a tensor `vectors`, `[words, width]` in single or half precision,
/// and a metadata entry `words`, a JSON list of the same length. Fails with [`FileError::Unusable`]
/// for another kind of file, repeated words, values that are not finite, and a missing word `unk`.
pub fn read_word_vectors(path: &Path) -> Result<WordVectors, FileError> {
    let bytes = read_file(path, MAX_TENSOR_BYTES).map_err(FileError::read(path))?;
    parse_word_vectors(&bytes, &path.display().to_string())
}

/// Parses the bytes of a file of word vectors; `file` names the file in errors. Fails as
/// [`read_word_vectors`].
pub fn parse_word_vectors(bytes: &[u8], file: &str) -> Result<WordVectors, FileError> {
    let unexpected = |found: String, expected: &str| {
        FileError::unexpected(file.to_owned(), found, expected, HINT)
    };
    let unreadable = |error| {
        let found = format!("no safetensors file ({error})");
        unexpected(found, "a tensor `vectors` and the metadata entry `words`")
    };
    let tensors = SafeTensors::deserialize(bytes).map_err(unreadable)?;
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(unreadable)?;
    let words = metadata.metadata().as_ref().and_then(|m| m.get(WORDS));
    let list = "a JSON list of words in the metadata entry `words`";
    let words = words.ok_or_else(|| unexpected("no such entry".into(), list))?;
    let words: Vec<String> =
        serde_json::from_str(words).map_err(|error| unexpected(format!("`{error}`"), list))?;
    let shape = format!("a tensor `{TENSOR}`, [{}, width]", words.len());
    let tensor = tensors.tensor(TENSOR).map_err(|_| {
        let names = tensors.names().join("`, `");
        unexpected(format!("`{names}`"), &shape)
    })?;
    if !matches!(*tensor.shape(), [rows, _] if rows == words.len()) {
        return Err(unexpected(format!("shape {:?}", tensor.shape()), &shape));
    }
    let values = numbers(&tensor)
        .ok_or_else(|| unexpected(format!("{:?} numbers", tensor.dtype()), "F32 or F16"))?;
    WordVectors::new(words, values).map_err(|error| unexpected(error.found, error.expected))
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use safetensors::Dtype;
    use safetensors::tensor::TensorView;

    use super::*;

    /// A file with this tensor and metadata entry.
    fn file(dtype: Dtype, shape: &[usize], entry: (&str, &str)) -> Vec<u8> {
        let size = dtype.bitsize() / 8;
        let count: usize = shape.iter().product();
        let values = (0..count).flat_map(|i| match dtype {
            Dtype::F32 => (i as f32).to_le_bytes().to_vec(),
            _ => vec![0; size],
        });
        let values: Vec<u8> = values.collect();
        let view = TensorView::new(dtype, shape.to_vec(), &values).unwrap();
        let metadata = HashMap::from([(entry.0.to_owned(), entry.1.to_owned())]);
        safetensors::serialize([("vectors", view)], Some(metadata)).unwrap()
    }

    #[test]
    fn each_word_has_its_row() {
        let words = ("words", "[\"the\", \"unk\", \"walk\"]");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("word_vectors.safetensors");
        std::fs::write(&path, file(Dtype::F32, &[3, 2], words)).unwrap();
        let vectors = read_word_vectors(&path).unwrap();
        assert_eq!(vectors.width(), 2);
        assert_eq!(vectors.vector("walk").as_deref(), Some(&[4.0, 5.0][..]));
        assert_eq!(vectors.vector("run"), None);
        let half = file(Dtype::F16, &[3, 2], words);
        let half = parse_word_vectors(&half, "w.safetensors").unwrap();
        assert_eq!(half.vector("the").as_deref(), Some(&[0.0, 0.0][..]));
        let missing = read_word_vectors(&folder.path().join("none")).unwrap_err();
        assert!(missing.to_string().contains("cannot be read"));
    }

    #[test]
    fn problems_are_named() {
        let three = "[\"the\", \"unk\", \"walk\"]";
        let f32 = |shape: &[usize], entry| file(Dtype::F32, shape, entry);
        for (bytes, found) in [
            (b"{}".to_vec(), "found no safetensors file"),
            (f32(&[3, 2], ("Words", three)), "found no such entry"),
            (f32(&[3, 2], ("words", "the unk")), "expected a JSON list"),
            (f32(&[2, 2], ("words", three)), "found shape [2, 2]"),
            (f32(&[3], ("words", three)), "`vectors`, [3, width]"),
            (
                f32(&[2, 2], ("words", "[\"a\", \"b\"]")),
                "found no word `unk`",
            ),
            (
                file(Dtype::I32, &[3, 2], ("words", three)),
                "found I32 numbers, expected F32 or F16",
            ),
        ] {
            let error = parse_word_vectors(&bytes, "w.safetensors").unwrap_err();
            let message = error.to_string();
            assert!(message.starts_with("w.safetensors: "), "{message}");
            assert!(message.contains(found), "{message}");
        }
        let view = TensorView::new(Dtype::F32, vec![1], &[0; 4]).unwrap();
        let metadata = HashMap::from([("words".to_owned(), three.to_owned())]);
        let bytes = safetensors::serialize([("glove", view)], Some(metadata)).unwrap();
        let error = parse_word_vectors(&bytes, "w.safetensors").unwrap_err();
        assert!(error.to_string().contains("found `glove`"), "{error}");
    }
}
