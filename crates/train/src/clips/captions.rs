//! The text condition of a clip model: an embedding, or the index of a learned caption.

use std::ops::ControlFlow;
use std::sync::Arc;

use crate::error::Error;
use crate::observer::Observer;
use crate::run::RunContext;
use crate::sampling::{Condition, Request};
use crate::text_encoder::TextEncoder;
use burn::tensor::Device;
use kinegrad_data::humanml::{
    CaptionLabels, CaptionText, Clip, ClipSet, MAX_CAPTIONS, read_embedding,
};
use kinegrad_data::{DataConfig, Dataset};
use kinegrad_motion::humanml::TEXT_CHANNELS;
use kinegrad_settings::{InvalidSetting, Refused, counted, in_range, nearest, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Maximum number of captions that an error lists.
const LISTED: usize = 40;

/// The table `text`: the captions that a model knows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CaptionsConfig {
    /// The captions of `data.humanml3d.text = "labels"`. The model learns one embedding per
    /// caption. An empty list stands for the captions of the training clips, which the saved config
    /// and the checkpoints then list.
    pub captions: Vec<String>,
}

impl CaptionsConfig {
    /// # Errors
    /// Names the invalid key.
    pub fn validate(&self, data: &DataConfig) -> Result<(), InvalidSetting> {
        let key = "text.captions";
        let count = self.captions.len();
        require(
            count == 0 || data.humanml3d.text == CaptionText::Labels,
            key,
            counted(count, "caption"),
            "nothing with `data.humanml3d.text = \"embeddings\"`",
        )
        .hint(
            "`data.humanml3d.text = \"labels\"` learns an embedding of each caption; so does what \
             starts from such a run (`init.diffusion`)",
        )?;
        in_range(key, count, 0..=MAX_CAPTIONS)?;
        let mut sorted: Vec<&str> = self.captions.iter().map(String::as_str).collect();
        sorted.sort_unstable();
        if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            let found = format!("\"{}\" twice", pair[0]);
            return Err(InvalidSetting::new(key, found, "each caption once"));
        }
        let odd = |text: &&&str| text.trim() != **text || text.is_empty();
        sorted.iter().find(odd).map_or(Ok(()), |odd| {
            let allowed = "captions without spaces around them";
            Err(InvalidSetting::new(key, format!("\"{odd}\""), allowed))
        })
    }
}

/// The prompt of a clip. Each model takes the form that it supports.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClipText {
    /// The sentence.
    pub caption: Option<String>,
    /// Its embedding, 512 values.
    pub embedding: Option<Vec<f32>>,
}

impl ClipText {
    /// The caption of a clip ([`Clip::caption`]).
    pub fn of(clip: &Clip) -> Option<Self> {
        let caption = clip.caption()?;
        Some(Self {
            caption: Some(caption.text.clone()),
            embedding: caption.embedding.as_deref().map(<[f32]>::to_vec),
        })
    }
}

/// The form of a run's text condition.
#[derive(Clone, Debug)]
pub enum TextInput {
    /// A text embedding.
    Embedding,
    /// One of the learned captions.
    Labels(CaptionLabels),
}

impl TextInput {
    /// The text input of a model with this table `text`.
    pub fn new(text: &CaptionsConfig, data: &DataConfig) -> Self {
        match data.humanml3d.text {
            CaptionText::Embeddings => Self::Embedding,
            CaptionText::Labels => Self::Labels(CaptionLabels::new(text.captions.clone())),
        }
    }

    /// Number of values per text.
    pub fn channels(&self) -> usize {
        match self {
            Self::Embedding => TEXT_CHANNELS,
            Self::Labels(labels) => labels.captions().len(),
        }
    }

    /// The known captions; `None` for a model that takes any sentence.
    pub fn labels(&self) -> Option<&CaptionLabels> {
        match self {
            Self::Embedding => None,
            Self::Labels(labels) => Some(labels),
        }
    }

    /// The condition for `text`; `None` without an embedding.
    ///
    /// # Errors
    /// [`Error::Usage`] for an unknown caption, and for an embedding without its caption.
    pub fn values(&self, text: &ClipText) -> Result<Option<Vec<f32>>, Error> {
        let labels = match self {
            Self::Embedding => return Ok(text.embedding.clone()),
            Self::Labels(labels) => labels,
        };
        let Some(caption) = &text.caption else {
            return Err(Error::usage(
                "an embedding, for a run with `data.humanml3d.text = \"labels\"`",
                format!(
                    "name a caption with option `text`: the run knows {}",
                    listed(labels.captions())
                ),
            ));
        };
        match labels.row_of_typed(caption) {
            Some(row) => Ok(Some(labels.values(Some(row)))),
            None => Err(unknown(caption, labels.captions())),
        }
    }

    /// The condition for `text`, or zeros.
    ///
    /// # Errors
    /// As [`values`](Self::values).
    pub fn values_or_zeros(&self, text: Option<&ClipText>) -> Result<Vec<f32>, Error> {
        let values = text.map(|text| self.values(text)).transpose()?.flatten();
        Ok(values.unwrap_or_else(|| vec![0.0; self.channels()]))
    }
}

/// Rejects clips whose captions a model with this `input` does not know.
///
/// # Errors
/// [`Error::Usage`] with the first rejected clip and the known captions.
pub fn must_know_texts(input: &TextInput, clips: &[Arc<Clip>]) -> Result<(), Error> {
    for clip in clips {
        if let Some(text) = ClipText::of(clip) {
            input.values(&text).map_err(|error| match error {
                Error::Usage { message, hint } => {
                    Error::usage(format!("clip `{}`: {message}", clip.id), hint)
                }
                other => other,
            })?;
        }
    }
    Ok(())
}

/// The error for an unknown caption.
fn unknown(caption: &str, known: &[String]) -> Error {
    let names: Vec<&str> = known.iter().map(String::as_str).collect();
    let meant = nearest(caption, &names).map(|near| format!("did you mean `{near}`? "));
    Error::usage(
        format!("`{caption}` is not a caption of the run"),
        format!(
            "{}it was trained with `data.humanml3d.text = \"labels\"` and knows {}",
            meant.unwrap_or_default(),
            listed(known)
        ),
    )
}

fn listed(captions: &[String]) -> String {
    let quoted = captions.iter().take(LISTED).map(|text| format!("`{text}`"));
    let mut text = quoted.collect::<Vec<_>>().join(", ");
    if captions.len() > LISTED {
        let more = captions.len() - LISTED;
        text += &format!(" and {more} more: `text.captions` in the run's config.toml");
    }
    text
}

/// The text of a request, in the form that models with these `inputs` support.
///
/// # Errors
/// [`Error::Usage`] for an unknown text, or a missing or superfluous encoder. Fails if a file
/// cannot be read.
pub fn text_of(
    request: &Request,
    inputs: &[TextInput],
    device: &Device,
) -> Result<Option<ClipText>, Error> {
    let mut text = ClipText::default();
    let condition = request.text_conditions().next();
    let mut encoder = None;
    match &condition {
        Some(Condition::Text {
            text: caption,
            text_encoder,
        }) => {
            text.caption = Some(caption.clone());
            encoder = text_encoder.as_deref();
        }
        Some(Condition::TextEmbedding(file)) => text.embedding = Some(read_embedding(file)?),
        _ => return Ok(None),
    }
    for input in inputs {
        // An unknown text is refused before a file is read.
        input.values(&text)?;
    }
    let embeds = inputs.iter().any(|input| input.labels().is_none());
    match (&text.caption, encoder) {
        (Some(caption), Some(folder)) if embeds => {
            let encoder = TextEncoder::read(folder, device)?;
            let mut embedded = encoder.embed(&[caption], &mut |_| ControlFlow::Continue(()))?;
            text.embedding = embedded.pop();
        }
        (Some(_), None) if embeds => {
            return Err(Error::usage(
                "option `text` without option `text_encoder`, and the run takes embeddings of texts",
                "name a folder with CLIP ViT-B/32 (option `text_encoder`), or pass an embedding of \
                 the text (option `text_embedding`): docs/gmd.md",
            ));
        }
        (_, Some(_)) => {
            return Err(Error::usage(
                "option `text_encoder` with a run with `data.humanml3d.text = \"labels\"`",
                "it needs no embedding of the text: leave the encoder out",
            ));
        }
        _ => {}
    }
    Ok(Some(text))
}

/// Fills the table `text` with the captions of the training clips if captions are labels and the
/// table lists no caption.
///
/// # Errors
/// If the number of captions is 0 or too large, or a clip has an unknown caption.
pub fn with_captions(
    mut text: CaptionsConfig,
    context: &RunContext,
    dataset: &Dataset<Clip>,
    observer: &mut dyn Observer,
) -> Result<CaptionsConfig, Error> {
    let (data, group) = (&context.config.data, &*context.group);
    if data.humanml3d.text != CaptionText::Labels {
        return Ok(text);
    }
    let found = |set: &ClipSet| set.captions_among(&*observer.reading(), group);
    let (train, held_out) = (found(&dataset.train)?, found(&dataset.validation)?);
    if text.captions.is_empty() {
        let count = train.len();
        require(
            (1..=MAX_CAPTIONS).contains(&count),
            "data.humanml3d.text",
            format!("\"labels\", and the training clips have {count} distinct captions"),
            format!("\"labels\" for 1 to {MAX_CAPTIONS} distinct captions"),
        )
        .hint("\"embeddings\" is for captions of any number: docs/dataset.md")?;
        text.captions = train.keys().cloned().collect();
        observer.note(&format!(
            "the model learns an embedding of each of {count} captions"
        ));
    }
    let known = CaptionLabels::new(text.captions.clone());
    for (captions, hint) in [
        (
            train,
            "the model starts with other captions: leave `init.diffusion` out, or give the clip one of \
             those",
        ),
        (
            held_out,
            "no training clip has it, so no embedding of it can be learned: hold out clips whose \
             captions are also those of clips in `data.humanml3d.train_list`",
        ),
    ] {
        if let Some((text, id)) = captions.iter().find(|(text, _)| known.row(text).is_none()) {
            let message =
                format!("clip `{id}` has the caption `{text}`, which the model does not know");
            return Err(Error::usage(message, hint));
        }
    }
    Ok(text)
}
