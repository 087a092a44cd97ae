//! The recipes of this system by name.

use kinegrad_train::RecipeInfo;
use kinegrad_train::config::Config;

/// The recipes.
pub(super) const RECIPES: [RecipeInfo; 3] = [
    RecipeInfo {
        name: "diffusion",
        groups: &["unet"],
    },
    RecipeInfo {
        name: "decoder",
        groups: &["decoder"],
    },
    RecipeInfo {
        name: "e2e",
        groups: &["unet", "decoder"],
    },
];

/// A recipe of this system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RecipeName {
    /// The denoiser.
    Diffusion,
    /// Trains the decoder on a frozen denoiser.
    Decoder,
    /// Trains denoiser and decoder through the sampler.
    E2e,
}

impl RecipeName {
    /// The recipe of a config of this system; panics for other systems.
    pub fn of(config: &Config) -> Self {
        let mut all = [Self::Diffusion, Self::Decoder, Self::E2e].into_iter();
        all.find(|recipe| recipe.name() == config.train.recipe)
            .expect("a recipe of this system")
    }

    /// Name in configs.
    pub fn name(self) -> &'static str {
        RECIPES[self as usize].name
    }

    /// True if training runs the sampler, so that `rollout`, `decoder` and `loss` apply.
    pub fn trains_through_sampler(self) -> bool {
        self != Self::Diffusion
    }
}
