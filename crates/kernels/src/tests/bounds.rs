use proptest::prelude::*;

use super::cases::{Case, Leaf, Operation, Outcome};
use super::fused::cases;
use super::reference::reference_output;
use crate::Mode;

/// Positions of numbers that are not finite, in output and gradients.
fn broken(outcome: &Outcome) -> Vec<(&'static str, Vec<usize>)> {
    let places = |values: &[f32]| {
        let indexed = values.iter().enumerate();
        indexed
            .filter(|(_, v)| !v.is_finite())
            .map(|(i, _)| i)
            .collect()
    };
    let mut all = vec![("output", places(&outcome.output))];
    for (name, gradient) in &outcome.gradients {
        all.push((name, places(gradient)));
    }
    all
}

fn with_value(leaves: &[Leaf], leaf: usize, element: usize, value: f32) -> Vec<Leaf> {
    let mut leaves = leaves.to_vec();
    let values = &mut leaves[leaf].values;
    let element = element % values.len();
    values[element] = value;
    leaves
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// A value that is not finite reaches all outputs that depend on it, as in the composed
    /// operations. Weights and transposed convolutions are excluded, because kernels and composed
    /// operations multiply other zeros beyond the ends.
    #[test]
    fn values_that_are_not_finite_are_passed_on(
        case in cases(),
        leaf in any::<prop::sample::Index>(),
        element in any::<usize>(),
        value in prop_oneof![Just(f32::NAN), Just(f32::INFINITY), Just(f32::NEG_INFINITY)],
    ) {
        // Kernels do not read padding; the composed operations multiply padding by zero.
        let mut case = Case { padded: false, ..case };
        if let Operation::CrossAttention { reach, .. } = &mut case.operation {
            *reach = None;
        }
        let leaves = case.leaves();
        let leaf = leaf.index(leaves.len());
        let leaves = with_value(&leaves, leaf, element, value);
        let fused = broken(&case.run(Mode::Fused, &leaves));
        let expected = reference_output(&case, &leaves);
        for (element, expected) in expected.iter().enumerate() {
            let found = fused[0].1.contains(&element);
            prop_assert!(found || expected.is_finite(), "output {element} is finite");
        }
        let transposed =
            matches!(case.operation, Operation::Convolution { transposed: true, .. });
        if !transposed && leaves[leaf].name != "weight" {
            let composed = broken(&case.run(Mode::Composed, &leaves));
            if value.is_nan() {
                prop_assert_eq!(fused, composed);
            } else {
                prop_assert_eq!(&fused[0], &composed[0]);
            }
        }
    }

    /// NaN in one sample does not change the outputs of other samples, bit for bit.
    #[test]
    fn samples_are_apart(case in cases().prop_filter("two samples", |c| c.batch > 1)) {
        let leaves = case.leaves();
        let whole = case.infer(Mode::Fused, &leaves);
        let broken = case.infer(Mode::Fused, &with_value(&leaves, 0, 0, f32::NAN));
        let sample = whole.len() / case.batch;
        prop_assert_eq!(&whole[sample..], &broken[sample..]);
    }
}
