//! Guided Motion Diffusion.

pub mod bench;
mod draw_and_cut;
mod emphasis;
mod evaluator;
mod goals;
mod guidance;
mod guidance_loss;
mod imputation;
mod metrics;
mod networks;
mod p_sample;
mod schedule;
mod trajectory_loss;
mod two_stage;

use kinegrad_tests::trials::GoldenTest;

/// The tests of this folder.
pub fn tests() -> Vec<GoldenTest> {
    let tests = [
        draw_and_cut::tests(),
        emphasis::tests(),
        evaluator::tests(),
        goals::tests(),
        guidance::tests(),
        guidance_loss::tests(),
        imputation::tests(),
        metrics::tests(),
        networks::tests(),
        p_sample::tests(),
        schedule::tests(),
        trajectory_loss::tests(),
        two_stage::tests(),
    ];
    tests.into_iter().flatten().collect()
}
