//! The list of systems: one crate per generative method, each in a folder beside this one.
//!
//! A [`System`](kinegrad_train::System) defines its name, its recipes, its config tables, and how
//! to validate, train, sample, evaluate and import weights. No other crate refers to a system by
//! name: entry points take a list of [`Systems`] and find a run's system by the recipe.

use kinegrad_train::Systems;

/// The systems of kinegrad.
pub const BUILT_IN: Systems<'static> = Systems(&[
    &kinegrad_cc_motion::CcMotion,
    &kinegrad_gmd::Gmd,
    &kinegrad_flow::Flow,
    &kinegrad_bpe_transformer::BpeTransformer,
    &kinegrad_text_motion::TextMotionSystem,
]);

// Compiles the README's Rust code as a doctest.
#[cfg(doctest)]
#[doc = include_str!("../../../../README.md")]
struct Readme;

#[cfg(test)]
mod tests;
