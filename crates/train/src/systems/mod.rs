//! Systems: one folder per generative method.
//!
//! A [`System`] defines its name, its recipes, its config tables, and how to validate, train,
//! sample, evaluate and import weights. Code outside a system's folder does not refer to it by
//! name: entry points take a list of [`Systems`] and find the system of a run by its recipe.
//! [`BUILT_IN`] lists the systems of this crate.

pub mod bpe_transformer;
pub mod cc_motion;
pub mod flow;
pub mod gmd;
pub mod text_motion;

pub use crate::recipe::RecipeInfo;
pub use crate::system::{System, Systems};

/// The systems of this crate.
pub const BUILT_IN: Systems<'static> = Systems(&[
    &cc_motion::CcMotion,
    &gmd::Gmd,
    &flow::Flow,
    &bpe_transformer::BpeTransformer,
    &text_motion::TextMotionSystem,
]);
