use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};
use proptest::prelude::*;

use super::cases::distance;
use crate::{Direction, Lengths, Mode, gru, host_values};

/// A recurrent layer and its sizes.
#[derive(Clone, Debug)]
struct Case {
    time: usize,
    batch: usize,
    width: usize,
    direction: Direction,
    /// From 1 to `time`.
    lengths: Option<Vec<usize>>,
    /// True for inputs, weight, bias and initial state with gradients.
    tracked: [bool; 4],
    seed: u64,
}

impl Case {
    /// States and the gradients of tracked tensors.
    fn run(&self, mode: Mode) -> Vec<Vec<f32>> {
        let (time, batch, width) = (self.time, self.batch, self.width);
        let device = Device::flex().autodiff();
        let values = |name: &str, len: usize, scale: f32| -> Vec<f32> {
            let values = Key::new(self.seed, Purpose::Noise).named(name).normals(len);
            values.into_iter().map(|value| scale * value).collect()
        };
        let scale = (width as f32).sqrt().recip();
        let [tracks_inputs, tracks_weight, tracks_bias, tracks_initial] = self.tracked;
        let shape = [time, batch, 3 * width];
        let inputs = TensorData::new(values("inputs", time * batch * 3 * width, 1.5), shape);
        let inputs = Tensor::<3>::from_data(inputs, &device).set_require_grad(tracks_inputs);
        let weight = values("weight", 3 * width * width, scale);
        let weight = TensorData::new(weight, [3 * width, width]);
        let weight = Tensor::<2>::from_data(weight, &device).set_require_grad(tracks_weight);
        let bias = TensorData::new(values("bias", 3 * width, 1.0), [3 * width]);
        let bias = Tensor::<1>::from_data(bias, &device).set_require_grad(tracks_bias);
        let initial = TensorData::new(values("initial", batch * width, 1.0), [batch, width]);
        let initial = Tensor::<2>::from_data(initial, &device).set_require_grad(tracks_initial);
        let cotangent = values("cotangent", time * batch * width, 1.0);
        let cotangent = TensorData::new(cotangent, [time, batch, width]);
        let cotangent = Tensor::<3>::from_data(cotangent, &device);
        let lengths = self.lengths.clone().map(Lengths::new);
        mode.scope(|| {
            let states = gru(
                inputs.clone(),
                weight.clone(),
                bias.clone(),
                initial.clone(),
                lengths.as_ref(),
                self.direction,
            );
            let output = states.clone().inner();
            let gradients = (states * cotangent).sum().backward();
            let mut all = vec![host_values(output)];
            all.extend(
                tracks_inputs.then(|| host_values(inputs.grad(&gradients).expect("tracked"))),
            );
            all.extend(
                tracks_weight.then(|| host_values(weight.grad(&gradients).expect("tracked"))),
            );
            all.extend(tracks_bias.then(|| host_values(bias.grad(&gradients).expect("tracked"))));
            all.extend(
                tracks_initial.then(|| host_values(initial.grad(&gradients).expect("tracked"))),
            );
            all
        })
    }

    /// States without gradients.
    fn infer(&self, mode: Mode) -> Vec<f32> {
        let plain = Self {
            tracked: [true, false, false, false],
            ..self.clone()
        };
        plain.run(mode).swap_remove(0)
    }
}

/// Sizes that are 1, odd, or not a multiple of a vector, a tile or a panel.
fn cases() -> impl Strategy<Value = Case> {
    let sizes = (1..12usize, 1..20usize, 1..70usize);
    let settings = (
        any::<bool>(),
        any::<bool>(),
        any::<[bool; 4]>(),
        any::<u64>(),
    );
    (sizes, settings).prop_map(
        |((time, batch, width), (backward, padded, tracked, seed))| {
            let length = |sequence: usize| 1 + (seed as usize).wrapping_add(5 * sequence) % time;
            let nothing = tracked == [false; 4];
            Case {
                time,
                batch,
                width,
                direction: match backward {
                    true => Direction::Backward,
                    false => Direction::Forward,
                },
                lengths: padded.then(|| (0..batch).map(length).collect()),
                tracked: if nothing { [true; 4] } else { tracked },
                seed,
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn the_kernel_agrees_with_the_composed_operations(case in cases()) {
        let (fused, composed) = (case.run(Mode::Fused), case.run(Mode::Composed));
        prop_assert_eq!(fused.len(), composed.len());
        for (place, (found, expected)) in fused.iter().zip(&composed).enumerate() {
            let error = distance(found, expected);
            let allowed = if place == 0 { 2e-5 } else { 2e-4 };
            prop_assert!(error < allowed, "value {place}: {error:e}");
        }
        prop_assert_eq!(&case.infer(Mode::Fused), &fused[0]);
    }

    #[test]
    fn the_kernel_gives_the_same_bits_with_any_number_of_threads(case in cases()) {
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            let all = pool.install(|| case.run(Mode::Fused)).into_iter().flatten();
            all.map(f32::to_bits).collect::<Vec<u32>>()
        };
        let one = with(1);
        prop_assert_eq!(&one, &with(2));
        prop_assert_eq!(&one, &with(5));
    }

    #[test]
    fn a_sequence_does_not_depend_on_the_others(case in cases()) {
        let of = |case: &Case| case.infer(Mode::Fused);
        let all = of(&case);
        // A different length of the last sequence changes no other sequence.
        let mut lengths = case.lengths.clone().unwrap_or(vec![case.time; case.batch]);
        let last = lengths.last_mut().expect("a sequence");
        *last = 1 + *last % case.time;
        let other = of(&Case { lengths: Some(lengths), ..case.clone() });
        let row = case.width;
        for (index, (a, b)) in all.chunks(row).zip(other.chunks(row)).enumerate() {
            if index % case.batch + 1 < case.batch {
                prop_assert_eq!(a, b);
            }
        }
    }
}
