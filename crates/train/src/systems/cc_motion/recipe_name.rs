//! The recipes of this system by name.

use kinegrad_motion::{Phrases, Representation};

use crate::config::Config;
use crate::error::Error;
use crate::recipe::RecipeInfo;

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
    /// The decoder, on a denoiser that does not change.
    Decoder,
    /// Denoiser and decoder, through the sampler.
    E2e,
}

impl RecipeName {
    /// The recipe of a config.
    ///
    /// # Errors
    /// [`Error::OtherRepresentation`] for a config of another system.
    pub fn of(config: &Config) -> Result<Self, Error> {
        let name = config.train.recipe.as_str();
        let all = [Self::Diffusion, Self::Decoder, Self::E2e];
        let found = all.into_iter().find(|recipe| recipe.name() == name);
        found.ok_or_else(|| Error::OtherRepresentation {
            recipe: name.to_string(),
            expected: Phrases.name(),
        })
    }

    /// Its name in configs.
    pub fn name(self) -> &'static str {
        RECIPES[self as usize].name
    }

    /// Whether it runs the sampler in training, so that `rollout`, `decoder` and `loss` matter.
    pub fn trains_through_sampler(self) -> bool {
        match self {
            Self::Diffusion => false,
            Self::Decoder | Self::E2e => true,
        }
    }
}
