use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_models::layers::NormOrder;
use kinegrad_models::{Initializer, parameters};
use kinegrad_motion::humanml::Skeleton;
use kinegrad_random::{Key, Purpose};

use super::{FlowCondition, FlowConfig, FlowModel, Hierarchy, History, previous_state};

fn normal<const D: usize>(seed: u64, shape: [usize; D]) -> Tensor<D> {
    let values = Key::new(seed, Purpose::Noise).normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn model(config: &FlowConfig) -> FlowModel {
    let init = Initializer::new(5, &Device::flex());
    config.init(&Skeleton::humanml3d(), &init).expect("a model")
}

fn apart<const D: usize>(a: Tensor<D>, b: Tensor<D>) -> f32 {
    (a - b).abs().max().into_scalar()
}

/// Three histories of unequal length.
fn history() -> History {
    History {
        frames: normal(1, [3, 263, 6]),
        lengths: vec![6, 1, 4],
        text: normal(2, [3, 512]),
        duration: Some(normal(3, [3, 1])),
    }
}

#[test]
fn the_documents_sizes_have_the_documents_parameters() {
    let model = model(&FlowConfig::published());
    assert_eq!(parameters::count(&model.encoder), 1_639_648);
    assert_eq!(parameters::count(&model.predictor), 820_131);
}

#[test]
fn the_hierarchy_of_humanml3d_is_the_documents() {
    let hierarchy = Hierarchy::of(&Skeleton::humanml3d());
    assert_eq!(
        hierarchy.chains,
        [
            2, 1, 0, 2, 1, 0, 2, 1, 0, 2, 1, 0, 2, 4, 3, 2, 4, 3, 4, 3, 4, 3
        ]
    );
    assert_eq!(
        hierarchy.depths,
        [
            0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5, 5, 6, 6, 7, 7
        ]
    );
    assert_eq!((hierarchy.num_chains(), hierarchy.num_depths()), (5, 8));
    let kit = Hierarchy::of(&Skeleton::kit());
    assert_eq!(kit.chains.len(), 21);
    assert_eq!(kit.num_chains(), 5);
}

#[test]
fn a_history_is_encoded_as_if_it_were_alone() {
    let model = model(&FlowConfig::tiny());
    let all = history();
    let together = model.encoder.forward(all.clone());
    assert_eq!(together.dims(), [3, 16, 22]);
    for (item, &length) in all.lengths.iter().enumerate() {
        let alone = model.encoder.forward(History {
            frames: all.frames.clone().narrow(0, item, 1).narrow(2, 0, length),
            lengths: vec![length],
            text: all.text.clone().narrow(0, item, 1),
            duration: all.duration.clone().map(|d| d.narrow(0, item, 1)),
        });
        let error = apart(alone, together.clone().narrow(0, item, 1));
        assert!(error < 1e-6, "history {item}: {error}");
    }
}

#[test]
fn frames_text_and_duration_change_the_context() {
    let model = model(&FlowConfig::tiny());
    let (given, context) = (history(), model.encoder.forward(history()));
    let changed = [
        History {
            frames: given.frames.clone() + 0.5,
            ..given.clone()
        },
        History {
            frames: given.frames.clone().flip([2]),
            ..given.clone()
        },
        History {
            lengths: vec![6, 2, 4],
            ..given.clone()
        },
        History {
            text: given.text.zeros_like(),
            ..given.clone()
        },
        History {
            duration: None,
            ..given.clone()
        },
    ];
    for (index, changed) in changed.into_iter().enumerate() {
        let difference = apart(model.encoder.forward(changed), context.clone());
        assert!(difference > 1e-4, "change {index}: {difference}");
    }
}

#[test]
fn every_condition_and_both_norm_orders_change_the_velocity() {
    let cond = FlowCondition {
        context: normal(1, [2, 16, 22]),
        null_context: None,
        previous: previous_state(normal(2, [2, 263])),
        progress: Tensor::from_data([0.2f32, 0.9], &Device::flex()),
    };
    let (x_t, t) = (
        normal(3, [2, 3, 22]),
        Tensor::from_data([0.1f32, 0.7], &Device::flex()),
    );
    for norm in [NormOrder::Post, NormOrder::Pre] {
        let model = model(&FlowConfig {
            norm,
            ..FlowConfig::tiny()
        });
        let forward = |x_t: &Tensor<3>, t: &Tensor<1>, cond: &FlowCondition| {
            model.predictor.forward(x_t.clone(), t.clone(), cond)
        };
        let v = forward(&x_t, &t, &cond);
        assert_eq!(v.dims(), [2, 3, 22]);
        let changed = [
            forward(&(x_t.clone() + 0.3), &t, &cond),
            forward(&x_t, &(t.clone() + 0.2), &cond),
            forward(
                &x_t,
                &t,
                &FlowCondition {
                    context: cond.context.clone() + 0.3,
                    ..cond.clone()
                },
            ),
            forward(
                &x_t,
                &t,
                &FlowCondition {
                    previous: cond.previous.clone() + 0.3,
                    ..cond.clone()
                },
            ),
            forward(
                &x_t,
                &t,
                &FlowCondition {
                    progress: cond.progress.clone() + 0.5,
                    ..cond.clone()
                },
            ),
        ];
        for (index, changed) in changed.into_iter().enumerate() {
            let difference = apart(changed, v.clone());
            assert!(difference > 1e-4, "{norm:?}, change {index}: {difference}");
        }
    }
}

#[test]
fn the_state_before_has_the_root_at_its_height_unturned() {
    let last = normal(4, [2, 263]);
    let state = previous_state(last.clone());
    assert_eq!(state.dims(), [2, 12, 22]);
    let of = |sample: usize, joint: usize| -> Vec<f32> {
        let joint = state.clone().narrow(0, sample, 1).narrow(2, joint, 1);
        joint.into_data().try_to_vec().expect("float32")
    };
    let row: Vec<f32> = last
        .narrow(0, 1, 1)
        .into_data()
        .try_to_vec()
        .expect("float32");
    let expected = [
        &[0.0, row[3], 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        &row[193..196],
    ];
    assert_eq!(of(1, 0), expected.concat());
    let expected = [
        &row[4 + 6..4 + 9],
        &row[67 + 12..67 + 18],
        &row[193 + 9..193 + 12],
    ];
    assert_eq!(of(1, 3), expected.concat());
}

#[test]
fn parts_of_the_document_can_be_left_out() {
    let (x_t, t) = (normal(1, [2, 3, 22]), normal::<1>(2, [2]));
    let tiny = FlowConfig::tiny();
    let whole = model(&tiny);
    let of = |config: FlowConfig| {
        let model = model(&config);
        let counts = [
            parameters::count(&model.encoder),
            parameters::count(&model.predictor),
        ];
        let cond = |progress| FlowCondition {
            context: normal(4, [2, tiny.context_dim, 22]),
            null_context: None,
            previous: normal(5, [2, 12, 22]),
            progress: Tensor::full([2], progress, &Device::flex()),
        };
        let forward = |progress| {
            model
                .predictor
                .forward(x_t.clone(), t.clone(), &cond(progress))
        };
        let depends = apart(forward(0.25), forward(0.75)) > 0.0;
        let context = model.encoder.forward(history());
        assert_eq!(context.dims(), [3, tiny.context_dim, 22]);
        (counts, depends)
    };
    let [encoder, predictor] = [
        parameters::count(&whole.encoder),
        parameters::count(&whole.predictor),
    ];
    assert_eq!(of(tiny.clone()), ([encoder, predictor], true));
    // 5 chains and 8 depths.
    let found = of(FlowConfig {
        hierarchy: false,
        ..tiny.clone()
    });
    assert_eq!(found, ([encoder, predictor - 13 * tiny.latent_dim], true));
    let found = of(FlowConfig {
        progress: false,
        ..tiny.clone()
    });
    assert_eq!(found, ([encoder, predictor], false));
    let of_direction = 3 * tiny.gru_dim * (22 * tiny.context_dim + tiny.gru_dim + 2);
    let found = of(FlowConfig {
        bidirectional: false,
        ..tiny.clone()
    });
    let less = of_direction + tiny.gru_dim * tiny.decoder_dim;
    assert_eq!(found, ([encoder - less, predictor], true));
}
