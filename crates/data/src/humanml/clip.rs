//! One clip: features and captions, read from the layout of HumanML3D.

use std::borrow::Cow;
use std::path::Path;

use kinegrad_motion::JointFeatures;
use kinegrad_motion::humanml::{Features, Root, Skeleton, TEXT_CHANNELS};
use kinegrad_motion::metrics::text_motion::Token;
use kinegrad_settings::counted;

use crate::files::Files;
use crate::item_store::{ItemSource, ReadItem, ReadRequest};
use crate::listing::Expected;
use crate::magnitude::first_unusable;
use crate::{Error, FileError, Item, ItemSet, StoreError, atomic, npy};

use super::config::SkeletonName;
use super::embeddings::Embeddings;
use super::texts::{self, texts_path};
use super::{Caption, parse_captions};

/// Folder of all features; its files are `ID.npy`.
pub const FEATURES: &str = "new_joint_vecs";

/// Clips in the order of their ids. A clone shares the clips.
pub type ClipSet = ItemSet<Clip>;

/// A clip: features `[frames, channels]` and captions.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// Name of its files.
    pub id: String,
    /// Features with relative root, as stored.
    pub features: Features,
    /// Captions in order. Captions of ranges shorter than `data.humanml3d.min_frames` are left out.
    pub captions: Vec<Caption>,
}

impl Clip {
    /// The first caption of the whole clip or, without one, the first caption of a range.
    pub fn caption(&self) -> Option<&Caption> {
        let whole = self
            .captions
            .iter()
            .find(|caption| caption.seconds.is_none());
        whole.or(self.captions.first())
    }

    /// Drops captions of ranges of fewer than `min_frames` frames and returns their number.
    pub(super) fn drop_short_captions(&mut self, fps: f64, min_frames: usize) -> usize {
        let (before, frames) = (self.captions.len(), self.features.frames());
        let usable = |caption: &Caption| caption.frames(frames, fps).len() >= min_frames;
        self.captions.retain(usable);
        before - self.captions.len()
    }
}

impl Item for Clip {
    const KIND: &'static str = "clip";

    type Representation = JointFeatures;

    fn id(&self) -> &str {
        &self.id
    }

    fn frames(&self) -> usize {
        self.features.frames()
    }

    fn bytes(&self) -> usize {
        let token = |token: &Token| size_of_val(token) + token.word.len();
        let texts = self
            .captions
            .iter()
            .map(|caption| caption.text.len() + caption.tokens.iter().map(token).sum::<usize>());
        let captions = texts.sum::<usize>() + size_of_val(&self.captions[..]);
        size_of_val(self) + self.id.len() + 4 * self.features.as_slice().len() + captions
    }

    fn rows(&self, representation: &JointFeatures) -> Cow<'_, [f32]> {
        match self.features.root() == representation.root {
            true => Cow::Borrowed(self.features.as_slice()),
            false => Cow::Owned(self.features.with_root(representation.root).into_vec()),
        }
    }

    fn counts(&self) -> Vec<(&'static str, usize)> {
        let count = |has: fn(&&Caption) -> bool| self.captions.iter().filter(has).count();
        let without = usize::from(self.captions.is_empty());
        vec![
            ("captions", self.captions.len()),
            (
                "captions of ranges",
                count(|caption| caption.seconds.is_some()),
            ),
            (
                "captions with an embedding",
                count(|caption| caption.embedding.is_some()),
            ),
            ("clips without captions", without),
        ]
    }
}

/// Path of the features of clip `id` in its dataset.
pub fn features_path(id: &str) -> String {
    format!("{FEATURES}/{id}.npy")
}

/// Parses a `.npy` file of features with relative root, `[frames, channels]` of `skeleton`, in
/// meters or (KIT-ML) millimeters; `file` names the file in errors. Fails with [`FileError`] for
/// another array or number of channels, and for values that are not finite.
pub fn parse_features(
    bytes: &[u8],
    file: &str,
    skeleton: &Skeleton,
) -> Result<Features, FileError> {
    let layout = skeleton.layout();
    let array = npy::parse(bytes, file)?;
    let channels = check_width(&array.shape, 2, file, skeleton)?;
    if let Some(place) = first_unusable(&array.values) {
        let (frame, channel) = (place / channels, place % channels);
        let channel = layout.channel_name(channel);
        return Err(FileError::not_usable(
            file,
            frame,
            channel,
            array.values[place],
        ));
    }
    let rows = layout.in_metres(array.values);
    Features::new(rows, layout, Root::Relative).map_err(|error| {
        FileError::unexpected(
            file,
            error.to_string(),
            format!("features [frames, {channels}]"),
            "write the array again from the joints",
        )
    })
}

/// The width of a non-empty array of `axes` axes, if the skeleton's features have this width.
pub(super) fn check_width(
    shape: &[usize],
    axes: usize,
    file: &str,
    skeleton: &Skeleton,
) -> Result<usize, FileError> {
    let channels = skeleton.layout().channels();
    let name = &skeleton.description().name;
    let expected = format!("{channels}, the features of the skeleton `{name}`");
    let usual = "data.humanml3d.skeleton names the skeleton: \"humanml3d\" has 263 channels, \
                 \"kit\" 251";
    match *shape {
        [.., found] if shape.len() == axes && found == channels && !shape.contains(&0) => {
            Ok(channels)
        }
        [.., found] if shape.len() == axes && found != channels => {
            let hint = match SkeletonName::of_channels(found) {
                Some(other) => {
                    format!("{found} channels are those of data.humanml3d.skeleton = \"{other}\"")
                }
                None => usual.to_owned(),
            };
            let found = counted(found, "channel");
            Err(FileError::unexpected(file, found, expected, hint))
        }
        _ => Err(FileError::unexpected(
            file,
            format!("shape {shape:?}"),
            match axes {
                1 => format!("[{channels}]"),
                _ => format!("[frames, {channels}]"),
            },
            usual,
        )),
    }
}

/// Writes `features` as `[frames, channels]` little-endian float32, atomically. Fails with
/// [`Error::Io`].
pub fn write_features(path: &Path, features: &Features) -> Result<(), Error> {
    atomic::write(path, &features_bytes(features))
}

/// The bytes of the `.npy` file of `features`, `[frames, channels]`.
pub fn features_bytes(features: &Features) -> Vec<u8> {
    let shape = [features.frames(), features.layout().channels()];
    npy::array_bytes(&shape, features.as_slice())
}

/// Clips of a dataset in the layout of HumanML3D.
#[derive(Debug)]
pub(super) struct ClipFiles {
    pub files: Files,
    pub skeleton: Skeleton,
    /// None if the model is not conditioned on text.
    pub embeddings: Option<Embeddings>,
    pub captions_required: bool,
    pub min_frames: usize,
    pub max_frames: usize,
    /// Checksums of the statistics files.
    pub fingerprint: String,
}

impl ClipFiles {
    /// Captions with their embeddings, and the checksum of an existing caption file.
    fn captions(
        &self,
        id: &str,
        expected: &Expected,
        recorded: &'static str,
    ) -> Result<(Vec<Caption>, Option<crate::Digest>), FileError> {
        let path = texts_path(id);
        let name = self.files.store.name_of(&path);
        let read = self.files.read(&path, expected, texts::MAX_BYTES, recorded);
        let (mut captions, digest) = match (read, expected) {
            (Ok((bytes, digest)), _) => (parse_captions(&bytes, &name)?, Some(digest)),
            (Err(StoreError::Missing(_)), Expected::Version(_)) => (Vec::new(), None),
            (Err(error), _) => return Err(error.into()),
        };
        if captions.is_empty() && self.captions_required {
            return Err(FileError::unexpected(
                name,
                digest.map_or("no such file", |_| "no caption"),
                "a caption a line",
                "data.humanml3d.captions = \"optional\" takes clips without captions",
            ));
        }
        if let Some(embeddings) = self.embeddings.as_ref().filter(|_| !captions.is_empty()) {
            let texts: Vec<&str> = captions
                .iter()
                .map(|caption| caption.text.as_str())
                .collect();
            let rows = embeddings.of(id, &texts)?;
            for (caption, row) in captions.iter_mut().zip(rows) {
                caption.embedding = Some(row.clone());
            }
        }
        Ok((captions, digest))
    }
}

impl ItemSource<Clip> for ClipFiles {
    fn read(&self, request: ReadRequest<'_>) -> Result<ReadItem<Clip>, FileError> {
        let ReadRequest { id, recorded, .. } = request;
        let [features, captions @ ..] = request.expected else {
            unreachable!("a clip has a file of features");
        };
        let path = features_path(id);
        let name = self.files.store.name_of(&path);
        let limit = npy::max_bytes(self.skeleton.layout().channels());
        let (bytes, digest) = self.files.read(&path, features, limit, recorded)?;
        let mut clip = Clip {
            id: id.to_owned(),
            features: parse_features(&bytes, &name, &self.skeleton)?,
            captions: Vec::new(),
        };
        let frames = clip.features.frames();
        let reason = match frames {
            _ if frames < self.min_frames => Some("too short"),
            _ if frames >= self.max_frames => Some("too long"),
            _ => None,
        };
        if let Some(reason) = reason {
            return Ok(ReadItem {
                left_out: Some(format!("{reason}: {}", counted(frames, "frame"))),
                ..ReadItem::of(clip)
            });
        }
        let mut content = vec![digest];
        let mut note = None;
        let mut left_out = None;
        if let Some(expected) = captions.first() {
            let (captions, digest) = self.captions(id, expected, recorded)?;
            content.extend(digest);
            clip.captions = captions;
            let fps = self.skeleton.description().fps;
            let lost = clip.drop_short_captions(fps, self.min_frames);
            note = (lost > 0).then(|| {
                let min_frames = self.min_frames;
                let captions = counted(lost, "caption");
                format!("{captions} of ranges of fewer than {min_frames} frames")
            });
            if self.captions_required && clip.captions.is_empty() {
                left_out = note.take();
            }
        }
        Ok(ReadItem {
            note,
            left_out,
            content,
            ..ReadItem::of(clip)
        })
    }

    fn files(&self) -> Option<&Files> {
        Some(&self.files)
    }

    fn fingerprint(&self) -> String {
        let embeddings = self
            .embeddings
            .as_ref()
            .map(|table| table.digest.to_string());
        format!("{}{}", embeddings.unwrap_or_default(), self.fingerprint)
    }
}

/// The embedding of a clip or caption that has no embedding.
pub(super) const NO_EMBEDDING: [f32; TEXT_CHANNELS] = [0.0; TEXT_CHANNELS];
