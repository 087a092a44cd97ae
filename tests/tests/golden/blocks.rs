//! Time embedding, residual block and attention block against golden file 03_blocks.

use burn::tensor::{Device, Tensor};
use kinegrad_cc_motion::network::attention::AttentionBlock;
use kinegrad_diffusion::Time;
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_models::res_block::{ResBlock, ResBlockConfig};
use kinegrad_models::time_embedding::sinusoidal;
use kinegrad_tests::golden::{Golden, GoldenTensors, Reference, ReferenceTensors};
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{trials, weights};

const OUTPUT: f64 = 2e-6;
const GRADIENT: f64 = 1e-5;

/// A gradient below this is zero in exact arithmetic.
const VANISHING: f64 = 1e-9;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_time_embedding("ccmotion/03_blocks.safetensors"),
        golden_res_block("ccmotion/03_blocks.safetensors"),
        golden_attention_block("ccmotion/03_blocks.safetensors"),
    ]
}

fn golden_time_embedding(golden: Golden) {
    let timesteps = golden.get("in.temb.t").indices();
    for dim in golden.names_under("out.temb.dim") {
        let width = dim.parse().expect("the width ends the name");
        let embedded = sinusoidal(&Time::of(&timesteps), width, &Device::flex());
        let reference = golden.reference(&format!("out.temb.dim{dim}"));
        reference.assert_close_tensor(&dim, embedded, 1e-4);
    }
}

/// Cases whose weights begin with `prefix`, for example `rb_`.
fn cases(golden: &Golden, prefix: &str) -> Vec<String> {
    let names = golden.names_under(&format!("out.{prefix}"));
    let cases = names.iter().filter_map(|name| name.strip_suffix(".y"));
    let cases: Vec<String> = cases.map(|case| format!("{prefix}{case}")).collect();
    assert!(!cases.is_empty(), "no case {prefix}*");
    cases
}

/// Compares the loss of `case` and returns it.
fn compare_loss(golden: &Golden, case: &str, y: Tensor<3>, target: Tensor<3>) -> Tensor<1> {
    let loss = (y - target).square().mean();
    let value = f64::from(loss.clone().into_scalar::<f32>());
    let reference = golden.reference(&format!("out.{case}.loss"));
    reference.assert_close(&format!("{case} loss"), &[value], OUTPUT);
    loss
}

/// Compares the gradients of inputs and parameters of `case`, stored as `grad.{case}.*`.
fn compare_gradients(
    golden: &Golden,
    case: &str,
    inputs: &[(&str, Vec<f32>)],
    infos: &[parameters::ParameterInfo],
    gradients: &[Vec<f32>],
) {
    for (name, gradient) in inputs {
        let reference = golden.reference(&format!("grad.{case}.in.{name}"));
        reference.assert_close_f32(&format!("{case} d{name}"), gradient, GRADIENT);
    }
    for (info, gradient) in infos.iter().zip(gradients) {
        let name = &info.name;
        let reference = golden.reference(&format!("grad.{case}.model.{name}"));
        compare_or_zero(&reference, &format!("{case} d{name}"), gradient);
    }
}

/// A gradient that is zero by construction contains only rounding noise; it is compared absolutely.
fn compare_or_zero(reference: &Reference, what: &str, gradient: &[f32]) {
    let scale = reference.values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if scale > VANISHING {
        reference.assert_close_f32(what, gradient, GRADIENT);
    } else {
        reference.assert_within_f32(what, gradient, 1e-6, 0.0);
    }
}

fn golden_res_block(golden: Golden) {
    let device = Device::flex().autodiff();
    for case in cases(&golden, "rb_") {
        let x = golden
            .tensor::<3>(&format!("in.{case}.x"), &device)
            .require_grad();
        let temb = golden
            .tensor::<2>(&format!("in.{case}.temb"), &device)
            .require_grad();
        let target = golden.tensor::<3>(&format!("in.{case}.target"), &device);
        let (inputs, outputs) = (x.dims()[1], target.dims()[1]);
        let time_rows = golden.get(&format!("model.{case}.time_mlp.1.weight")).shape[0];
        let config = ResBlockConfig {
            time_embed_dim: temb.dims()[1],
            use_scale_shift_norm: time_rows == 2 * outputs,
            dropout: 0.0,
        };
        let block = ResBlock::new(inputs, outputs, &config, 0, &Initializer::new(0, &device));
        let block = parameters::load(block, weights(&golden, &format!("model.{case}.")))
            .expect("the weights fit");

        let y = block.forward(x.clone(), temb.clone(), None, None);
        golden
            .reference(&format!("out.{case}.y"))
            .assert_close_tensor(&case, y.clone(), OUTPUT);
        let mut gradients = compare_loss(&golden, &case, y, target).backward();
        let of = |g: Option<Vec<f32>>| g.expect("a gradient");
        let inputs = [
            (
                "x",
                of(x.grad(&gradients)
                    .map(|g| g.try_into_vec_as().expect("float32"))),
            ),
            (
                "temb",
                of(temb
                    .grad(&gradients)
                    .map(|g| g.try_into_vec_as().expect("float32"))),
            ),
        ];
        let infos = parameters::infos(&block);
        let gradients = kinegrad_models::gradients(&block, &mut gradients);
        compare_gradients(&golden, &case, &inputs, &infos, &gradients);
    }
}

fn golden_attention_block(golden: Golden) {
    let device = Device::flex().autodiff();
    let mut graded = 0;
    for case in cases(&golden, "attn_") {
        // Two cases have no weights of their own; they share those of `attn_cross_len`.
        let own = golden.has(&format!("model.{case}.qkv.weight"));
        let owner = if own { case.as_str() } else { "attn_cross_len" };
        // The case without context shares its input too.
        let has_x = golden.has(&format!("in.{case}.x"));
        let inputs = if has_x {
            case.as_str()
        } else {
            "attn_cross_eq"
        };
        let x = golden
            .tensor::<3>(&format!("in.{inputs}.x"), &device)
            .require_grad();
        let context = golden.has(&format!("in.{case}.context")).then(|| {
            golden
                .tensor::<3>(&format!("in.{case}.context"), &device)
                .require_grad()
        });
        let channels = x.dims()[1];
        let context_dim = golden
            .has(&format!("model.{owner}.kv_cross.weight"))
            .then(|| golden.get(&format!("model.{owner}.kv_cross.weight")).shape[1]);
        let init = Initializer::new(0, &device);
        let block = AttentionBlock::new(channels, 8, context_dim, &init);
        let block = parameters::load(block, weights(&golden, &format!("model.{owner}.")))
            .expect("the weights fit");

        let y = block.forward(x.clone(), context.clone(), None);
        golden
            .reference(&format!("out.{case}.y"))
            .assert_close_tensor(&case, y.clone(), OUTPUT);
        // Two cases are forward only.
        if !golden.has(&format!("out.{case}.loss")) {
            continue;
        }
        graded += 1;
        let target = golden.tensor::<3>(&format!("in.{case}.target"), &device);
        let mut gradients = compare_loss(&golden, &case, y, target).backward();
        let gradient = |tensor: &Tensor<3>| {
            let gradient = tensor.grad(&gradients).expect("a gradient");
            gradient.try_into_vec_as::<f32>().expect("float32")
        };
        let mut inputs = vec![("x", gradient(&x))];
        if let Some(context) = &context {
            inputs.push(("context", gradient(context)));
        }
        let infos = parameters::infos(&block);
        let gradients = kinegrad_models::gradients(&block, &mut gradients);
        compare_gradients(&golden, &case, &inputs, &infos, &gradients);
    }
    assert!(graded > 0, "no case has gradients");
}
