//! The recipes of this system by name.

use kinegrad_motion::Representation;

use crate::config::Config;
use crate::error::Error;
use crate::recipe::RecipeInfo;

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

    /// The recipe of a config.
    ///
    /// # Errors
    /// [`Error::OtherRepresentation`] for a config of another system.
    pub fn of(config: &Config) -> Result<Self, Error> {
        let name = config.train.recipe.as_str();
        Self::named(name).ok_or_else(|| Error::OtherRepresentation {
            recipe: name.to_string(),
            expected: config.data.humanml3d.representation().name(),
        })
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
