//! The steering of one sampling stage towards goals.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{Guidance, Imputation, Objective, Steering};
use kinegrad_motion::goal::{Goal, GroundTargets, GuidanceLoss, Phase};
use kinegrad_train::Error;
use kinegrad_train::clips::FeatureSpace;

use super::SteeringConfig;

/// The guidance loss of the root's ground path.
#[derive(Clone, Debug)]
pub struct GroundObjective<'a> {
    /// The space of the network.
    pub space: &'a FeatureSpace,
    /// The loss of paths.
    pub loss: GuidanceLoss,
}

impl Objective for GroundObjective<'_> {
    fn gradient(&self, pred_original_sample: &Tensor<3>) -> Tensor<3> {
        let [batch, _, time] = pred_original_sample.dims();
        let positions = self.space.ground(pred_original_sample.clone());
        let positions = positions.swap_dims(1, 2).try_into_vec_as::<f32>();
        let positions = positions.expect("samples are float32").into_iter();
        let positions: Vec<f64> = positions.map(f64::from).collect();
        // On the host in double precision: a few thousand numbers, with branches.
        let (_, gradient) = self.loss.evaluate(&positions);
        let gradient: Vec<f32> = gradient.into_iter().map(|value| value as f32).collect();
        let device = pred_original_sample.device();
        let data = TensorData::new(gradient, [batch, time, 2]);
        let gradient = Tensor::<3>::from_data(data, &device).swap_dims(1, 2);
        self.space.from_ground(gradient)
    }
}

/// The model of a stage.
#[derive(Clone, Copy, Debug)]
pub struct StageModel<'a> {
    /// The network's space.
    pub space: &'a FeatureSpace,
    /// The network's channels.
    pub channels: usize,
    /// True for a motion model; its imputation may end at another timestep.
    pub of_motion: bool,
    /// Number of sampled frames, at least the length of the longest goal.
    pub frames: usize,
    /// The device without gradients.
    pub device: &'a Device,
}

/// Guidance and imputation of one stage (Guided Motion Diffusion, appendix F; docs/sources.md,
/// sections 4.6 and 4.7).
#[derive(Debug)]
pub struct StageSteering<'a> {
    config: &'a SteeringConfig,
    objective: GroundObjective<'a>,
    scale: f64,
    of_motion: bool,
    dense: KnownPositions,
    points: KnownPositions,
    /// The targets of a motion model after [`Phase::Points`]; `None` without targets. Positions in
    /// each frame alone: the motion would jump to single imputed frames.
    last: Option<KnownPositions>,
}

/// Positions to impute in meters, and their mask, `[batch, channels, frames]`.
type KnownPositions = [Tensor<3>; 2];

impl<'a> StageSteering<'a> {
    /// Steers to the positions of `goals`, in a trajectory model's stage or in the only stage.
    ///
    /// # Errors
    /// If a goal is not valid or longer than the motion.
    pub fn of_goals(
        config: &'a SteeringConfig,
        goals: &[Goal],
        model: StageModel<'a>,
    ) -> Result<Self, Error> {
        let loss = GuidanceLoss::new(&config.guidance, goals, model.frames)?;
        let has_detours = |goal: &Goal| config.has_detours(goal);
        // Beyond the dense phase too: the model would take the straight line again.
        let known = |otherwise: fn(&Goal) -> GroundTargets| {
            model.known(goals.iter().map(|goal| match has_detours(goal) {
                true => goal.around_obstacles(),
                false => otherwise(goal),
            }))
        };
        // A trajectory ends with the points unless `motion_until` says otherwise.
        let in_each_frame = |goal: &Goal| {
            let ends_later = config.schedule.motion_until.is_some() && goal.trajectory.is_some();
            has_detours(goal) || ends_later
        };
        let last = goals.iter().any(in_each_frame).then(|| {
            model.known(goals.iter().map(|goal| match in_each_frame(goal) {
                true => goal.around_obstacles(),
                false => GroundTargets::points(&[], goal.frames),
            }))
        });
        Ok(Self {
            config,
            scale: config.scale,
            of_motion: model.of_motion,
            dense: known(Goal::dense),
            points: known(Goal::points),
            last,
            objective: GroundObjective {
                space: model.space,
                loss,
            },
        })
    }

    /// Steers the second stage along `paths` of the first stage in every frame, one path per goal,
    /// and around obstacles.
    ///
    /// # Errors
    /// As [`of_goals`](Self::of_goals).
    ///
    /// # Panics
    /// If a goal has no path, or a path is longer than the model's frames.
    pub fn along(
        config: &'a SteeringConfig,
        goals: &[Goal],
        paths: &[Vec<[f64; 2]>],
        model: StageModel<'a>,
    ) -> Result<Self, Error> {
        let loss = GuidanceLoss::along(&config.guidance, goals, paths, model.frames)?;
        let targets = paths.iter();
        let targets = targets.map(|path| GroundTargets::trajectory(path, 0, path.len()));
        let known = model.known(targets);
        Ok(Self {
            config,
            scale: match config.second_stage_guidance {
                true => config.scale,
                false => 0.0,
            },
            of_motion: model.of_motion,
            dense: known.clone(),
            points: known.clone(),
            last: Some(known),
            objective: GroundObjective {
                space: model.space,
                loss,
            },
        })
    }

    /// The steering at timestep `t`.
    pub fn at(&self, t: usize) -> Steering<'_> {
        let schedule = &self.config.schedule;
        let guided = self.scale > 0.0 && schedule.phase(t) != Phase::Off;
        let known = match schedule.phase(t) {
            _ if !self.config.imputation => None,
            Phase::Off if self.of_motion && t >= schedule.motion_until.unwrap_or(0) => {
                self.last.as_ref()
            }
            Phase::Off => None,
            _ if self.of_motion && schedule.motion_until.is_some_and(|until| t < until) => None,
            Phase::Dense => Some(&self.dense),
            Phase::Points => Some(&self.points),
        };
        Steering {
            guidance: guided.then_some(Guidance {
                objective: &self.objective,
                scale: self.scale,
                max_shift: Some(self.config.max_shift),
            }),
            imputation: known.cloned().map(|[target, mask]| Imputation {
                space: self.objective.space,
                target,
                mask,
            }),
        }
    }
}

impl StageModel<'_> {
    fn known(self, targets: impl Iterator<Item = GroundTargets>) -> KnownPositions {
        let Self {
            channels, frames, ..
        } = self;
        let targets = targets.map(|targets| targets.in_channels(channels, frames).into());
        let (targets, masks): (Vec<_>, Vec<_>) = targets.unzip();
        [targets, masks].map(|values: Vec<Vec<f32>>| {
            let data = TensorData::new(values.concat(), [values.len(), channels, frames]);
            Tensor::from_data(data, self.device)
        })
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_motion::goal::{Keyframe, Obstacle, Trajectory};

    use super::*;

    fn stage<'a>(space: &'a FeatureSpace, device: &'a Device, of_motion: bool) -> StageModel<'a> {
        StageModel {
            space,
            channels: 4,
            of_motion,
            frames: 8,
            device,
        }
    }

    #[test]
    fn detours_are_imputed_among_obstacles() {
        let device = Device::flex();
        let space = FeatureSpace::new(&[0.0; 4], &[1.0; 4], None, &device);
        let model = stage(&space, &device, false);
        let mut goal = Goal::new(8);
        goal.keyframes = vec![Keyframe {
            frame: 5,
            x: 1.0,
            z: 2.0,
        }];
        let known = |goal: &Goal, detours| {
            let config = SteeringConfig {
                detours,
                ..SteeringConfig::default()
            };
            let goals = std::slice::from_ref(goal);
            let steering = StageSteering::of_goals(&config, goals, model).unwrap();
            [100, 20].map(|t| {
                let imputation = steering.at(t).imputation.expect("imputed");
                imputation.mask.sum().into_scalar::<f32>() / 2.0
            })
        };
        assert_eq!(known(&goal, true), [6.0, 1.0]);
        goal.obstacles = vec![Obstacle::Disc {
            x: 0.5,
            z: 1.0,
            radius: 0.2,
        }];
        assert_eq!(known(&goal, true), [6.0, 6.0]);
        assert_eq!(known(&goal, false), [1.0, 1.0]);
        // A motion model keeps to them to the end, and to single frames of another goal it does not.
        let other = Goal {
            obstacles: Vec::new(),
            ..goal.clone()
        };
        let config = SteeringConfig::default();
        let model = stage(&space, &device, true);
        let goals = [goal, other];
        let steering = StageSteering::of_goals(&config, &goals, model).unwrap();
        let imputed = [20, 19, 0].map(|t| {
            let mask = steering.at(t).imputation.expect("imputed").mask;
            [0, 1].map(|i| mask.clone().narrow(0, i, 1).sum().into_scalar::<f32>() / 2.0)
        });
        assert_eq!(imputed, [[6.0, 1.0], [6.0, 0.0], [6.0, 0.0]]);
    }

    #[test]
    fn imputation_into_a_motion_model_ends_at_motion_until() {
        let device = Device::flex();
        let space = FeatureSpace::new(&[0.0; 4], &[1.0; 4], None, &device);
        let mut config = SteeringConfig::default();
        let goals = [Goal {
            trajectory: Some(Trajectory {
                first_frame: 0,
                points: vec![[0.0, 0.1]; 8],
            }),
            ..Goal::new(8)
        }];
        let mut imputed = |motion_until| {
            config.schedule.motion_until = motion_until;
            let model = stage(&space, &device, true);
            let steering = StageSteering::of_goals(&config, &goals, model).unwrap();
            [400, 399, 20, 19, 1, 0].map(|t| steering.at(t).imputation.is_some())
        };
        assert_eq!(imputed(None), [true, true, true, false, false, false]);
        assert_eq!(imputed(Some(1)), [true, true, true, true, true, false]);
        assert_eq!(
            imputed(Some(400)),
            [true, false, false, false, false, false]
        );
    }

    #[test]
    fn single_frames_are_not_put_in_their_places_to_the_end() {
        let device = Device::flex();
        let space = FeatureSpace::new(&[0.0; 4], &[1.0; 4], None, &device);
        let model = stage(&space, &device, true);
        let mut config = SteeringConfig::default();
        config.schedule.motion_until = Some(0);
        let points = Goal {
            keyframes: vec![Keyframe {
                frame: 5,
                x: 1.0,
                z: 2.0,
            }],
            ..Goal::new(8)
        };
        let path = Goal {
            trajectory: Some(Trajectory {
                first_frame: 0,
                points: vec![[0.0, 0.1]; 8],
            }),
            ..Goal::new(8)
        };
        let imputes = |steering: StageSteering<'_>| {
            [50, 20, 19, 0].map(|t| steering.at(t).imputation.is_some())
        };
        let of_goals = |goal: &Goal| {
            let goals = std::slice::from_ref(goal);
            imputes(StageSteering::of_goals(&config, goals, model).unwrap())
        };
        assert_eq!(of_goals(&points), [true, true, false, false]);
        assert_eq!(of_goals(&path), [true; 4]);
        let (goals, paths) = ([points], [vec![[0.0, 0.1]; 8]]);
        let along = StageSteering::along(&config, &goals, &paths, model).unwrap();
        assert_eq!(imputes(along), [true; 4]);
    }
}
