//! Everything that is compared with reference tensors computed elsewhere.

mod audio;
mod blocks;
mod ddim;
mod decoder;
mod diffusion_loss;
mod diffusion_steps;
mod e2e;
mod flow;
mod genmm;
mod gmd;
mod humanml;
mod optim;
mod postprocess_sanity;
mod schedules;
mod temporal_loss;
mod unet;

use std::process::ExitCode;

fn main() -> ExitCode {
    let tests = [
        audio::tests(),
        blocks::tests(),
        ddim::tests(),
        decoder::tests(),
        diffusion_loss::tests(),
        diffusion_steps::tests(),
        e2e::tests(),
        flow::tests(),
        genmm::tests(),
        gmd::tests(),
        humanml::tests(),
        optim::tests(),
        postprocess_sanity::tests(),
        schedules::tests(),
        temporal_loss::tests(),
        unet::tests(),
    ];
    kinegrad_tests::trials::run(tests.into_iter().flatten().collect())
}
