//! The text-motion evaluator on clips of different lengths in one array. The tolerance is the
//! reference data's own.

use burn::tensor::{Device, Int, Tensor, TensorData};
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{trials, weights};
use kinegrad_text_motion::network::{PARTS, TextMotionConfig, TextMotionEncoders};

const TOLERANCE: f64 = 8e-5;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_gmd2_motions_of_different_lengths("gmd2/evaluator_lengths.safetensors"),
        golden_gmd2_captions_of_different_lengths("gmd2/evaluator_lengths.safetensors"),
    ]
}

fn encoders(golden: &Golden, device: &Device) -> TextMotionEncoders {
    let parts = PARTS.into_iter().flat_map(|part| {
        let short = part.strip_suffix("_encoder").expect("an encoder");
        let mut weights = weights(golden, &format!("model.{short}."));
        for weight in &mut weights {
            weight.info.name = format!("{part}.{}", weight.info.name);
        }
        weights
    });
    let weights: Vec<_> = parts.collect();
    let config = TextMotionConfig::of_weights(|name| {
        let weight = weights.iter().find(|weight| weight.info.name == name);
        Some(&weight?.info.shape)
    });
    let encoders = config.init(&Initializer::new(0, device));
    parameters::load(encoders, weights).expect("the weights fit")
}

fn golden_gmd2_motions_of_different_lengths(golden: Golden) {
    let device = Device::flex();
    let encoders = encoders(&golden, &device);
    let lengths = golden.get("in.lengths").indices();
    let motions: Tensor<3> = golden.tensor("in.motions", &device);
    let [batch, time, _] = motions.dims();
    // Without contact flags, which are no input of the network.
    let motions = motions
        .narrow(2, 0, encoders.config().channels)
        .swap_dims(1, 2);
    let order = golden.get("out.order").indices();
    // The first `extra` frames after each clip's end keep their content; later frames are zero.
    let with_tail = |extra: usize| {
        let mask = lengths.iter().flat_map(|length| {
            (0..time).map(move |frame| f32::from(u8::from(frame < length + extra)))
        });
        let mask = TensorData::new(mask.collect::<Vec<f32>>(), [batch, 1, time]);
        motions.clone() * Tensor::from_data(mask, &device)
    };
    for (name, extra) in [("zero", 0), ("tail3", 3), ("full", time)] {
        let found = encoders.motions(with_tail(extra), &lengths);
        // The file is ordered by decreasing length.
        for (place, &clip) in order.iter().enumerate() {
            let expected = golden.get(&format!("out.{name}.motion")).part(place);
            let what = format!("{name}, clip {clip}");
            expected.assert_within(&what, found.clone().narrow(0, clip, 1), TOLERANCE, 0.0);
        }
    }
    for (clip, &length) in lengths.iter().enumerate() {
        let alone = motions.clone().narrow(0, clip, 1).narrow(2, 0, length);
        let found = encoders.motions(alone, &[length]);
        let expected = golden.get("out.alone.motion").part(clip);
        expected.assert_within(&format!("alone, clip {clip}"), found, TOLERANCE, 0.0);
    }
}

fn golden_gmd2_captions_of_different_lengths(golden: Golden) {
    let device = Device::flex();
    let encoders = encoders(&golden, &device);
    let lengths = golden.get("in.caption_lengths").indices();
    let words: Tensor<3> = golden.tensor("in.words", &device);
    let classes: Tensor<3> = golden.tensor("in.pos", &device);
    let [batch, tokens, _] = words.dims();
    let classes: Tensor<2, Int> = classes.argmax(2).reshape([batch, tokens]);
    for (name, lengths) in [("text", lengths), ("text_all_tokens", vec![tokens; batch])] {
        let found = encoders.texts(words.clone(), classes.clone(), &lengths);
        let expected = golden.get(&format!("out.{name}"));
        expected.assert_within(name, found, TOLERANCE, 0.0);
    }
}
