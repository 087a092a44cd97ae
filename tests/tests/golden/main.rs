//! All comparisons with reference tensors computed elsewhere.

mod audio;
mod blocks;
mod ddim;
mod decoder;
mod diffusion_loss;
mod diffusion_steps;
mod e2e;
mod flow;
mod flowmdm;
mod genmm;
mod gmd;
mod humanml;
mod optim;
mod paths;
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
        flowmdm::tests(),
        genmm::tests(),
        gmd::tests(),
        humanml::tests(),
        optim::tests(),
        paths::tests(),
        postprocess_sanity::tests(),
        schedules::tests(),
        temporal_loss::tests(),
        unet::tests(),
    ];
    kinegrad_tests::trials::run(tests.into_iter().flatten().collect())
}
