//! The recipes of this system by name.

use kinegrad_train::RecipeInfo;
use kinegrad_train::config::Config;

pub(super) const RECIPES: [RecipeInfo; 2] = [
    RecipeInfo {
        name: "gmd_motion",
        groups: &["unet"],
    },
    RecipeInfo {
        name: "gmd_trajectory",
        groups: &["unet"],
    },
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RecipeName {
    /// The motion model.
    Motion,
    /// The model of the root path.
    Trajectory,
}

impl RecipeName {
    /// The recipe of a config of this system.
    pub fn of(config: &Config) -> Self {
        Self::named(&config.train.recipe).expect("a recipe of this system")
    }

    /// The recipe with this name; `None` for recipes of other systems.
    pub fn named(name: &str) -> Option<Self> {
        let all = [Self::Motion, Self::Trajectory];
        all.into_iter().find(|recipe| recipe.name() == name)
    }

    pub const fn name(self) -> &'static str {
        RECIPES[self as usize].name
    }
}
