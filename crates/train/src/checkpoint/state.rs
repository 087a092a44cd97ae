use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

use kinegrad_data::Digest;
use kinegrad_data::file::{MAX_TEXT_BYTES, read_file};
use kinegrad_motion::{Representation, Statistics};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::Error;
use crate::config::{self, Config};

/// Block size for checksums, bytes.
const BLOCK: usize = 1 << 20;

/// Version of the checkpoint's layout.
pub const FORMAT: u32 = 1;

/// The state of the search for the best weights.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Progress {
    /// Step of the best validation so far.
    pub best_step: Option<u64>,
    /// Its loss.
    pub best_val_loss: Option<f64>,
    /// Score of the best validation, lower is better, if `validation.select_by` names a metric of
    /// samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_score: Option<f64>,
    /// Validations since then.
    pub validations_since_best: u64,
}

/// `best.json`: the step of the best validation, by `validation.select_by`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Best {
    /// Step of the best validation; its checkpoint is `step-XXXXXXXX`.
    pub step: u64,
    /// Its loss.
    pub val_loss: f64,
}

impl Progress {
    /// The best step, if a validation has run.
    pub fn best(&self) -> Option<Best> {
        Some(Best {
            step: self.best_step?,
            val_loss: self.best_val_loss?,
        })
    }
}

/// `state.json`: a checkpoint without its tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct State {
    /// Version of the layout, [`FORMAT`].
    pub format: u32,
    /// Version of kinegrad that wrote the checkpoint.
    pub kinegrad: String,
    /// Optimizer steps done.
    pub step: u64,
    /// Steps of an epoch, for a run whose length is in epochs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_per_epoch: Option<u64>,
    /// The resolved config of the run.
    #[serde(deserialize_with = "config::from_json")]
    pub config: Config,
    /// Normalization, clipping and checking bounds of the training phrases.
    pub statistics: Statistics,
    /// The statistics of the networks' channels, if different from `statistics`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network_statistics: Option<Statistics>,
    /// [`Digest`] of the training dataset, in hexadecimal; missing in old checkpoints.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dataset_sha256: Option<String>,
    /// The state of the search for the best weights.
    pub progress: Progress,
    /// SHA-256 of each file of the checkpoint, in hexadecimal.
    pub checksums: BTreeMap<String, String>,
}

/// Separates the state from the checksum of the text before it.
const SEAL: &str = ",\n  \"state_sha256\": \"";

impl State {
    /// The state for weights that were not trained here.
    pub fn untrained(config: Config, statistics: Statistics) -> Self {
        Self {
            format: FORMAT,
            kinegrad: env!("CARGO_PKG_VERSION").into(),
            step: 0,
            steps_per_epoch: None,
            config,
            statistics,
            network_statistics: None,
            dataset_sha256: None,
            progress: Progress::default(),
            checksums: BTreeMap::new(),
        }
    }

    /// The text of `state.json`; its last key is the checksum of everything before that key.
    pub(super) fn to_text(&self) -> String {
        let text = serde_json::to_string_pretty(self).expect("the state is plain data");
        sealed(text.strip_suffix("\n}").expect("the end of a JSON object"))
    }

    /// The statistics of the networks' channels.
    pub fn normalization(&self) -> &Statistics {
        self.network_statistics.as_ref().unwrap_or(&self.statistics)
    }

    /// The statistics, if they describe motion in this `representation`.
    ///
    /// # Errors
    /// [`Error::OtherRepresentation`].
    pub fn statistics_of(&self, representation: &dyn Representation) -> Result<&Statistics, Error> {
        match self.statistics.channels() == representation.stored_channels() {
            true => Ok(&self.statistics),
            false => Err(Error::OtherRepresentation {
                recipe: self.config.train.recipe.clone(),
                expected: representation.name(),
            }),
        }
    }

    /// The statistics, if they describe clips of the run's config.
    ///
    /// # Errors
    /// [`Error::OtherRepresentation`].
    pub fn clip_statistics(&self) -> Result<&Statistics, Error> {
        self.statistics_of(&self.config.data.humanml3d.representation())
    }

    /// Reads and verifies `state.json` of the checkpoint in `path`.
    ///
    /// # Errors
    /// If the file is missing, damaged, or of another layout.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let damaged = |reason: String| Error::CheckpointDamaged {
            path: path.to_path_buf(),
            reason,
        };
        log::debug!("reading {}", path.join("state.json").display());
        let bytes = file_of(path, "state.json", |file| read_file(file, MAX_TEXT_BYTES))?;
        let text = String::from_utf8(bytes);
        let text = text.map_err(|error| damaged(format!("state.json: {error}")))?;
        let body = text.rfind(SEAL).map(|end| &text[..end]);
        let Some(body) = body.filter(|body| sealed(body) == text) else {
            return Err(damaged("state.json does not match its checksum".into()));
        };
        let other = |error| format!("state.json is of another version of kinegrad: {error}");
        let state: Self = serde_json::from_str(&format!("{body}\n}}"))
            .map_err(|error: serde_json::Error| damaged(other(error)))?;
        if state.format != FORMAT {
            let reason = format!("layout {} is not {FORMAT}, this version's", state.format);
            return Err(damaged(reason));
        }
        Ok(state)
    }
}

/// The text of `state.json` with this `body`.
fn sealed(body: &str) -> String {
    format!("{body}{SEAL}{}\"\n}}\n", Digest::of(body.as_bytes()))
}

/// The result of `read` for one file of the checkpoint in `path`.
pub(super) fn file_of<T>(
    path: &Path,
    file: &str,
    read: impl FnOnce(&Path) -> io::Result<T>,
) -> Result<T, Error> {
    let full = path.join(file);
    read(&full).map_err(|error| match error.kind() {
        ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::FileTooLarge => {
            Error::CheckpointDamaged {
                path: path.to_path_buf(),
                reason: format!("{file}: {error}"),
            }
        }
        _ => Error::io("read", &full)(error),
    })
}

/// SHA-256 of a reader, in hexadecimal.
pub(super) fn sha256_of(source: &mut impl Read) -> io::Result<String> {
    let mut hash = Sha256::new();
    let mut block = vec![0; BLOCK];
    loop {
        match source.read(&mut block)? {
            0 => break,
            read => hash.update(&block[..read]),
        }
    }
    let bytes = hash.finalize();
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}
