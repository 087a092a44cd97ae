//! The training loss with all distances and two targets against golden file 05_diffusion_loss,
//! which takes its weights from 03_unet.

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{
    DiffusionConfig, GaussianDiffusion, LossType, PredictionType, Time, diffusion_loss,
};
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{trials, unet, weights};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![golden_diffusion_loss(
        "ccmotion/05_diffusion_loss.safetensors",
        "ccmotion/03_unet.safetensors"
    ),]
}

fn golden_diffusion_loss(golden: Golden, network: Golden) {
    assert_eq!(golden.metadata("weights"), "03_unet.safetensors");
    let device = Device::flex().autodiff();
    let model = unet::fresh(network.metadata("config"), &Initializer::new(0, &device));
    let model = parameters::load(model, weights(&network, "model.")).expect("the weights fit");
    let x_start = golden.tensor::<3>("in.x0", &device);
    let noise = golden.tensor::<3>("in.noise", &device);
    let cond = golden.tensor::<3>("in.cond", &device);
    let timesteps = golden.get("in.t").indices();

    let graded = golden.names_under("grad.");
    let mut compared = 0;
    for case in golden.names_under("out.loss.") {
        let (prediction, distance) = case.split_once('.').expect("target and distance");
        let diffusion = GaussianDiffusion::new(&DiffusionConfig {
            prediction_type: match prediction {
                "epsilon" => PredictionType::Epsilon,
                "x0" => PredictionType::Sample,
                other => panic!("prediction {other}"),
            },
            loss_type: match distance {
                "mse" => LossType::Mse,
                "l1" => LossType::L1,
                "huber" => LossType::Huber,
                other => panic!("distance {other}"),
            },
            ..DiffusionConfig::default()
        })
        .expect("a valid process");
        let x_t: Tensor<3> = diffusion.add_noise(x_start.clone(), noise.clone(), &timesteps);
        golden
            .reference("out.x_t")
            .assert_close_tensor("x_t", x_t.clone(), 1e-5);
        let output = model.forward(x_t, &Time::of(&timesteps), cond.clone(), None);
        golden
            .reference("out.model_out")
            .assert_close_tensor("output", output.clone(), 2e-5);
        let target = diffusion.target(x_start.clone(), noise.clone(), &timesteps);
        let loss = diffusion_loss(output, target, None, None, diffusion.config.loss_type);
        let value = f64::from(loss.clone().into_scalar::<f32>());
        golden
            .reference(&format!("out.loss.{case}"))
            .assert_close(&case, &[value], 1e-5);

        let mut tracked = loss.backward();
        let infos = parameters::infos(&model);
        let gradients = kinegrad_models::gradients(&model, &mut tracked);
        // Not every case has gradients.
        let prefix = format!("{case}.model.");
        for name in graded.iter().filter_map(|name| name.strip_prefix(&prefix)) {
            let index = infos.iter().position(|info| info.name == name);
            let index = index.expect("a parameter");
            compared += 1;
            golden
                .reference(&format!("grad.{case}.model.{name}"))
                .assert_close_f32(&format!("{case} d{name}"), &gradients[index], 1e-4);
        }
    }
    assert_eq!(compared, graded.len(), "every stored gradient");
}
