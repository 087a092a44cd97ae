//! The base model and the decoder that recipe `e2e` trains first where `init.diffusion` is empty.

use std::path::Path;

use super::start::Starts;
use super::{CcMotion, CcMotionConfig, InitConfig};
use crate::config::{Config, OptimConfig, RunConfig, SystemTables, TrainConfig};
use crate::error::Error;
use crate::observer::Observer;
use crate::run::{Outcome, train_config};
use crate::systems::Systems;
use crate::trainer::Ending;

/// Names of the two runs, inside the folder of the run that needs them.
const BASE: &str = "base";
const DECODER: &str = "decoder";

/// Validations of each of the two.
const VALIDATIONS: u64 = 4;

/// Whether a run in `folder` has begun to train what it starts from.
pub(super) fn has_begun(folder: &Path) -> bool {
    folder.join(BASE).join("config.toml").exists()
}

/// Trains, continues or finds both runs. The inner error is the outcome of a run that the user
/// interrupted; resuming the outer one continues it.
pub(super) fn run(
    config: &Config,
    folder: &Path,
    observer: &mut dyn Observer,
) -> Result<Result<Starts, Box<Outcome>>, Error> {
    let pretrain = CcMotionConfig::of(config)?.init.pretrain;
    let systems = Systems(&[&CcMotion]);
    let base = folder.join(BASE);
    observer.note(&format!(
        "`init.diffusion` is empty: a base model is trained first ({} steps), then a decoder ({} \
         steps), in {}",
        pretrain.diffusion_steps,
        pretrain.decoder_steps,
        folder.display()
    ));
    let steps = pretrain.diffusion_steps;
    let rate = pretrain.diffusion_learning_rate;
    let stage = stage(config, BASE, super::DIFFUSION, None, steps, rate)?;
    let begun = base.join("config.toml").exists();
    let outcome = train_config(systems, stage, folder, begun, observer)?;
    if outcome.ending == Some(Ending::Interrupted) {
        return Ok(Err(Box::new(outcome)));
    }
    if pretrain.decoder_steps == 0 {
        return Starts::at(&base, None).map(Ok);
    }
    let steps = pretrain.decoder_steps;
    let rate = pretrain.decoder_learning_rate;
    let stage = self::stage(config, DECODER, super::DECODER, Some(&base), steps, rate)?;
    let decoder = folder.join(DECODER);
    let begun = decoder.join("config.toml").exists();
    let outcome = train_config(systems, stage, folder, begun, observer)?;
    if outcome.ending == Some(Ending::Interrupted) {
        return Ok(Err(Box::new(outcome)));
    }
    Starts::at(&base, Some(&decoder)).map(Ok)
}

/// The config of one of the two: `config` with another recipe, starting from `base`.
fn stage(
    config: &Config,
    name: &str,
    recipe: &str,
    base: Option<&Path>,
    steps: u64,
    rate: f64,
) -> Result<Config, Error> {
    let own = CcMotionConfig {
        init: InitConfig {
            diffusion: base.map(Path::to_path_buf).unwrap_or_default(),
            ..InitConfig::default()
        },
        lora: None,
        ..CcMotionConfig::of(config)?
    };
    let mut stage = Config {
        run: RunConfig {
            name: name.into(),
            ..config.run.clone()
        },
        system: own.to_table(),
        optim: OptimConfig {
            learning_rate: rate,
            warmup_steps: steps / 10,
            groups: Default::default(),
            ..config.optim.clone()
        },
        train: TrainConfig {
            recipe: recipe.into(),
            max_steps: steps,
            patience: 0,
            ..config.train.clone()
        },
        ..config.clone()
    };
    stage.sampling.count_at_end = 0;
    if stage.validation.every_steps > 0 {
        stage.validation.every_steps = (steps / VALIDATIONS).max(1);
    }
    Ok(stage)
}
