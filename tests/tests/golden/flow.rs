//! History encoder, flow-matching predictor and their sampling against the golden files of `flow`.

use std::ops::ControlFlow;

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::flow::integrate;
use kinegrad_diffusion::{
    Dopri5, FlowPrediction, LossType, SamplerConfig, SamplerKind, diffusion_loss, sample_flow,
};
use kinegrad_flow::network::FlowConfig;
use kinegrad_flow::network::{FlowCondition, FlowModel, Hierarchy, History, previous_state};
use kinegrad_models::Initializer;
use kinegrad_models::layers::NormOrder;
use kinegrad_models::parameters;
use kinegrad_motion::humanml::Skeleton;
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_tests::stages::Noted;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{gradients, trials, weights};

const FORWARD: f64 = 2e-5;
const INPUTS: f64 = 1e-6;
/// For inputs that contain a linear map of the text.
const TEXT_INPUTS: f64 = 1e-5;
const SAMPLING: f64 = 5e-5;
const GRADIENT: f64 = 1e-4;

/// The number of heads is not in the files.
const HEADS: usize = 4;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_history_encoder("flow/history_encoder.safetensors"),
        golden_flow_predictor("flow/flow_predictor.safetensors"),
        golden_flow_predictor_prenorm("flow/flow_predictor_prenorm.safetensors"),
        golden_flow_sampling("flow/flow_sampling.safetensors"),
        golden_flow_end_to_end("flow/flow_end_to_end.safetensors"),
    ]
}

/// Networks with the sizes of a file's weights. A part that the file lacks has other sizes.
fn model(golden: &Golden, encoder: &str, predictor: &str, device: &Device) -> FlowModel {
    let other = FlowConfig::tiny();
    let width = |name: String, axis: usize, other: usize| {
        let found = weights::shape(golden, &name);
        found.map_or(other, |shape| shape[axis])
    };
    let of_encoder = |name: &str, axis, other| width(format!("model.{encoder}{name}"), axis, other);
    let of_predictor =
        |name: &str, axis, other| width(format!("model.{predictor}{name}"), axis, other);
    let layer = |index: usize| format!("model.{predictor}transformer.layers.{index}.norm1.weight");
    let layers = (0..).take_while(|&index| weights::shape(golden, &layer(index)).is_some());
    let num_layers = match layers.count() {
        0 => other.num_layers,
        count => count,
    };
    let final_norm = weights::shape(golden, &format!("model.{predictor}transformer.norm.weight"));
    let context_dim = of_encoder("joint_mlp.2.weight", 0, other.context_dim);
    let config = FlowConfig {
        joint_dim: of_encoder("joint_mlp.0.weight", 0, other.joint_dim),
        context_dim: of_predictor("ctx_proj.weight", 1, context_dim),
        gru_dim: of_encoder("gru.weight_hh_l0", 1, other.gru_dim),
        decoder_dim: of_encoder("decoder.0.weight", 0, other.decoder_dim),
        latent_dim: of_predictor("in_proj.weight", 0, other.latent_dim),
        num_layers,
        num_heads: HEADS,
        ff_size: of_predictor("transformer.layers.0.linear1.weight", 0, other.ff_size),
        norm: match final_norm {
            Some(_) => NormOrder::Pre,
            None => NormOrder::Post,
        },
        ..FlowConfig::published()
    };
    let init = Initializer::new(0, device);
    config
        .init(&Skeleton::humanml3d(), &init)
        .expect("networks")
}

/// `[batch, joints, channels]` of a file as `[batch, channels, joints]`, or back.
fn turned(x: Tensor<3>) -> Tensor<3> {
    x.swap_dims(1, 2)
}

/// The inputs of a file's predictor, with the previous state as a leaf of the graph.
fn condition(golden: &Golden, context: Tensor<3>, device: &Device) -> FlowCondition {
    FlowCondition {
        context: turned(context),
        null_context: None,
        previous: turned(golden.tensor("in.prev_state", device)),
        progress: golden.tensor("in.progress", device),
    }
}

/// Compares a stage of shape `[batch, channels, joints]`.
fn compare_turned(golden: &Golden, name: &str, x: Tensor<3>, tolerance: f64) {
    let reference = golden.get(name);
    reference.assert_within(name, turned(x), tolerance, 0.0);
}

/// Compares a stage as it is, or transposed.
fn compare_stage(golden: &Golden, stages: &Noted, name: &str, tolerance: f64) {
    let reference = golden.get(&format!("out.{name}"));
    assert_eq!(stages.shape(name), reference.shape, "{name}: shape");
    reference.assert_within_f32(name, stages.values(name), tolerance, 0.0);
}

fn compare_joint_stage(golden: &Golden, stages: &Noted, name: &str, tolerance: f64) {
    let [batch, channels, joints] = stages.shape(name)[..] else {
        panic!("{name}: {:?}", stages.shape(name))
    };
    let values =
        burn::tensor::TensorData::new(stages.values(name).to_vec(), [batch, channels, joints]);
    let stage = Tensor::from_data(values, &Device::flex());
    compare_turned(golden, &format!("out.{name}"), stage, tolerance);
}

fn golden_history_encoder(golden: Golden) {
    let device = Device::flex().autodiff();
    let encoder = model(&golden, "", "predictor.", &device).encoder;
    let encoder = parameters::load(encoder, weights(&golden, "model.")).expect("the weights fit");
    let frames = golden.tensor::<3>("in.history", &device).require_grad();
    let text = golden.tensor::<2>("in.text", &device).require_grad();
    let duration = golden.tensor::<2>("in.duration", &device).require_grad();
    let [batch, time, _] = frames.dims();
    let history = History {
        frames: turned(frames.clone()),
        lengths: vec![time; batch],
        text: text.clone(),
        duration: Some(duration.clone()),
    };
    let without = encoder.forward(History {
        duration: None,
        ..history.clone()
    });
    compare_turned(&golden, "out.context_no_duration", without, FORWARD);

    let mut stages = Noted::default();
    let context = encoder.forward_stages(history, &mut stages);
    compare_stage(&golden, &stages, "joint_inputs", TEXT_INPUTS);
    for name in ["joint_latents", "gru_sequence", "summary"] {
        compare_stage(&golden, &stages, name, FORWARD);
    }
    compare_turned(&golden, "out.context", context.clone(), FORWARD);

    let loss = (context.clone() * context).mean();
    golden
        .get("out.loss")
        .assert_within("loss", loss.clone(), FORWARD, FORWARD);
    let mut found = loss.backward();
    golden.get("grad.in.history").assert_close_tensor(
        "dhistory",
        frames.grad(&found).expect("part of the loss"),
        GRADIENT,
    );
    for (name, leaf) in [("text", text), ("duration", duration)] {
        let gradient = leaf.grad(&found).expect("part of the loss");
        golden
            .get(&format!("grad.in.{name}"))
            .assert_close_tensor(name, gradient, GRADIENT);
    }
    let computed = kinegrad_models::gradients(&encoder, &mut found);
    gradients::compare(&golden, &encoder, &computed, GRADIENT);
}

fn golden_flow_predictor(golden: Golden) {
    let device = Device::flex().autodiff();
    let predictor = model(&golden, "encoder.", "", &device).predictor;
    let predictor =
        parameters::load(predictor, weights(&golden, "model.")).expect("the weights fit");

    let hierarchy = Hierarchy::of(&Skeleton::humanml3d());
    let wide = |places: &[usize]| places.iter().map(|&place| place as f64).collect::<Vec<_>>();
    golden.compare_exactly("in.chain_id", &wide(&hierarchy.chains));
    golden.compare_exactly("in.depth_id", &wide(&hierarchy.depths));
    let state = previous_state(golden.tensor("in.last_features", &device));
    compare_turned(&golden, "in.prev_state", state, INPUTS);

    // The path and the conversions.
    let t = golden.get("in.t").values;
    let [noise, x_start] = ["in.x0", "in.x1"].map(|name| turned(golden.tensor(name, &device)));
    let x_t = FlowPrediction::add_noise(noise.clone(), x_start.clone(), &t);
    compare_turned(&golden, "out.x_t", x_t.clone(), FORWARD);
    let target = FlowPrediction::Velocity.target(noise.clone(), x_start.clone());
    compare_turned(&golden, "out.v_target", target.clone(), FORWARD);

    let context = golden.tensor::<3>("in.context", &device).require_grad();
    let x = turned(x_t.clone()).require_grad();
    let cond = condition(&golden, context.clone(), &device);
    let at = golden.tensor("in.t", &device);
    let mut stages = Noted::default();
    let v = predictor.forward_stages(turned(x.clone()), at, &cond, &mut stages);
    compare_joint_stage(&golden, &stages, "inputs49", TEXT_INPUTS);
    for name in ["tokens", "encoded"] {
        compare_joint_stage(&golden, &stages, name, FORWARD);
    }
    compare_turned(&golden, "out.v", v.clone(), FORWARD);

    let (velocity, epsilon, sample) = (
        FlowPrediction::Velocity,
        FlowPrediction::Epsilon,
        FlowPrediction::Sample,
    );
    // From the predicted velocity, and from the true noise and data.
    for (name, prediction, from, to) in [
        ("out.eps_from_v", &v, velocity, epsilon),
        ("out.x1_from_v", &v, velocity, sample),
        ("out.v_from_eps", &noise, epsilon, velocity),
        ("out.v_from_x1", &x_start, sample, velocity),
    ] {
        let found = from.convert(prediction.clone(), x_t.clone(), &t, to);
        compare_turned(&golden, name, found, FORWARD);
    }

    let loss = diffusion_loss(v, target, None, None, LossType::Mse);
    golden
        .get("out.loss")
        .assert_within("loss", loss.clone(), FORWARD, FORWARD);
    let mut found = loss.backward();
    for (name, leaf) in [("context", context), ("x_t", x)] {
        let gradient = leaf.grad(&found).expect("part of the loss");
        golden
            .get(&format!("grad.in.{name}"))
            .assert_close_tensor(name, gradient, GRADIENT);
    }
    let computed = kinegrad_models::gradients(&predictor, &mut found);
    gradients::compare(&golden, &predictor, &computed, GRADIENT);
}

fn golden_flow_predictor_prenorm(golden: Golden) {
    let device = Device::flex();
    let predictor = model(&golden, "encoder.", "", &device).predictor;
    let predictor =
        parameters::load(predictor, weights(&golden, "model.")).expect("the weights fit");
    let cond = condition(&golden, golden.tensor("in.context", &device), &device);
    let x_t = turned(golden.tensor("in.x_t", &device));
    let mut stages = Noted::default();
    let at = golden.tensor("in.t", &device);
    let v = predictor.forward_stages(x_t, at, &cond, &mut stages);
    for name in ["tokens", "encoded"] {
        compare_joint_stage(&golden, &stages, name, FORWARD);
    }
    compare_turned(&golden, "out.v", v, FORWARD);
}

/// Compares the states before each step and after the last with those on a file's first axis.
fn compare_states<const D: usize>(golden: &Golden, name: &str, states: Vec<Tensor<D>>) {
    let reference = golden.get(name);
    assert_eq!(states.len(), reference.shape[0], "{name}: states");
    for (index, state) in states.into_iter().enumerate() {
        let expected = reference.part(index).flat();
        expected.assert_within(name, state, SAMPLING, 0.0);
    }
}

fn golden_flow_sampling(golden: Golden) {
    let device = Device::flex();
    let predictor = model(&golden, "encoder.", "", &device).predictor;
    let predictor =
        parameters::load(predictor, weights(&golden, "model.")).expect("the weights fit");
    let cond = condition(&golden, golden.tensor("in.context", &device), &device);
    for (name, kind, evaluations) in [
        ("out.euler8", SamplerKind::Euler, 1),
        ("out.midpoint4", SamplerKind::Midpoint, 2),
        ("out.midpoint8", SamplerKind::Midpoint, 2),
    ] {
        let steps = golden.get(name).shape[0] - 1;
        let config = SamplerConfig::new(kind, steps);
        let noise: Tensor<3> = turned(golden.tensor("in.noise", &device));
        let mut states = vec![noise.clone()];
        let flowed = sample_flow(
            &predictor,
            noise,
            &predictor.prepare(&cond),
            FlowPrediction::Velocity,
            &config,
            &mut |_, x| {
                states.push(x.clone());
                ControlFlow::Continue(())
            },
        );
        assert_eq!(flowed.expect("a pose").evaluations, evaluations * steps);
        compare_states(&golden, name, states.into_iter().map(turned).collect());
    }
    compare_linear(&golden, &device);
}

/// The same solvers on dy/dt = -2y + t.
fn compare_linear(golden: &Golden, device: &Device) {
    let y0: Tensor<1> = golden.tensor("in.linear.y0", device);
    let mut velocity = |y: Tensor<1>, t: f64| Ok(y * -2.0 + t);
    let mut states = vec![y0.clone()];
    let steps = golden.get("out.linear.euler16").shape[0] - 1;
    let config = SamplerConfig::new(SamplerKind::Euler, steps);
    integrate(&mut velocity, y0.clone(), &config, &mut |_, y| {
        states.push(y.clone());
        ControlFlow::Continue(())
    })
    .expect("not stopped");
    compare_states(golden, "out.linear.euler16", states);
    let mut states = vec![y0.clone()];
    let steps = golden.get("out.linear.midpoint16").shape[0] - 1;
    let config = SamplerConfig::new(SamplerKind::Midpoint, steps);
    integrate(&mut velocity, y0.clone(), &config, &mut |_, y| {
        states.push(y.clone());
        ControlFlow::Continue(())
    })
    .expect("not stopped");
    compare_states(golden, "out.linear.midpoint16", states);
    // Order 5: sixteen steps are exact in single precision.
    let config = SamplerConfig::new(SamplerKind::Dopri5(Dopri5::default()), 16);
    let flowed = integrate(&mut velocity, y0, &config, &mut |_, _| {
        ControlFlow::Continue(())
    });
    golden.get("out.linear.exact_at_1").assert_within(
        "exact",
        flowed.expect("not stopped").x,
        1e-6,
        0.0,
    );
}

fn golden_flow_end_to_end(golden: Golden) {
    let device = Device::flex().autodiff();
    let network = model(&golden, "encoder.", "predictor.", &device);
    let network = parameters::load(network, weights(&golden, "model.")).expect("the weights fit");
    let frames = golden.tensor::<3>("in.history", &device).require_grad();
    let [batch, time, channels] = frames.dims();
    let context = network.encoder.forward(History {
        frames: turned(frames.clone()),
        lengths: vec![time; batch],
        text: golden.tensor("in.text", &device),
        duration: Some(golden.tensor("in.duration", &device)),
    });
    let last = frames.clone().narrow(1, time - 1, 1);
    let cond = FlowCondition {
        context,
        null_context: None,
        previous: previous_state(last.reshape([batch, channels])),
        progress: golden.tensor("in.progress", &device),
    };
    let [noise, x_start] = ["in.x0", "in.x1"].map(|name| turned(golden.tensor(name, &device)));
    let t = golden.get("in.t").values;
    let x_t = FlowPrediction::add_noise(noise.clone(), x_start.clone(), &t);
    let at = golden.tensor("in.t", &device);
    let v = network.predictor.forward(x_t, at, &cond);
    compare_turned(&golden, "out.v", v.clone(), FORWARD);
    let target = FlowPrediction::Velocity.target(noise, x_start);
    let loss = diffusion_loss(v, target, None, None, LossType::Mse);
    golden
        .get("out.loss")
        .assert_within("loss", loss.clone(), FORWARD, FORWARD);
    let mut found = loss.backward();
    golden.get("grad.in.history").assert_close_tensor(
        "dhistory",
        frames.grad(&found).expect("part of the loss"),
        GRADIENT,
    );
    let computed = kinegrad_models::gradients(&network, &mut found);
    gradients::compare(&golden, &network, &computed, GRADIENT);
}
