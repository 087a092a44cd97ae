//! A path that clips are drawn along: as a goal with a position for each frame.

use std::path::PathBuf;

use kinegrad_motion::goal::{Goal, Trajectory};
use kinegrad_motion::humanml::Skeleton;
use kinegrad_motion::path::PathPlan;

use super::{PATH, path};
use crate::TrainedModel;
use crate::error::Error;
use crate::path_target::{Fastest, PathTarget, in_words, read_path};
use crate::sampling::{Drawn, PathFile, PathRecord, clip_files};
use crate::systems::gmd::generate::GeneratedClip;
use crate::systems::gmd::recipe_name::RecipeName;

/// A path of a request.
pub(super) struct Along {
    file: PathBuf,
    plan: PathPlan,
    target: PathTarget,
}

impl Along {
    /// The path in `file`, for clips of `frames` frames.
    ///
    /// # Errors
    /// If it is no path, or the run's clips have no body.
    pub fn read(file: &PathFile, trained: &TrainedModel, frames: usize) -> Result<Self, Error> {
        if RecipeName::of(trained.config()) == RecipeName::Trajectory {
            return Err(Error::usage(
                "`--path` with a run of recipe `gmd_trajectory`",
                "it draws ground paths itself: give a run of recipe `gmd_motion`, and this one as \
                 `--trajectory-run`",
            ));
        }
        let (file, plan) = read_path(file)?;
        let skeleton = trained.config().data.humanml3d.skeleton.skeleton();
        let target = PathTarget::new(&plan, frames, skeleton.description().fps)?;
        Ok(Self { file, plan, target })
    }

    /// What to say of it if it asks for more than the training clips of the run had.
    pub fn too_fast(&self, trained: &TrainedModel) -> Option<String> {
        let skeleton = trained.config().data.humanml3d.skeleton.skeleton();
        let fps = skeleton.description().fps;
        // Displacements of joint 0, metres per frame.
        let first = skeleton.layout().velocities().start;
        let fastest = Fastest::of(&trained.saved.state.statistics, first, fps);
        self.target.too_fast(&self.file, fps, fastest)
    }

    /// Its file, for messages.
    pub fn file(&self) -> &PathBuf {
        &self.file
    }

    /// The path as a clip sees it, from its start: where the root is in each frame.
    pub fn goal(&self) -> Goal {
        let points = self.target.at_origin().course.points;
        Goal {
            trajectory: Some(Trajectory {
                first_frame: 0,
                points,
            }),
            ..Goal::new(self.target.course.frames())
        }
    }

    /// Puts a clip onto the path, of which `sample` was drawn, and says in words how it follows.
    ///
    /// # Errors
    /// If the clip is of another skeleton.
    pub fn place(
        &self,
        drawn: &mut Drawn,
        sample: &GeneratedClip,
        skeleton: &Skeleton,
    ) -> Result<String, Error> {
        let features = sample.features.as_ref().expect("a clip of a motion model");
        let frames = self.target.course.frames();
        let features = features.slice(0..frames);
        let placed = self.target.placed(&features.joints(), skeleton)?;
        let said = in_words(&placed.report);
        drawn.files = clip_files(features, placed.joints, skeleton);
        if let Some(first) = &sample.path {
            let first = self.target.on_path(&first[..frames]);
            drawn.files.push((PATH, path(&first)));
        }
        drawn.record.path = Some(PathRecord {
            file: self.file.clone(),
            content: self.plan.clone(),
            settings: None,
            report: placed.report,
        });
        Ok(said)
    }
}
