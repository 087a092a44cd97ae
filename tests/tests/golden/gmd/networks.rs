//! The networks of Guided Motion Diffusion against the golden files of `gmd`.

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{Time, guided};
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_models::time_embedding::interleaved_sinusoidal;
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_tests::stages::Noted;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{gmd, gradients, trials, weights};

use super::bench::whole_model;

const OUTPUT: f64 = 2e-5;
const WHOLE: f64 = 5e-5;
const GUIDED: f64 = 2e-4;
const GRADIENT: f64 = 1e-4;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_gmd_motion_unet("gmd/unet_motion_tiny.safetensors") => compare_unet,
        golden_gmd_trajectory_unet("gmd/unet_traj_tiny.safetensors") => compare_unet,
        golden_gmd_unet_without_adagn("gmd/unet_traj_xxs_plain_tiny.safetensors") => compare_unet,
        golden_gmd_whole_model("gmd/mdm_unet_tiny.safetensors"),
    ]
}

/// `[time, batch, channels]` of a file as `[batch, channels, time]`.
fn sequence_first(x: Tensor<3>) -> Tensor<3> {
    x.permute([1, 2, 0])
}

/// Compares the output of every stage.
fn compare_stages(golden: &Golden, stages: &Noted) {
    let names = golden.names_under("out.");
    let whole = ["y", "loss"];
    let stored = names.iter().filter(|name| !whole.contains(&name.as_str()));
    assert!(stored.clone().count() > 0, "a stored stage");
    for name in stored {
        let reference = golden.get(&format!("out.{name}"));
        assert_eq!(stages.shape(name), reference.shape, "{name}: shape");
        reference.assert_within_f32(name, stages.values(name), OUTPUT, 0.0);
    }
}

fn compare_unet(golden: Golden) {
    let device = Device::flex().autodiff();
    let (config, channels, cond) = gmd::unet(&golden, "model.");
    let init = Initializer::new(0, &device);
    let network = config.init(channels, cond, &init).expect("a network");
    let network = parameters::load(network, weights(&golden, "model.")).expect("the weights fit");
    let x = golden.tensor::<3>("in.x", &device).require_grad();
    let cond = golden.tensor::<2>("in.cond", &device).require_grad();
    let mut stages = Noted::default();
    let input = sequence_first(x.clone());
    let y = network.forward_stages(input, cond.clone(), &mut stages);
    compare_stages(&golden, &stages);
    let y = y.permute([2, 0, 1]);
    golden
        .get("out.y")
        .assert_within("y", y.clone(), OUTPUT, 0.0);

    let loss = (y.clone() * y).mean();
    golden
        .get("out.loss")
        .assert_within("loss", loss.clone(), OUTPUT, OUTPUT);
    let mut found = loss.backward();
    let of = |gradient: Option<_>| gradient.expect("part of the loss");
    golden
        .get("grad.in.x")
        .assert_close_tensor("dx", of(x.grad(&found)), GRADIENT);
    golden.get("grad.in.cond").assert_close_tensor(
        "dcond",
        cond.grad(&found).expect("too"),
        GRADIENT,
    );
    let computed = kinegrad_models::gradients(&network, &mut found);
    gradients::compare(&golden, &network, &computed, GRADIENT);
}

fn golden_gmd_whole_model(golden: Golden) {
    let device = Device::flex().autodiff();
    let padded_frames = golden.metadata("padded_frames").parse().expect("a number");
    let network = whole_model(&golden, "model.", padded_frames, &device);
    let at = Time::of(&golden.get("in.t").indices());
    let text = golden
        .tensor::<2>("in.text_features", &device)
        .unsqueeze_dim(2);
    let x = golden
        .get("in.x")
        .flat()
        .tensor::<3>(&device)
        .require_grad();

    let width = golden.get("out.time_emb").shape[1];
    golden.get("out.pe_rows").assert_within(
        "sinusoid rows",
        interleaved_sinusoidal(&at.iter().map(|t| t.0).collect::<Vec<_>>(), width, &device),
        1e-5,
        0.0,
    );
    let conditioner = network.conditioner();
    let time = conditioner.time(&at, &device);
    golden
        .get("out.time_emb")
        .assert_within("time", time, WHOLE, 0.0);
    let cond = conditioner.forward(&at, text.clone());
    golden
        .get("out.emb")
        .assert_within("cond", cond, WHOLE, 0.0);
    let uncond = conditioner.forward(&at, text.zeros_like());
    golden
        .get("out.emb_uncond")
        .assert_within("uncond", uncond, WHOLE, 0.0);

    let mut stages = Noted::default();
    let y = network.forward_stages(x.clone(), &at, text.clone(), None, None, &mut stages);
    compare_padding(&golden, &stages);
    golden
        .get("out.y")
        .assert_within("y", y.clone(), WHOLE, 0.0);
    let uncond = network.forward(x.clone(), &at, text.zeros_like());
    golden
        .get("out.y_uncond")
        .assert_within("y without text", uncond, WHOLE, 0.0);
    let scales = golden.get("in.cfg_scale");
    for (sample, &scale) in scales.values.iter().enumerate() {
        let mixed = guided(&network, x.clone(), &at, &text, scale);
        let mixed = mixed.narrow(0, sample, 1);
        let expected = golden.get("out.y_cfg").part(sample);
        expected.assert_within("guided", mixed, GUIDED, 0.0);
    }

    let loss = (y.clone() * y).mean();
    golden
        .get("out.loss")
        .assert_within("loss", loss.clone(), WHOLE, WHOLE);
    let mut found = loss.backward();
    let dx = x.grad(&found).expect("part of the loss");
    golden
        .get("grad.in.x")
        .flat()
        .assert_close_tensor("dx", dx, GRADIENT);
    let computed = kinegrad_models::gradients(&network, &mut found);
    gradients::compare(&golden, &network, &computed, GRADIENT);
}

/// Compares input and output of the UNet for the frames after the clip's end, of which the file has
/// the first.
fn compare_padding(golden: &Golden, stages: &Noted) {
    let frames: usize = golden.metadata("nframes").parse().expect("a number");
    for (name, stage, start) in [
        ("out.unet_in_padded", "unet_in_padded", 0),
        ("out.unet_out_padded_tail", "unet_out_padded", frames),
    ] {
        let (values, shape) = (stages.values(stage), stages.shape(stage));
        let [batch, channels, time] = shape[..] else {
            panic!("{stage}: {shape:?}");
        };
        // The file has [time, batch, channels].
        let reference = golden.get(name);
        assert_eq!(reference.shape[1..], [batch, channels], "{name}: shape");
        let of_frame = |frame: usize| (0..batch * channels).map(move |row| row * time + frame);
        let found = (start..start + reference.shape[0]).flat_map(of_frame);
        let found: Vec<f32> = found.map(|place| values[place]).collect();
        reference.assert_within_f32(name, &found, WHOLE, 0.0);
    }
}
