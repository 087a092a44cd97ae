//! The recipes of this system by name.

use kinegrad_train::RecipeInfo;
use kinegrad_train::config::Config;

/// The recipes.
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

/// A recipe of this system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RecipeName {
    /// The motion model.
    Motion,
    /// The model of the root path.
    Trajectory,
}

impl RecipeName {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Motion, Self::Trajectory];

    /// The recipe of a config of this system.
    ///
    /// # Panics
    /// Panics for a config of another system.
    pub fn of(config: &Config) -> Self {
        Self::named(&config.train.recipe).expect("a recipe of this system")
    }

    /// The recipe of that name; none where it is of another system.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|recipe| recipe.name() == name)
    }

    /// Its name in configs.
    pub const fn name(self) -> &'static str {
        RECIPES[self as usize].name
    }
}
