//! The `data.humanml3d` table of a training config.

use std::fmt;

use kinegrad_motion::JointFeatures;
use kinegrad_motion::humanml::{Root, Skeleton};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Reading of the clips of `kind = "humanml3d"` and `kind = "synthetic_walks"`.
///
/// The defaults are the values for HumanML3D; for KIT-ML, set `skeleton` and `min_frames = 24`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Humanml3dConfig {
    /// Representation of the root in batches.
    pub root: Root,
    /// Skeleton of the features.
    pub skeleton: SkeletonName,
    /// Frames per second of the clips. Omitted: the skeleton's, 20 or 12.5; BABEL has 30.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fps: Option<f64>,
    /// File in the dataset with the ids of the training clips, one per line.
    pub train_list: String,
    /// File with the ids of the held-out clips; empty for none.
    pub validation_list: String,
    /// File with the ids for the final evaluation (`evaluation.split = "test"`).
    pub test_list: String,
    /// Minimum frames of a clip or caption range; shorter ones are left out.
    pub min_frames: usize,
    /// Clips of this length or longer are left out.
    pub max_frames: usize,
    /// Sample lengths are multiples of this number.
    pub unit_frames: usize,
    /// Text condition of a model.
    pub text: CaptionText,
    /// File in the dataset with the caption embeddings; optional for models without text, ignored
    /// with `text = "labels"`.
    pub text_embeddings: String,
    /// Handling of clips without captions. By default, embeddings or caption labels require
    /// captions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub captions: Option<CaptionRule>,
}

impl Default for Humanml3dConfig {
    fn default() -> Self {
        Self {
            root: Root::Absolute,
            skeleton: SkeletonName::Humanml3d,
            fps: None,
            train_list: "train.txt".to_owned(),
            validation_list: "val.txt".to_owned(),
            test_list: "test.txt".to_owned(),
            min_frames: 40,
            max_frames: 200,
            unit_frames: 4,
            text: CaptionText::Embeddings,
            text_embeddings: "text_embeddings.safetensors".to_owned(),
            captions: None,
        }
    }
}

/// A built-in skeleton.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SkeletonName {
    /// The 22 joints of HumanML3D: 263 channels, 20 frames a second.
    Humanml3d,
    /// The 21 joints of KIT-ML: 251 channels, 12.5 frames a second.
    Kit,
}

impl SkeletonName {
    /// The skeleton.
    pub fn skeleton(self) -> Skeleton {
        match self {
            Self::Humanml3d => Skeleton::humanml3d(),
            Self::Kit => Skeleton::kit(),
        }
    }

    /// The name of a skeleton with these joints.
    pub fn of(skeleton: &Skeleton) -> Option<Self> {
        let names = |skeleton: &Skeleton| skeleton.description().joint_names.clone();
        [Self::Humanml3d, Self::Kit]
            .into_iter()
            .find(|name| names(&name.skeleton()) == names(skeleton))
    }

    /// The skeleton with this number of feature channels.
    pub fn of_channels(channels: usize) -> Option<Self> {
        [Self::Humanml3d, Self::Kit]
            .into_iter()
            .find(|name| name.skeleton().layout().channels() == channels)
    }
}

impl fmt::Display for SkeletonName {
    /// Its name in a config.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Text condition of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CaptionText {
    /// The text encoder's embedding, from the file `text_embeddings`: any sentence may be used.
    Embeddings,
    /// The index among the distinct captions, each with a learned embedding. Suits datasets with
    /// few captions; other sentences are not allowed.
    Labels,
}

/// Handling of a clip without captions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CaptionRule {
    /// A bad clip.
    Required,
    /// A clip without a condition.
    Optional,
}

impl Humanml3dConfig {
    /// The skeleton, at the rate of the clips.
    pub fn skeleton(&self) -> Skeleton {
        let skeleton = self.skeleton.skeleton();
        match self.fps {
            Some(fps) => skeleton.at_rate(fps),
            None => skeleton,
        }
    }

    /// Representation of the rows of a batch.
    pub fn representation(&self) -> JointFeatures {
        JointFeatures {
            skeleton: self.skeleton(),
            root: self.root,
        }
    }

    /// True if captions come with embeddings.
    pub(super) fn reads_embeddings(&self) -> bool {
        self.text == CaptionText::Embeddings && !self.text_embeddings.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_motion::Representation as _;

    use super::*;
    use crate::Error;
    use crate::{DataConfig, DataKind};

    fn clips() -> DataConfig {
        DataConfig {
            kind: DataKind::Humanml3d,
            source: Some("somewhere".into()),
            ..DataConfig::default()
        }
    }

    #[test]
    fn the_published_settings_are_the_defaults_and_survive_a_round_trip() {
        let text = "kind = \"humanml3d\"\nsource = \"x\"\ntarget_frames = 196\n\
                    [humanml3d]\nroot = \"relative\"\nskeleton = \"kit\"\ncaptions = \"optional\"";
        let config: DataConfig = toml::from_str(text).unwrap();
        config.validate().unwrap();
        let expected = Humanml3dConfig {
            root: Root::Relative,
            skeleton: SkeletonName::Kit,
            captions: Some(CaptionRule::Optional),
            ..Humanml3dConfig::default()
        };
        assert_eq!(config.humanml3d, expected);
        assert_eq!(
            toml::from_str::<DataConfig>(&toml::to_string(&config).unwrap()).unwrap(),
            config
        );
        assert!(toml::from_str::<DataConfig>("humanml3d.roots = \"absolute\"").is_err());
        assert_eq!(Humanml3dConfig::default().root, Root::Absolute);
        let walks: DataConfig = toml::from_str("kind = \"synthetic_walks\"").unwrap();
        walks.validate().unwrap();
    }

    #[test]
    fn clips_have_a_rate_of_their_own() {
        let rate = |text: &str| {
            let config: Humanml3dConfig = toml::from_str(text).unwrap();
            (
                config.skeleton().description().fps,
                config.representation().fps(),
            )
        };
        assert_eq!(rate(""), (20.0, 20.0));
        assert_eq!(rate("skeleton = 'kit'"), (12.5, 12.5));
        assert_eq!(rate("fps = 30"), (30.0, 30.0));
        // Configs without the key stay as they were.
        let text = toml::to_string(&Humanml3dConfig::default()).unwrap();
        assert!(!text.contains("fps"), "{text}");
    }

    #[test]
    fn what_clips_cannot_have_is_refused_by_its_key() {
        type Change = fn(&mut DataConfig);
        let cases: [(&str, Change); 19] = [
            ("data.source", |c| c.source = None),
            ("data.humanml3d.fps", |c| c.humanml3d.fps = Some(0.0)),
            ("data.humanml3d.fps", |c| c.humanml3d.fps = Some(f64::NAN)),
            ("data.humanml3d.unit_frames", |c| {
                c.humanml3d.unit_frames = 0
            }),
            ("data.humanml3d.unit_frames", |c| c.target_frames = 4),
            ("data.humanml3d.min_frames", |c| c.humanml3d.min_frames = 3),
            ("data.humanml3d.max_frames", |c| c.humanml3d.max_frames = 40),
            ("data.humanml3d.train_list", |c| {
                c.humanml3d.train_list.clear()
            }),
            ("data.validation.fraction", |c| {
                c.validation.fraction = Some(0.1)
            }),
            ("data.validation.patterns", |c| {
                c.validation.patterns = vec!["M*".into()]
            }),
            ("data.validation.ids_file", |c| {
                c.validation.ids_file = Some("a".into())
            }),
            ("data.join_neighbours", |c| c.join_neighbours = true),
            ("data.augment.mirror", |c| c.augment.mirror = true),
            ("data.augment.rotate_yaw", |c| c.augment.rotate_yaw = true),
            ("data.augment.min_frames", |c| {
                c.augment.min_frames = Some(60)
            }),
            ("data.augment.audio_noise", |c| c.augment.audio_noise = 0.1),
            ("data.synthetic.frames", |c| {
                c.kind = DataKind::SyntheticWalks;
                c.synthetic.frames = 30;
            }),
            ("data.synthetic.frames", |c| {
                c.kind = DataKind::SyntheticWalks;
                c.synthetic.frames = 200;
            }),
            ("data.humanml3d.skeleton", |c| {
                c.kind = DataKind::SyntheticWalks;
                c.humanml3d.skeleton = SkeletonName::Kit;
            }),
        ];
        clips().validate().unwrap();
        for (expected, change) in cases {
            let mut config = clips();
            if expected == "data.humanml3d.unit_frames" {
                config.humanml3d.unit_frames = 8;
            }
            change(&mut config);
            match config.validate() {
                Err(Error::Config(refused)) => assert_eq!(refused.key, expected),
                other => panic!("{expected}: {other:?}"),
            }
        }
    }
}
