//! The system's own config tables and their validation.

use std::path::PathBuf;

use kinegrad_data::DataKind;
use kinegrad_diffusion::{DiffusionConfig, LossType, PredictionType, must_suit};
use kinegrad_motion::MAX_FRAMES;
use kinegrad_motion::emphasis::{EmphasisConfig, EmphasisKind};
use kinegrad_motion::goal::TRAJECTORY_CHANNELS;
use kinegrad_motion::humanml::Root;
use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range, require};
use kinegrad_train::Error;
use kinegrad_train::clips::ChannelWeights;
use kinegrad_train::clips::captions::CaptionsConfig;
use kinegrad_train::clips::evaluator::EvaluatorFiles;
use kinegrad_train::clips::path_condition::PathTrainingConfig;
use kinegrad_train::clips::settings::{must_be_of_clips, must_have_no_style, validate_velocity};
use kinegrad_train::config::{
    ClipSample, Config, ModelTable, NetworkKind, SamplingConfig, SystemTables,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::evaluate::KeyframePlacement;
use super::recipe_name::RecipeName;
use super::steering::SteeringConfig;
use crate::network::transformer::EncoderConfig;
use crate::network::{Backbone, GmdUnetConfig};

/// The tables of this system.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GmdConfig {
    /// The initial checkpoint of fine-tuning.
    pub init: GmdInitConfig,
    /// The denoiser.
    pub model: ModelTable<Backbone>,
    /// The captions of the model.
    pub text: CaptionsConfig,
    /// The emphasis projection of a motion model.
    pub emphasis: EmphasisConfig,
    /// The diffusion process.
    pub diffusion: DiffusionConfig,
    /// Training of a path-conditioned network.
    pub paths: PathTrainingConfig,
    /// The loss.
    pub loss: GmdLossConfig,
    /// Guidance and imputation for goals.
    pub steering: SteeringConfig,
    /// The evaluation.
    pub evaluation: GmdEvaluationConfig,
}

/// The table `init`: the initial checkpoint of fine-tuning.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GmdInitConfig {
    /// Run or checkpoint of the same recipe that provides EMA weights, network, process, feature
    /// space and statistics.
    pub diffusion: PathBuf,
}

/// The table `loss`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GmdLossConfig {
    /// For motion models without a projection: the channels of the trajectory are weighted by the
    /// square of this factor (Guided Motion Diffusion, appendix C.1).
    pub trajectory_scale: f64,
    /// The form of the loss with `trajectory_scale`.
    pub trajectory_form: TrajectoryForm,
    /// Weight of the squared error of differences between consecutive frames, which penalizes
    /// shaking. For `prediction_type = "sample"`; 0 in the paper. Small models shake if the weight
    /// is 0.
    pub velocity: f64,
    /// Weight of the squared error of the joints' world velocities, in meters per second, mean over
    /// the joints. For motion models with `prediction_type = "sample"`; 0 in the paper.
    pub joint_velocity: f64,
    /// Weight of the squared speed of feet that stand in the training clip, mean over four foot
    /// joints (Human Motion Diffusion Model, equation 5). Conditions as for `joint_velocity`.
    pub foot_contact: f64,
}

impl Default for GmdLossConfig {
    fn default() -> Self {
        Self {
            trajectory_scale: 1.0,
            trajectory_form: TrajectoryForm::Published,
            velocity: 0.0,
            joint_velocity: 0.0,
            foot_contact: 0.0,
        }
    }
}

/// The form of the loss with a weighted trajectory (Guided Motion Diffusion, appendix C.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TrajectoryForm {
    /// As the published program: four channels (root rotation, x, z and height), and the mean over
    /// channels, whose weights add up to 1.
    #[default]
    Published,
    /// Equation 5 to the letter: three channels (root rotation, x and z), and the sum over channels.
    /// The loss is some hundred times as large, which `train.max_grad_norm` notices.
    Equation,
}

impl TrajectoryForm {
    /// Weights of `channels` channels, with a trajectory that is `scale` times as large.
    pub(super) fn weights(self, channels: usize, scale: f64) -> ChannelWeights {
        let mut weights = vec![1.0; channels];
        let of_trajectory = match self {
            Self::Published => TRAJECTORY_CHANNELS,
            Self::Equation => TRAJECTORY_CHANNELS - 1,
        };
        weights[..of_trajectory].fill(scale.powi(2));
        match self {
            Self::Published => ChannelWeights::mean(&weights),
            Self::Equation => ChannelWeights::sum(&weights),
        }
    }
}

/// The table `evaluation`: settings of `kinegrad eval`, with goals from held-out clips.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GmdEvaluationConfig {
    /// Number of held-out clips, with one goal each.
    pub goals: usize,
    /// The list of clips that provide the goals.
    pub split: EvaluationSplit,
    /// Batch size of sampling. Guidance divides by the number of keyframes in a batch.
    pub batch_size: usize,
    /// Number of evaluations with different seeds; the report of several has means and 95 %
    /// intervals. The published evaluation uses 20.
    pub replications: usize,
    /// Number of held-out clips with several samples, for trajectory diversity and multimodality; 0
    /// omits both. The published evaluation uses 100.
    pub variety_clips: usize,
    /// Number of samples per such clip.
    pub variety_repeats: usize,
    /// Keyframes per goal.
    pub keyframes: usize,
    /// The keyframes.
    pub keyframe_placement: KeyframePlacement,
    /// Obstacles per goal; if not 0, only the last frame is a keyframe.
    pub obstacles: usize,
    /// Clearance of guidance around obstacles, in meters: the margin of the goals. The count of
    /// frames inside obstacles ignores the margin.
    pub margin: f64,
    /// A text-motion evaluator, for R-precision and FID: a run, or all files of the published
    /// evaluator.
    pub evaluator: EvaluatorFiles,
}

impl Default for GmdEvaluationConfig {
    fn default() -> Self {
        Self {
            goals: 20,
            split: EvaluationSplit::Validation,
            batch_size: 32,
            replications: 1,
            variety_clips: 0,
            variety_repeats: 30,
            keyframes: 5,
            keyframe_placement: KeyframePlacement::Random,
            obstacles: 0,
            margin: 0.0,
            evaluator: EvaluatorFiles::default(),
        }
    }
}

/// The clips of a dataset that provide goals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EvaluationSplit {
    /// The clips of `data.humanml3d.validation_list`, or the clips held out by `data.validation`.
    Validation,
    /// The clips of `data.humanml3d.test_list`.
    Test,
}

impl SystemTables for GmdConfig {
    const NETWORKS: &'static [NetworkKind] = &[
        NetworkKind::of::<GmdUnetConfig>(),
        NetworkKind::of::<EncoderConfig>(),
    ];
}

pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let own: &GmdConfig = config.own();
    let Config { data, sampling, .. } = config;
    let name = RecipeName::of(config);
    own.diffusion.validate()?;
    own.diffusion.must_not_rescale_timesteps()?;
    must_be_of_clips(config)?;
    own.model.network.validate()?;
    if let Some(most) = own.model.network.longest() {
        let allowed = format!("at most `model.padded_frames` ({most})");
        let (key, found) = ("data.target_frames", data.target_frames);
        require(found <= most, key, found, allowed)?;
    }
    must_suit(&sampling.sampler, &own.diffusion)?;
    must_suit_first_stage(own, sampling)?;
    must_have_no_style(config, &own.diffusion)?;
    own.text.validate(data)?;
    own.emphasis.validate()?;
    let scale = own.loss.trajectory_scale;
    in_range("loss.trajectory_scale", scale, ABOVE_ZERO)?;
    let has_path = own.model.network.has_path();
    own.paths.validate(has_path)?;
    let allowed = "false: recipe `gmd_trajectory` generates paths itself";
    let fits = !(has_path && name == RecipeName::Trajectory);
    require(fits, "model.path", true, allowed)?;
    let (key, scale_of_path) = (
        "steering.path_guidance_scale",
        own.steering.path_guidance_scale,
    );
    let allowed = "1 without `model.path`";
    require(
        scale_of_path == 1.0 || has_path,
        key,
        scale_of_path,
        allowed,
    )?;
    let literal = own.loss.trajectory_form == TrajectoryForm::Equation;
    let fits = own.diffusion.loss_type == LossType::Mse || !literal;
    let allowed = "\"published\" unless `diffusion.loss_type = \"mse\"`";
    require(fits, "loss.trajectory_form", "\"equation\"", allowed)?;
    validate_velocity(own.loss.velocity, &own.diffusion)?;
    for (key, weight) in [
        ("loss.joint_velocity", own.loss.joint_velocity),
        ("loss.foot_contact", own.loss.foot_contact),
    ] {
        in_range(key, weight, 0.0..)?;
        let sample = own.diffusion.prediction_type == PredictionType::Sample;
        let fits = weight == 0.0 || (name == RecipeName::Motion && sample);
        let allowed =
            "0 unless the recipe is `gmd_motion` and `diffusion.prediction_type = \"sample\"`";
        require(fits, key, weight, allowed)
            .hint("noise has no joints, and neither have the root's four channels")?;
        let fits = weight == 0.0 || data.humanml3d.root == Root::Absolute;
        let allowed = "0 unless `data.humanml3d.root = \"absolute\"`";
        require(fits, key, weight, allowed)
            .hint("with a relative root, positions of joints are sums over all frames before")?;
    }
    let projects = own.emphasis.kind != EmphasisKind::None;
    let is_trajectory = name == RecipeName::Trajectory;
    let allowed = "\"none\": the trajectory model's four channels are not projected";
    require(
        !(is_trajectory && projects),
        "emphasis.kind",
        "a projection",
        allowed,
    )?;
    let clips_channels = sampling.clip == ClipSample::TrainingRange;
    let allowed = "\"none\", \"six\", \"unit\" or \"symmetric\" in a projected space, whose channels are mixtures of \
                   those whose range is known";
    require(
        !(projects && clips_channels),
        "sampling.clip",
        "\"training_range\"",
        allowed,
    )?;
    let fits = scale == 1.0 || !(projects || is_trajectory);
    let allowed = "1 in a projected space, where no channel is the trajectory's, and in recipe \
                   `gmd_trajectory`, where all are";
    require(fits, "loss.trajectory_scale", scale, allowed)?;
    let fits = !literal || !(projects || is_trajectory);
    let allowed = "\"published\" in a projected space and in recipe `gmd_trajectory`";
    require(fits, "loss.trajectory_form", "\"equation\"", allowed)?;
    let evaluation = &own.evaluation;
    in_range("evaluation.goals", evaluation.goals, 1..)?;
    in_range("evaluation.batch_size", evaluation.batch_size, 1..)?;
    in_range("evaluation.replications", evaluation.replications, 1..=1000)?;
    let repeats = evaluation.variety_repeats;
    in_range("evaluation.variety_repeats", repeats, 2..=1000)?;
    let has_lists = data.kind == DataKind::Humanml3d;
    let fits = evaluation.split == EvaluationSplit::Validation || has_lists;
    let allowed = "\"validation\" for `data.kind = \"synthetic_walks\"`, which has no list";
    require(fits, "evaluation.split", "\"test\"", allowed)?;
    in_range("evaluation.keyframes", evaluation.keyframes, 0..=MAX_FRAMES)?;
    in_range("evaluation.obstacles", evaluation.obstacles, 0..=MAX_FRAMES)?;
    in_range("evaluation.margin", evaluation.margin, 0.0..=10.0)?;
    let evaluator = evaluation.evaluator.validate();
    evaluator.within("evaluation.evaluator")?;
    Ok(own.steering.validate().within("steering")?)
}

/// Validates the first stage's sampler; the error names the keys of the first stage.
fn must_suit_first_stage(own: &GmdConfig, sampling: &SamplingConfig) -> Result<(), InvalidSetting> {
    let process = &own.diffusion;
    let first = own.steering.first_stage(&sampling.sampler);
    let (steps, scale) = (first.num_inference_steps, first.guidance_scale);
    let most = process.num_train_timesteps;
    in_range("steering.first_stage_steps", steps, 1..=most)?;
    in_range("steering.first_stage_guidance_scale", scale, 0.0..)?;
    must_suit(&first, process)
}

pub(super) fn warnings(config: &Config) -> Option<String> {
    let own: &GmdConfig = config.own();
    let frames = config.data.target_frames;
    let edge = "clips of `data.target_frames` end at the edge of the network, where it is less accurate: set \
                `model.padded_frames` to an eighth more";
    let at_edge = own
        .model
        .network
        .longest()
        .is_some_and(|most| most == frames);
    let overtrains = config.train.recipe == RecipeName::Trajectory.name()
        && (config.train.patience == 0 || !config.validation.is_enabled());
    let warning = "an overfitted trajectory model responds poorly to guidance, and this run \
                   never stops early: set `train.patience` and `validation.every_steps`";
    let warnings = [(at_edge, edge), (overtrains, warning)].into_iter();
    let warnings: Vec<&str> = warnings
        .filter(|(holds, _)| *holds)
        .map(|(_, text)| text)
        .collect();
    (!warnings.is_empty()).then(|| warnings.join("; "))
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, Tensor, TensorData};
    use kinegrad_train::clips::weighted_masked_loss;

    use super::*;

    #[test]
    fn equation_5_weighs_three_channels_and_adds_up() {
        let device = Device::flex();
        let row = |values: [f32; 6]| {
            Tensor::<3>::from_data(TensorData::new(values.to_vec(), [1, 6, 1]), &device)
        };
        // Errors of root rotation, x, z, height and two more channels.
        let (found, target) = (row([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), row([0.0; 6]));
        let loss = |form: TrajectoryForm, scale: f64| {
            let mask = Tensor::<2>::ones([1, 1], &device);
            let weights = form.weights(6, scale);
            let kind = LossType::Mse;
            let loss = weighted_masked_loss(
                found.clone(),
                target.clone(),
                mask,
                &weights,
                0.0,
                None,
                kind,
            );
            f64::from(loss.into_scalar::<f32>())
        };
        let squares = [1.0, 4.0, 9.0, 16.0, 25.0, 36.0];
        let of = |channels: usize, scale: f64| -> f64 {
            let (first, rest) = squares.split_at(channels);
            scale * scale * first.iter().sum::<f64>() + rest.iter().sum::<f64>()
        };
        for scale in [1.0, 10.0] {
            let literal = loss(TrajectoryForm::Equation, scale);
            assert!((literal / of(3, scale) - 1.0).abs() < 1e-6, "{literal}");
            let published = loss(TrajectoryForm::Published, scale);
            let expected = of(4, scale) / (4.0 * scale * scale + 2.0);
            assert!((published / expected - 1.0).abs() < 1e-6, "{published}");
        }
    }
}
