//! CLIP's text encoder, read from a local folder, for models of clips.

mod tokenizer;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use kinegrad_data::file::{MAX_TENSOR_BYTES, read_file, read_text};
use kinegrad_models::Initializer;
use kinegrad_models::parameters::ParameterInfo;
use kinegrad_models::text_encoder::{ClipTextConfig, ClipTextModel};
use kinegrad_motion::humanml::TEXT_CHANNELS;
use pytorch_reader::DType;
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;

use crate::error::Error;
use crate::published::{load_values, read_tensors, singles, values_of};
use tokenizer::Tokenizer;

/// Largest number of word tokens of a text, without start and end, as in the published trainings on
/// HumanML3D and KIT-ML (docs/sources.md, section 4.3).
pub const MAX_WORD_TOKENS: usize = 20;

/// Batch size of texts.
const GROUP: usize = 64;

/// CLIP's text encoder.
pub struct TextEncoder {
    network: ClipTextModel,
    tokenizer: Tokenizer,
    device: Device,
}

impl TextEncoder {
    /// Reads the encoder in `folder` onto `device`, which has no gradients. The folder has the
    /// layout of the model hub: `config.json`, `model.safetensors` (or `pytorch_model.bin`), and
    /// `vocab.json` with `merges.txt`, or `tokenizer.json`.
    ///
    /// # Errors
    /// [`Error::TextEncoder`] and [`Error::ForeignWeights`] for missing files or weights of another
    /// network.
    pub fn read(folder: &Path, device: &Device) -> Result<Self, Error> {
        if !folder.is_dir() {
            let reason = match folder.exists() {
                true => "it is a file, a folder is needed",
                false => "there is no such folder",
            };
            return Err(refused(folder, reason));
        }
        let path = folder.join("config.json");
        let mut config = config_of(&path)?;
        let tokenizer = Tokenizer::read(folder, config.vocab_size)?;
        let weights = Weights::read(folder)?;
        let projection = weights.infos.iter().find(|info| info.name == PROJECTION);
        if let Some(&width) = projection.and_then(|info| info.shape.first()) {
            config.projection_dim = width;
        }
        if config.projection_dim != TEXT_CHANNELS {
            let found = config.projection_dim;
            let reason = format!(
                "its embeddings have {found} values, {TEXT_CHANNELS} are needed: those of ViT-B/32"
            );
            return Err(refused(folder, reason));
        }
        let least = MAX_WORD_TOKENS + 2;
        if config.max_position_embeddings < least {
            let found = config.max_position_embeddings;
            let reason = format!("texts of at most {found} tokens found, {least} needed");
            return Err(refused(&path, reason));
        }
        let network = config.init(&Initializer::new(0, device));
        let network = network.map_err(|error| refused(&path, error))?;
        Ok(Self {
            network: load_values(&weights.path, network, &weights.infos, weights.values)?,
            tokenizer,
            device: device.clone(),
        })
    }

    /// The tokens of a text: start, at most [`MAX_WORD_TOKENS`] words, end.
    ///
    /// # Errors
    /// [`Error::Usage`] for a text that is too long to be a sentence.
    pub fn tokens(&self, text: &str) -> Result<Vec<u16>, Error> {
        self.tokenizer.tokens(text, MAX_WORD_TOKENS)
    }

    /// The embeddings of `texts`, 512 values each, not normalized. `progress` gets the number of
    /// finished texts.
    ///
    /// # Errors
    /// As [`tokens`](Self::tokens), and [`Error::Interrupted`] if `progress` requests a stop.
    pub fn embed(
        &self,
        texts: &[&str],
        progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
    ) -> Result<Vec<Vec<f32>>, Error> {
        let tokens = texts.iter().map(|text| self.tokens(text));
        let tokens: Vec<Vec<u16>> = tokens.collect::<Result<_, _>>()?;
        // Batches of equal lengths need no padding.
        let mut order: Vec<usize> = (0..texts.len()).collect();
        order.sort_by_key(|&index| tokens[index].len());
        let mut embeddings = vec![Vec::new(); texts.len()];
        for (number, group) in order.chunks(GROUP).enumerate() {
            let batch: Vec<&[u16]> = group.iter().map(|&index| &tokens[index][..]).collect();
            let output = self.network.forward(&batch, &self.device);
            let values = output.try_into_vec_as::<f32>();
            let values = values.expect("embeddings are float32");
            for (&index, row) in group.iter().zip(values.chunks(TEXT_CHANNELS)) {
                embeddings[index] = row.to_vec();
            }
            if progress(number * GROUP + group.len()).is_break() {
                return Err(Error::Interrupted);
            }
        }
        Ok(embeddings)
    }
}

fn refused(path: &Path, reason: impl std::fmt::Display) -> Error {
    Error::TextEncoder {
        path: path.to_path_buf(),
        reason: reason.to_string(),
    }
}

/// The settings in a `config.json` of a text encoder, with or without a vision encoder.
fn config_of(path: &Path) -> Result<ClipTextConfig, Error> {
    let all = json_of(path)?;
    let text = all.get("text_config").unwrap_or(&all);
    let kind = text.get("model_type").and_then(Value::as_str);
    if let Some(kind) = kind.filter(|kind| !kind.starts_with("clip")) {
        return Err(refused(
            path,
            format!("a model of type `{kind}` found, CLIP needed"),
        ));
    }
    let mut config: ClipTextConfig = serde_json::from_value(text.clone())
        .map_err(|error| refused(path, format!("the text encoder's settings: {error}")))?;
    // A value at the top level takes precedence.
    if let Some(width) = all.get("projection_dim").and_then(Value::as_u64) {
        config.projection_dim = usize::try_from(width).unwrap_or(usize::MAX);
    }
    config.validate().map_err(|error| refused(path, error))?;
    Ok(config)
}

/// A JSON file.
fn json_of(path: &Path) -> Result<Value, Error> {
    let text = read_text(path).map_err(|error| refused(path, error))?;
    serde_json::from_str(&text).map_err(|error| refused(path, format!("not JSON: {error}")))
}

/// Reads the numbers of a tensor by its name.
type ReadTensor = Box<dyn Fn(&str) -> Result<Vec<f32>, String>>;

/// The weights of the text encoder in a file.
struct Weights {
    path: PathBuf,
    infos: Vec<ParameterInfo>,
    values: ReadTensor,
}

/// The text projection, whose first axis is the embedding's width.
const PROJECTION: &str = "text_projection.weight";

/// True for a weight of the text encoder, except the table of positions.
fn is_weight(name: &str) -> bool {
    name == PROJECTION || (name.starts_with("text_model.") && !name.ends_with(".position_ids"))
}

impl Weights {
    fn read(folder: &Path) -> Result<Self, Error> {
        let (safe, pickled) = ("model.safetensors", "pytorch_model.bin");
        let info = |(name, shape): (&str, &[usize])| ParameterInfo {
            name: name.to_owned(),
            shape: shape.to_vec(),
        };
        let path = folder.join(safe);
        if path.exists() {
            let bytes = read_file(&path, MAX_TENSOR_BYTES);
            let bytes = bytes.map_err(|error| refused(&path, error))?;
            let tensors = SafeTensors::deserialize(&bytes);
            let tensors = tensors
                .map_err(|error| refused(&path, format!("no safetensors file ({error})")))?;
            let own = tensors.iter().filter(|(name, _)| is_weight(name));
            let own = own.map(|(name, tensor)| info((name, tensor.shape())));
            return Ok(Self {
                infos: own.collect(),
                path,
                values: Box::new(move |name| {
                    let tensors = SafeTensors::deserialize(&bytes).expect("deserialised before");
                    let tensor = tensors.tensor(name).map_err(|error| error.to_string())?;
                    singles(tensor.data(), dtype_of(tensor.dtype())?)
                }),
            });
        }
        let path = folder.join(pickled);
        if !path.exists() {
            return Err(refused(folder, format!("it has no {safe}")));
        }
        let mut tensors = read_tensors(&path)?;
        tensors.retain(|name, _| is_weight(name));
        let own = tensors.iter();
        let own = own.map(|(name, tensor)| info((name, tensor.shape())));
        Ok(Self {
            infos: own.collect(),
            path,
            values: Box::new(move |name| values_of(&tensors[name])),
        })
    }
}

fn dtype_of(dtype: Dtype) -> Result<DType, String> {
    Ok(match dtype {
        Dtype::F64 => DType::F64,
        Dtype::F32 => DType::F32,
        Dtype::F16 => DType::F16,
        Dtype::BF16 => DType::BF16,
        other => return Err(format!("{other:?} found, a floating-point type needed")),
    })
}

#[cfg(test)]
mod tests;
