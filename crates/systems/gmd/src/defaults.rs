//! Default values of the recipes, from the paper.

use kinegrad_models::NetworkConfig;
use kinegrad_train::RecipeInfo;
use kinegrad_train::config::lay_over;
use toml::Table;

use super::recipe_name::RecipeName;
use crate::network::GmdUnetConfig;

/// Defaults of both models (Guided Motion Diffusion, table D.1 and appendix E and F;
/// docs/sources.md, sections 4.3, 4.5 and 4.11).
const GMD: &str = r#"
[data]
kind = "humanml3d"
target_frames = 196
[diffusion]
beta_schedule = "cosine"
beta_min = 0.0
beta_max = 0.999
loss_type = "mse"
cond_drop_prob = 0.1
[optim]
learning_rate = 1e-4
weight_decay = 1e-2
warmup_steps = 0
lr_schedule = "constant"
[ema]
decay = 0.9999
update_every = 1
inv_gamma = 0.0
[sampling.sampler]
kind = "ddpm"
num_inference_steps = 1000
guidance_scale = 2.5
"#;

const GMD_MOTION: &str = r#"
[data]
batch_size = 64
[model]
size = "gmd_motion"
[diffusion]
prediction_type = "sample"
[emphasis]
kind = "gaussian"
[train]
max_steps = 500000
[sampling]
clip = "none"
"#;

const GMD_TRAJECTORY: &str = r#"
[data]
batch_size = 512
[model]
size = "gmd_trajectory"
[diffusion]
prediction_type = "epsilon"
[emphasis]
kind = "none"
[train]
max_steps = 62500
[sampling]
clip = "six"
"#;

/// The defaults of a recipe that differ from the tables' defaults.
pub(super) fn of_recipe(recipe: &RecipeInfo, given: &Table) -> Table {
    let own = match RecipeName::named(recipe.name) {
        Some(RecipeName::Motion) => GMD_MOTION,
        Some(RecipeName::Trajectory) => GMD_TRAJECTORY,
        None => return Table::new(),
    };
    let parse = |text: &str| text.parse::<Table>().expect("text of this file");
    let mut table = parse(GMD);
    lay_over(&mut table, parse(own));
    // The default size belongs to this kind; another kind has another default size.
    let kind = given.get("model").and_then(|model| model.get("kind"));
    if kind.is_some_and(|kind| kind.as_str() != Some(GmdUnetConfig::KIND)) {
        table.remove("model");
    }
    table
}
