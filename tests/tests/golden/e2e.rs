//! The end-to-end loss against golden file 07_e2e, in all memory modes of the rollout: states,
//! losses, gradients of every step, and one optimiser step with two learning rates.

use std::cell::RefCell;
use std::collections::HashMap;

use burn::module::Module;
use burn::tensor::Tensor;
use kinegrad_cc_motion::losses::{ReconstructionLoss, temporal_losses};
use kinegrad_cc_motion::network::AudioCondition;
use kinegrad_cc_motion::network::UNet1d;
use kinegrad_cc_motion::{LossConfig, RolloutMode};
use kinegrad_diffusion::{
    ClipRange, Denoiser, Rollout, RolloutMode as Graph, Time, rollout_timesteps,
};
use kinegrad_models::parameters;
use kinegrad_tests::end_to_end::Case;
use kinegrad_tests::golden::{Golden, ReferenceTensors, compared, wide};
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{trials, weights};
use kinegrad_train::Recipe;
use kinegrad_train::config::OptimConfig;
use kinegrad_train::optim::{AdamW, Moments, norm_of_squares, squares};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_e2e_linear50("ccmotion/07_e2e.safetensors") => |golden| check(golden, "linear50"),
        golden_e2e_linear1000("ccmotion/07_e2e.safetensors") => |golden| check(golden, "linear1000"),
        golden_e2e_cosine1000("ccmotion/07_e2e.safetensors") => |golden| check(golden, "cosine1000"),
    ]
}

fn check(golden: Golden, name: &'static str) {
    let case = Case::of(golden, name);
    let full = losses_and_gradients(&case, RolloutMode::Full);
    let checkpointed = losses_and_gradients(&case, RolloutMode::Checkpointed);
    for (name, gradient) in &full {
        assert_close(name, &checkpointed[name], gradient, 1e-6);
    }
    truncated(&case);
    states_and_their_gradients(&case);
    gradients_of_each_step(&case);
    if name != "linear1000" {
        optimizer_step(&case, &full);
    }
}

/// Asserts that two of our own results agree, relative to the largest.
fn assert_close(what: &str, actual: &[f32], reference: &[f32], tolerance: f64) {
    let (actual, reference) = (wide(actual), wide(reference));
    let scale = reference.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    assert_eq!(actual.len(), reference.len(), "{what}: number of values");
    for (a, r) in actual.iter().zip(&reference) {
        let error = (a - r).abs();
        assert!(error <= tolerance * scale, "{what}: {error:e}");
    }
}

/// The recipe's loss, term by term, and its gradients that the golden file contains.
fn losses_and_gradients(case: &Case, mode: RolloutMode) -> HashMap<String, Vec<f32>> {
    let (model, recipe, weights) = (case.model(), case.recipe(mode), LossConfig::ccmotion());
    let loss = recipe.loss_of(&model, case.inputs(), case.draws());
    let value = |term: &Tensor<1>| f64::from(term.clone().into_scalar::<f32>());
    case.out("total")
        .assert_close("total", &[value(&loss.total)], 1e-5);
    for (name, term) in &loss.terms {
        let (name, weight) = match *name {
            "diffusion" => ("L_diff".to_string(), weights.w_diff),
            "position" => ("L_pos".to_string(), weights.w_dec),
            "quaternion" => ("L_quat".to_string(), weights.w_dec),
            temporal => (format!("temp.{temporal}"), weights.w_temp),
        };
        case.out(&name)
            .assert_close(&name, &[value(term) / weight], 1e-5);
    }
    assert_eq!(loss.terms.len(), 8);
    let temporal = loss.terms.iter().skip(3);
    let temporal: f64 = temporal.map(|(_, term)| value(term) / weights.w_temp).sum();
    case.out("L_temp").assert_close("L_temp", &[temporal], 1e-5);

    let gradients = recipe.backward(&model, loss).into_host(&model);
    let norm = norm_of_squares(&squares(&gradients));
    let tolerance = case.decoder_tolerance();
    case.out("global_grad_norm")
        .assert_close("norm", &[norm], tolerance);
    let zero: Vec<String> =
        serde_json::from_str(case.golden.metadata("structurally_zero_gradients")).expect("a list");
    let stored = case
        .golden
        .names_under(&format!("grad.{}.model.", case.name));
    let mut found = HashMap::new();
    for (info, gradient) in parameters::infos(&model).into_iter().zip(gradients) {
        let name = info.name;
        // A zero gradient contains rounding noise.
        if zero.iter().any(|zero| name.ends_with(zero.as_str())) {
            continue;
        }
        let tolerance = case.tolerance(&name);
        let squares = gradient.iter().map(|g| f64::from(*g).powi(2));
        let norm = squares.sum::<f64>().sqrt();
        case.golden
            .get(&format!("gradnorm64.{}.{name}", case.name))
            .assert_close(&format!("|d {name}|"), &[norm], tolerance);
        if stored.contains(&name) {
            let reference = format!("grad.{}.model.{name}", case.name);
            let reference = case.golden.reference(&reference);
            reference.assert_close_f32(&format!("d {name}"), &gradient, tolerance);
        }
        found.insert(name, gradient);
    }
    for name in stored {
        let is_zero = zero.iter().any(|zero| name.ends_with(zero.as_str()));
        assert!(is_zero || found.contains_key(&name), "no parameter {name}");
    }
    found
}

/// One step with a graph gives the truncated gradient.
fn truncated(case: &Case) {
    let (model, recipe) = (case.model(), case.recipe(RolloutMode::LastK));
    let loss = recipe.loss_of(&model, case.inputs(), case.draws());
    let gradients = recipe.backward(&model, loss).into_host(&model);
    let infos = parameters::infos(&model);
    let stored = case
        .golden
        .names_under(&format!("truncgrad64.{}.", case.name));
    for name in stored {
        let index = infos.iter().position(|info| info.name == name);
        let gradient = &gradients[index.expect("a parameter")];
        // These have no tolerance of their own; the decoder's applies, because they pass through
        // it.
        case.golden
            .get(&format!("truncgrad64.{}.{name}", case.name))
            .assert_close_f32(
                &format!("truncated d {name}"),
                gradient,
                case.decoder_tolerance(),
            );
    }
}

/// Records every call of a network, and makes the gradient of its output readable.
struct Noting<'a> {
    unet: &'a UNet1d,
    calls: RefCell<Vec<Call>>,
}

struct Call {
    x: Tensor<3>,
    output: Tensor<3>,
    place: Tensor<3>,
}

impl Denoiser for Noting<'_> {
    type Cond = AudioCondition;

    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &AudioCondition) -> Tensor<3> {
        let place = x_t.clone().without_autodiff().zeros_like();
        let place = place.autodiff().require_grad();
        let output = self.unet.predict(x_t.clone(), time, cond) + place.clone();
        self.calls.borrow_mut().push(Call {
            x: x_t,
            output: output.clone(),
            place,
        });
        output
    }

    fn null_cond(&self, cond: &AudioCondition) -> AudioCondition {
        self.unet.null_cond(cond)
    }
}

fn rollout(case: &Case) -> Rollout {
    Rollout {
        diffusion: case.diffusion.clone(),
        clip: ClipRange::None,
        guidance: 1.0.into(),
        gradient_decay: 1.0,
    }
}

/// The part of the loss that comes through the rollout.
fn decoded_loss(case: &Case, decoded: &Tensor<3>) -> Tensor<1> {
    let (inputs, config) = (case.inputs(), LossConfig::ccmotion());
    let batch = decoded.dims()[0];
    let weights = Tensor::ones([batch, 1, 1], &case.device);
    let ReconstructionLoss {
        position,
        quaternion,
    } = ReconstructionLoss::new(
        decoded,
        &inputs.x_start,
        &inputs.mask,
        weights,
        config.quaternion_sign,
    );
    let temporal = temporal_losses(decoded, &inputs.mask, &config.temporal);
    let temporal = temporal.into_iter().map(|(_, term)| term);
    let temporal = temporal.reduce(|a, b| a + b).expect("five terms");
    (position + quaternion) * config.w_dec + temporal * config.w_temp
}

/// The network's prediction and the state after each step, the decoded motion, and the gradients
/// of the start noise and of each prediction.
fn states_and_their_gradients(case: &Case) {
    let model = case.model();
    let noting = Noting {
        unet: &model.unet,
        calls: RefCell::default(),
    };
    let timesteps = rollout_timesteps(&case.starts(), case.steps());
    let first: Vec<f64> = timesteps.iter().map(|t| t[0] as f64).collect();
    case.golden
        .compare_exactly(&format!("out.{}.timesteps", case.name), &first);
    let start = case.tensor("in.x_T");
    let cond = AudioCondition::from(case.tensor("in.cond"));
    let output = rollout(case)
        .run(&noting, &noting, start, &cond, &timesteps, Graph::Full)
        .expect("it fits");
    let calls = noting.calls.into_inner();
    let latent = output.x.clone();
    let after: Vec<Tensor<3>> = calls.iter().skip(1).map(|call| call.x.clone()).collect();
    for (index, x) in after.into_iter().chain([latent]).enumerate() {
        case.out(&format!("x_after.{index}"))
            .assert_close_tensor("state", x, 5e-5);
    }
    for (index, call) in calls.iter().enumerate() {
        case.out(&format!("eps.{index}"))
            .assert_close_tensor("eps", call.output.clone(), 5e-5);
    }
    let decoded = model.decoder.forward(output.x, None);
    case.out("decoded")
        .assert_close_tensor("decoded", decoded.clone().swap_dims(1, 2), 5e-5);

    let gradients = decoded_loss(case, &decoded).backward();
    let reference = |name: &str| case.golden.reference(&format!("grad.{}.{name}", case.name));
    let gradient = output.entry.grad(&gradients).expect("a gradient");
    reference("in.x_T").assert_close_tensor("d x_T", gradient, 5e-5);
    for (index, call) in calls.iter().enumerate() {
        let gradient = call.place.grad(&gradients).expect("a gradient");
        reference(&format!("eps.{index}")).assert_close_tensor("d eps", gradient, 5e-4);
    }
}

/// The contribution of each step's network call in the checkpointed backward pass.
fn gradients_of_each_step(case: &Case) {
    let model = case.model();
    let timesteps = rollout_timesteps(&case.starts(), case.steps());
    let (start, rollout) = (case.tensor("in.x_T"), rollout(case));
    let cond = AudioCondition::from(case.tensor("in.cond"));
    let (unet, plain) = (&model.unet, &model.unet.valid());
    let output = rollout
        .run(unet, plain, start, &cond, &timesteps, Graph::Checkpointed)
        .expect("it fits");
    let decoded = model.decoder.forward(output.x, None);
    let mut gradients = decoded_loss(case, &decoded).backward();
    let names: Vec<String> = parameters::infos(unet)
        .into_iter()
        .map(|i| i.name)
        .collect();
    let mut in_steps = 0;
    let trace = output.trace.expect("a checkpointed rollout has one");
    let of_start = trace
        .backward(
            &rollout,
            unet,
            &cond,
            &mut gradients,
            &mut |index, mut local| {
                let of_step = kinegrad_models::gradients(unet, &mut local);
                let prefix = format!("stepgrad64.{}.{index}.unet.", case.name);
                for name in case.golden.names_under(&prefix) {
                    let place = names.iter().position(|n| *n == name).expect("a parameter");
                    case.golden
                        .get(&format!("{prefix}{name}"))
                        .assert_close_f32(&format!("step {index} d {name}"), &of_step[place], 5e-3);
                    in_steps += 1;
                }
                let norms = case.golden.get(&format!("stepgradnorm64.{}", case.name));
                let error = norm_of_squares(&squares(&of_step)) / norms.values[index] - 1.0;
                let what = format!("step {index} norm");
                case.golden.bound(&what, error.abs(), 5e-3);
            },
        )
        .expect("it fits");
    assert_eq!(in_steps, 3 * case.steps());
    case.golden
        .reference(&format!("grad.{}.in.x_T", case.name))
        .assert_close_tensor("d x_T", of_start, 5e-5);
}

/// AdamW with a rate for each network.
fn optimizer_step(case: &Case, gradients: &HashMap<String, Vec<f32>>) {
    let number = |key: &str| -> f64 { case.golden.metadata(key).parse().expect("a number") };
    let config = OptimConfig {
        weight_decay: number("weight_decay"),
        ..OptimConfig::default()
    };
    let before = weights(&case.golden, "model.");
    let name = |of: &str, name: &str| format!("{of}.{}.model.{name}", case.name);
    for parameter in case.golden.names_under(&name("after", "")) {
        let rate = match parameter.starts_with("decoder.") {
            true => number("lr_decoder"),
            false => number("lr_unet"),
        };
        let before = before.iter().find(|each| each.info.name == parameter);
        let before = &before.expect("a parameter").values;
        let mut after = before.clone();
        let mut optimizer = AdamW::new(&config, 0);
        optimizer.begin_step();
        let step = optimizer.step(0, 1.0, rate);
        Moments::zeros(before.len()).update(step, &mut after, &gradients[&parameter], None);
        let mask = case.golden.get(&name("aftermask", &parameter)).values;
        let delta = case.golden.get(&name("delta64", &parameter)).values;
        for (index, mask) in mask.iter().enumerate() {
            if *mask == 0.0 {
                continue;
            }
            let found = f64::from(after[index]) - f64::from(before[index]);
            let ulp = f64::from(before[index].abs() * f32::EPSILON);
            let error = (found - delta[index]).abs();
            assert!(
                error <= ulp + 5e-3 * rate,
                "{parameter}[{index}]: {error:e}"
            );
            compared(1);
        }
    }
}
