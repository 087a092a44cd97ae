//! Gated recurrent units: a task computes all steps of some sequences, so that no step waits for
//! another thread.

use pulp::Simd;

use super::convolution::column_sums;
use super::outer::outer;
use super::packing::{self, Weight};
use super::product::{TILE_ROWS, TileWork, Windows, panel_width, tile};
use super::rows::{Rows, SharedRows};
use super::simd::{exp, sigmoid};
use super::team;
use crate::lengths::frames_of;
use crate::recurrence::Direction;

/// Vectors stored per step for the backward pass: reset, update and new gates, and the state's part
/// of the new gate before its reset.
const SAVED: usize = 4;

/// Sizes and direction of a recurrent layer.
#[derive(Clone, Copy, Debug)]
pub struct GruPlan {
    /// Steps.
    pub time: usize,
    /// Sequences.
    pub batch: usize,
    /// Width of the state.
    pub width: usize,
    /// Direction in time.
    pub direction: Direction,
}

/// The values of a recurrent layer on the host.
#[derive(Clone, Copy)]
pub struct GruValues<'a> {
    /// The inputs' part of the gates, `[time, batch, 3 width]`.
    pub inputs: &'a [f32],
    /// `[3 width, width]`.
    pub weight: &'a [f32],
    /// `[3 width]`.
    pub bias: &'a [f32],
    /// `[batch, width]`.
    pub initial: &'a [f32],
    /// Steps of each sequence.
    pub lengths: Option<&'a [usize]>,
}

impl GruPlan {
    /// The state after each step, `[time, batch, width]`, and with `save` the gates for the
    /// backward pass.
    pub fn forward(&self, values: &GruValues<'_>, save: bool) -> (Vec<f32>, Vec<f32>) {
        let (steps, width) = (self.time * self.batch, self.width);
        let mut states = vec![0.0; steps * width];
        let mut gates = vec![0.0; if save { steps * SAVED * width } else { 0 }];
        let packed = packed(values.weight, [3 * width, width], false);
        let states_rows = SharedRows::dense(&mut states, [self.time, self.batch, width]);
        let gates_rows =
            save.then(|| SharedRows::dense(&mut gates, [self.time, self.batch, SAVED * width]));
        team::for_each(self.batch.div_ceil(TILE_ROWS), |block| {
            let block = ForwardBlock {
                plan: self,
                values,
                packed: &packed,
                first: block * TILE_ROWS,
                states: states_rows,
                gates: gates_rows,
            };
            block.dispatch();
        });
        (states, gates)
    }

    /// The gradients of inputs, weight, bias and initial state, from the gradient of all states,
    /// `[time, batch, width]`, and the states and gates of [`forward`](Self::forward).
    pub fn backward(
        &self,
        values: &GruValues<'_>,
        (states, gates): (&[f32], &[f32]),
        gradient: &[f32],
    ) -> [Vec<f32>; 4] {
        let (steps, width) = (self.time * self.batch, self.width);
        let before = self.states_before(states, values.initial);
        let mut inputs = vec![0.0; steps * 3 * width];
        let mut recurrent = vec![0.0; steps * 3 * width];
        let mut initial = vec![0.0; self.batch * width];
        let packed = packed(values.weight, [3 * width, width], true);
        let shape = [self.time, self.batch, 3 * width];
        let inputs_rows = SharedRows::dense(&mut inputs, shape);
        let recurrent_rows = SharedRows::dense(&mut recurrent, shape);
        let blocks = initial.chunks_mut(TILE_ROWS * width).enumerate().collect();
        team::for_each_item(blocks, |(block, initial): (usize, &mut [f32])| {
            let block = BackwardBlock {
                plan: self,
                values,
                packed: &packed,
                first: block * TILE_ROWS,
                gates,
                before: &before,
                gradient,
                inputs: inputs_rows,
                recurrent: recurrent_rows,
                carry: initial,
            };
            block.dispatch();
        });
        let recurrent = Rows::dense(&recurrent, [1, steps, 3 * width]);
        let windows = Windows {
            data: &before,
            batch: 1,
            rows: steps,
            sample_stride: steps * width,
            row_stride: width,
            depth: width,
        };
        let weight = outer(recurrent, windows, 1);
        [inputs, weight, column_sums(recurrent), initial]
    }

    /// The state before each step.
    fn states_before(&self, states: &[f32], initial: &[f32]) -> Vec<f32> {
        let size = self.batch * self.width;
        let end = states.len() - size;
        match self.direction {
            Direction::Forward => [initial, &states[..end]].concat(),
            Direction::Backward => [&states[size..], initial].concat(),
        }
    }

    /// The sequences of a block from `first` on.
    fn sequences(&self, first: usize) -> usize {
        TILE_ROWS.min(self.batch - first)
    }
}

/// A weight `[outer, inner]`, packed for products with its lines, or with its columns.
fn packed(data: &[f32], [outer, inner]: [usize; 2], columns: bool) -> Vec<f32> {
    let weight = Weight {
        data,
        shape: [outer, inner, 1],
        direction: match columns {
            true => packing::Direction::Scatter(&[0]),
            false => packing::Direction::Gather,
        },
    };
    weight.packed(panel_width())
}

/// Rows of `depth` times packed panels; the result has rows of full panels.
#[inline(always)]
fn multiply<S: Simd, const NR: usize>(
    simd: S,
    rows: &[f32],
    depth: usize,
    packed: &[f32],
    into: &mut [f32],
) {
    let width = NR * S::F32_LANES;
    let stride = packed.len() / depth;
    let rows: [&[f32]; TILE_ROWS] = std::array::from_fn(|i| &rows[i * depth..][..depth]);
    for (index, panel) in packed.chunks_exact(depth * width).enumerate() {
        let panel = pulp::as_arrays::<NR, _>(S::as_simd_f32s(panel).0).0;
        let sums = tile(simd, rows, panel);
        for (row, sums) in into.chunks_exact_mut(stride).zip(&sums) {
            let lanes = row[index * width..][..width].chunks_exact_mut(S::F32_LANES);
            for (out, sum) in lanes.zip(sums) {
                simd.partial_store_f32s(out, *sum);
            }
        }
    }
}

/// `tanh(x)`.
#[inline(always)]
fn tanh(x: f32) -> f32 {
    1.0 - 2.0 / (1.0 + exp(2.0 * x))
}

/// All steps of some sequences.
struct ForwardBlock<'a> {
    plan: &'a GruPlan,
    values: &'a GruValues<'a>,
    packed: &'a [f32],
    first: usize,
    states: SharedRows<'a>,
    gates: Option<SharedRows<'a>>,
}

impl TileWork for ForwardBlock<'_> {
    #[inline(always)]
    fn run<S: Simd, const NR: usize>(self, simd: S) {
        let GruPlan { time, width, .. } = *self.plan;
        let sequences = self.plan.sequences(self.first);
        // Rows beyond the last sequence stay zero.
        let mut state = vec![0.0; TILE_ROWS * width];
        let initial = &self.values.initial[self.first * width..][..sequences * width];
        state[..sequences * width].copy_from_slice(initial);
        let stride = self.packed.len() / width;
        let mut recurrent = vec![0.0; TILE_ROWS * stride];
        let mut unsaved = vec![0.0; SAVED * width];
        for step in self.plan.direction.steps(time) {
            multiply::<S, NR>(simd, &state, width, self.packed, &mut recurrent);
            for i in 0..sequences {
                let sequence = self.first + i;
                let state = &mut state[i * width..][..width];
                if step < frames_of(self.values.lengths, sequence, time) {
                    let saved = match &self.gates {
                        // SAFETY: a task owns its sequences, and this is its only slice of the row.
                        #[allow(unsafe_code)]
                        Some(gates) => unsafe { gates.segment(step, sequence, 0, SAVED * width) },
                        None => &mut unsaved[..],
                    };
                    self.step(step, sequence, &recurrent[i * stride..], (state, saved));
                }
                // SAFETY: a task owns its sequences, and this is its only slice of the row.
                #[allow(unsafe_code)]
                let out = unsafe { self.states.segment(step, sequence, 0, width) };
                out.copy_from_slice(state);
            }
        }
    }
}

impl ForwardBlock<'_> {
    /// Updates the state of one sequence by a step and saves its gates. `recurrent` is the state's
    /// part of the gates.
    #[inline(always)]
    fn step(
        &self,
        step: usize,
        sequence: usize,
        recurrent: &[f32],
        (state, saved): (&mut [f32], &mut [f32]),
    ) {
        let width = self.plan.width;
        let row = step * self.plan.batch + sequence;
        let inputs = &self.values.inputs[row * 3 * width..][..3 * width];
        let (ir, iz, inew) = thirds(inputs, width);
        let (hr, hz, hnew) = thirds(recurrent, width);
        let (br, bz, bnew) = thirds(self.values.bias, width);
        let (resets, saved) = saved.split_at_mut(width);
        let (updates, saved) = saved.split_at_mut(width);
        let (news, parts) = saved.split_at_mut(width);
        for c in 0..width {
            let reset = sigmoid(ir[c] + hr[c] + br[c]);
            let update = sigmoid(iz[c] + hz[c] + bz[c]);
            let of_state = hnew[c] + bnew[c];
            let new = tanh(inew[c] + reset * of_state);
            state[c] = new + update * (state[c] - new);
            (resets[c], updates[c], news[c], parts[c]) = (reset, update, new, of_state);
        }
    }
}

/// Three parts of `width` numbers.
#[inline(always)]
fn thirds(of: &[f32], width: usize) -> (&[f32], &[f32], &[f32]) {
    (
        &of[..width],
        &of[width..2 * width],
        &of[2 * width..3 * width],
    )
}

/// All steps of some sequences, in reverse.
struct BackwardBlock<'a> {
    plan: &'a GruPlan,
    values: &'a GruValues<'a>,
    packed: &'a [f32],
    first: usize,
    gates: &'a [f32],
    before: &'a [f32],
    gradient: &'a [f32],
    inputs: SharedRows<'a>,
    recurrent: SharedRows<'a>,
    /// The gradient of the state before the current step.
    carry: &'a mut [f32],
}

impl TileWork for BackwardBlock<'_> {
    #[inline(always)]
    fn run<S: Simd, const NR: usize>(mut self, simd: S) {
        let GruPlan {
            time, batch, width, ..
        } = *self.plan;
        let sequences = self.plan.sequences(self.first);
        let stride = self.packed.len() / (3 * width);
        let mut slopes = vec![0.0; TILE_ROWS * 3 * width];
        let mut through = vec![0.0; TILE_ROWS * stride];
        for step in self.plan.direction.steps(time).rev() {
            for i in 0..sequences {
                let row = step * batch + self.first + i;
                let carry = &mut self.carry[i * width..][..width];
                for (carry, gradient) in carry.iter_mut().zip(&self.gradient[row * width..]) {
                    *carry += gradient;
                }
                let slopes = &mut slopes[i * 3 * width..][..3 * width];
                slopes.fill(0.0);
                if step < frames_of(self.values.lengths, self.first + i, time) {
                    self.step(step, i, slopes);
                }
            }
            multiply::<S, NR>(simd, &slopes, 3 * width, self.packed, &mut through);
            for (carry, through) in self
                .carry
                .chunks_exact_mut(width)
                .zip(through.chunks_exact(stride))
            {
                for (carry, through) in carry.iter_mut().zip(through) {
                    *carry += through;
                }
            }
        }
    }
}

impl BackwardBlock<'_> {
    /// The gradients of one sequence's gates in a step; `slopes` gets the gradients of the state's
    /// part, and `carry` keeps the part that bypasses the gates.
    #[inline(always)]
    fn step(&mut self, step: usize, i: usize, slopes: &mut [f32]) {
        let width = self.plan.width;
        let sequence = self.first + i;
        let row = step * self.plan.batch + sequence;
        let saved = &self.gates[row * SAVED * width..][..SAVED * width];
        let (resets, updates, news) = thirds(saved, width);
        let parts = &saved[3 * width..];
        let before = &self.before[row * width..][..width];
        let carry = &mut self.carry[i * width..][..width];
        // SAFETY: a task owns its sequences, and these are its only slices of the rows.
        #[allow(unsafe_code)]
        let (inputs, recurrent) = unsafe {
            (
                self.inputs.segment(step, sequence, 0, 3 * width),
                self.recurrent.segment(step, sequence, 0, 3 * width),
            )
        };
        for c in 0..width {
            let (reset, update, new) = (resets[c], updates[c], news[c]);
            let d_new = carry[c] * (1.0 - update) * (1.0 - new * new);
            let d_update = carry[c] * (before[c] - new) * update * (1.0 - update);
            let d_reset = d_new * parts[c] * reset * (1.0 - reset);
            carry[c] *= update;
            inputs[c] = d_reset;
            inputs[width + c] = d_update;
            inputs[2 * width + c] = d_new;
            slopes[c] = d_reset;
            slopes[width + c] = d_update;
            slopes[2 * width + c] = d_new * reset;
        }
        recurrent.copy_from_slice(slopes);
    }
}
