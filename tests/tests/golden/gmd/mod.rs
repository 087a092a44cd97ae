//! Guided Motion Diffusion.

mod bench;
mod emphasis;
mod goals;
mod guidance;
mod guidance_loss;
mod imputation;
mod networks;
mod p_sample;
mod schedule;
mod trajectory_loss;

use kinegrad_tests::trials::GoldenTest;

/// The tests of this folder.
pub fn tests() -> Vec<GoldenTest> {
    let tests = [
        emphasis::tests(),
        goals::tests(),
        guidance::tests(),
        guidance_loss::tests(),
        imputation::tests(),
        networks::tests(),
        p_sample::tests(),
        schedule::tests(),
        trajectory_loss::tests(),
    ];
    tests.into_iter().flatten().collect()
}
