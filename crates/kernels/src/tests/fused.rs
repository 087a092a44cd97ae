use proptest::prelude::*;

use super::cases::{Case, Memory, Norm, Operation, distance};
use crate::{Activation, Mode};

fn memories() -> impl Strategy<Value = Memory> {
    prop_oneof![
        Just(Memory::Contiguous),
        Just(Memory::ChannelsLast),
        Just(Memory::Part),
        Just(Memory::Flipped)
    ]
}

pub fn norms() -> impl Strategy<Value = Norm> {
    let activations = prop_oneof![
        Just(Activation::None),
        Just(Activation::Silu),
        Just(Activation::Mish)
    ];
    (1..4usize, activations, any::<bool>(), any::<bool>()).prop_map(
        |(group_channels, activation, film, mask)| Norm {
            group_channels,
            activation,
            film,
            mask,
        },
    )
}

fn operations() -> impl Strategy<Value = Operation> {
    let kernels = prop_oneof![Just(1usize), Just(3), Just(5), Just(7)];
    let plain = (
        kernels,
        1..3usize,
        proptest::option::of(any::<bool>()),
        any::<[bool; 2]>(),
    )
        .prop_map(
            |(kernel, stride, upsample, [residual, bias])| Operation::Convolution {
                kernel,
                stride,
                transposed: false,
                upsample,
                norm: None,
                residual,
                bias,
            },
        );
    let normalized =
        (1..3usize, norms(), any::<[bool; 2]>()).prop_map(|(stride, norm, [residual, bias])| {
            Operation::Convolution {
                kernel: 3,
                stride,
                transposed: false,
                upsample: None,
                norm: Some(norm),
                residual,
                bias,
            }
        });
    let transposed =
        (proptest::option::of(norms()), any::<[bool; 2]>()).prop_map(|(norm, [residual, bias])| {
            Operation::Convolution {
                kernel: 4,
                stride: 2,
                transposed: true,
                upsample: None,
                norm,
                residual,
                bias,
            }
        });
    prop_oneof![
        3 => plain,
        3 => normalized,
        2 => transposed,
        2 => norms().prop_map(Operation::GroupNorm),
        2 => (1..4usize, 1..40usize, proptest::option::of(0..6usize)).prop_map(
            |(num_heads, keys, reach)| Operation::CrossAttention { num_heads, keys, reach },
        ),
        1 => (1..4usize).prop_map(|num_heads| Operation::SelfAttention { num_heads }),
        1 => (1..70usize).prop_map(|second| Operation::Concat { second }),
        1 => Just(Operation::Linear),
        1 => Just(Operation::LayerNorm),
        1 => Just(Operation::Gelu),
    ]
}

/// Sizes that are 1, odd, or not a multiple of a vector, a tile or a panel.
pub fn cases() -> impl Strategy<Value = Case> {
    let sizes = (1..4usize, 1..40usize, 1..50usize, 1..140usize);
    let settings = (memories(), any::<u16>(), any::<[bool; 2]>(), any::<u64>());
    (operations(), sizes, settings).prop_map(
        |(
            operation,
            (batch, time, inputs, outputs),
            (memory, tracked, [checkpointing, padded], seed),
        )| {
            let unit = match operation {
                Operation::Convolution {
                    norm: Some(norm), ..
                }
                | Operation::GroupNorm(norm) => norm.group_channels,
                Operation::CrossAttention { num_heads, .. }
                | Operation::SelfAttention { num_heads } => num_heads,
                _ => 1,
            };
            Case {
                operation,
                batch,
                time,
                inputs: inputs.next_multiple_of(unit),
                outputs,
                memory,
                tracked,
                checkpointing,
                padded,
                seed,
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn kernels_agree_with_the_composed_operations(case in cases()) {
        let leaves = case.leaves();
        let fused = case.run(Mode::Fused, &leaves);
        let composed = case.run(Mode::Composed, &leaves);
        let error = distance(&fused.output, &composed.output);
        prop_assert!(error < 2e-5, "output: {error:e}");
        for ((name, found), (_, expected)) in fused.gradients.iter().zip(&composed.gradients) {
            // The gradient of a group of few elements is mostly rounding.
            let few = case.few();
            let error = distance(found, expected);
            prop_assert!(error < 2e-4 || few, "gradient of {name}: {error:e}");
        }
        prop_assert_eq!(&case.infer(Mode::Fused, &leaves), &fused.output);
    }

    #[test]
    fn kernels_give_the_same_bits_with_any_number_of_threads(case in cases()) {
        let leaves = case.leaves();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            let outcome = pool.install(|| case.run(Mode::Fused, &leaves));
            let mut all: Vec<u32> = outcome.output.iter().map(|v| v.to_bits()).collect();
            for (_, gradient) in outcome.gradients {
                all.extend(gradient.iter().map(|v| v.to_bits()));
            }
            all
        };
        let one = with(1);
        prop_assert_eq!(&one, &with(2));
        prop_assert_eq!(&one, &with(5));
    }
}
