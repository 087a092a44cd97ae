//! The base model and the decoder that recipe `e2e` trains first if `init.diffusion` is empty.

use std::path::Path;
use std::rc::Rc;

use kinegrad_train::config::{Config, OptimConfig, OwnTables, RunConfig, TrainConfig};
use kinegrad_train::run::{Outcome, contains_run, train_config};
use kinegrad_train::{Ending, Error, Observer, ProcessGroup, Systems};

use super::recipe_name::RecipeName;
use super::{CcMotion, CcMotionConfig, InitConfig, PretrainConfig};

/// Names of the two initial runs, in the folder of the main run.
pub(super) const STAGES: [&str; 2] = [BASE, DECODER];
const BASE: &str = "base";
const DECODER: &str = "decoder";

/// Number of validations of each initial run.
const VALIDATIONS: u64 = 4;

/// The `saved` config of the run in `folder`. If a decoder's base model is the neighboring run
/// under a former path, the path becomes the path in `given`.
pub(super) fn moved(saved: Config, given: &Config, folder: &Path) -> Result<Config, Error> {
    let mut own = saved.own::<CcMotionConfig>().clone();
    let base = &given.own::<CcMotionConfig>().init.diffusion;
    let run = folder.parent().unwrap_or(folder);
    let place = Path::new(run.file_name().unwrap_or_default()).join(BASE);
    if *base != run.join(BASE) || !own.init.diffusion.ends_with(place) {
        return Ok(saved);
    }
    own.init.diffusion = base.clone();
    Ok(saved.with_own(own))
}

/// Refuses to train a new base model for a decoder that was trained on another base model.
fn must_have_base(folder: &Path) -> Result<(), Error> {
    let [base, decoder] = STAGES.map(|stage| folder.join(stage));
    if !contains_run(&decoder)? || contains_run(&base)? {
        return Ok(());
    }
    let config = base.join("config.toml");
    let (config, base, decoder) = (config.display(), base.display(), decoder.display());
    Err(Error::usage(
        format!(
            "{config} and the checkpoints next to it are missing: the decoder in {decoder} was \
             trained on that base model"
        ),
        format!("put the folder {base} back, or remove {decoder} to train both again"),
    ))
}

/// Trains or resumes both initial runs, and returns their settings. The inner error is the outcome
/// of an interrupted initial run; resuming the main run continues the initial run.
pub(super) fn run(
    config: &Config,
    folder: &Path,
    group: &Rc<ProcessGroup>,
    observer: &mut dyn Observer,
) -> Result<Result<InitConfig, Box<Outcome>>, Error> {
    if folder.to_str().is_none() {
        return Err(Error::usage(
            format!(
                "{}: the path is not UTF-8, and the config of this run would name its initial runs",
                folder.display()
            ),
            "choose another option `runs_dir`, or set `init.diffusion` and `init.decoder`",
        ));
    }
    let pretrain = announce(config, folder, observer);
    if pretrain.diffusion_steps > 0 {
        must_have_base(folder)?;
    }
    let base = (pretrain.diffusion_steps, pretrain.diffusion_learning_rate);
    let decoder = (pretrain.decoder_steps, pretrain.decoder_learning_rate);
    let mut init = InitConfig::default();
    for (name, recipe, (steps, rate)) in [
        (BASE, RecipeName::Diffusion, base),
        (DECODER, RecipeName::Decoder, decoder),
    ] {
        if steps == 0 {
            continue;
        }
        let stage = stage(config, name, recipe, &init, steps, rate);
        let run = folder.join(name);
        let resume = contains_run(&run)?;
        let systems = Systems(&[&CcMotion]);
        let outcome = train_config(systems, stage, folder, resume, group, observer)?;
        if outcome.ending == Some(Ending::Interrupted) {
            return Ok(Err(Box::new(outcome)));
        }
        match recipe {
            RecipeName::Decoder => init.decoder = run,
            RecipeName::Diffusion | RecipeName::E2e => init.diffusion = run,
        }
    }
    Ok(Ok(init))
}

/// Notes that both runs are trained first, and their steps.
pub(super) fn announce<'a>(
    config: &'a Config,
    folder: &Path,
    observer: &mut dyn Observer,
) -> &'a PretrainConfig {
    let pretrain = &config.own::<CcMotionConfig>().init.pretrain;
    observer.note(&format!(
        "`init.diffusion` is empty: a base model is trained first ({} steps), then a decoder ({} \
         steps), in {}",
        pretrain.diffusion_steps,
        pretrain.decoder_steps,
        folder.display()
    ));
    pretrain
}

/// The config of an initial run: `config` with another recipe, starting from `init`.
fn stage(
    config: &Config,
    name: &str,
    recipe: RecipeName,
    init: &InitConfig,
    steps: u64,
    rate: f64,
) -> Config {
    let own = CcMotionConfig {
        init: init.clone(),
        lora: None,
        ..config.own::<CcMotionConfig>().clone()
    };
    let mut stage = Config {
        run: RunConfig {
            name: name.into(),
            ..config.run.clone()
        },
        system: OwnTables::new(own),
        optim: OptimConfig {
            learning_rate: rate,
            warmup_steps: steps / 10,
            groups: Default::default(),
            ..config.optim.clone()
        },
        train: TrainConfig {
            recipe: recipe.name().into(),
            max_steps: Some(steps),
            epochs: None,
            patience: 0,
            ..config.train.clone()
        },
        ..config.clone()
    };
    stage.sampling.count_at_end = 0;
    let validation = &mut stage.validation;
    if validation.is_enabled() {
        validation.every_steps = Some((steps / VALIDATIONS).max(1));
        validation.every_epochs = None;
    }
    stage
}
