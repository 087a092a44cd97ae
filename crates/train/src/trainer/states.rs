//! The mutable state of training: weights, optimizer moments and moving average, in main memory or
//! on the device of the networks.

use std::borrow::Cow;
use std::rc::Rc;

use burn::module::Module;
use burn::tensor::{Tensor, TensorData};
use kinegrad_kernels::optimizer::AdamWTensors;
use kinegrad_models::parameters::{self, ParameterInfo};
use kinegrad_ranks::{Ranks, Receivers};

use super::TrainerParts;
use super::exchange::Exchange;
use super::gradients::StepGradients;
use super::owners::Owners;
use super::restore::order_of;
use super::rows::{Layout, Rows};
use crate::checkpoint::Checkpoint;
use crate::config::{EmaConfig, OptimConfig, OptimPlace, WeightDecayGroups};
use crate::optim::{AdamW, Moments};
use crate::parameter_count::is_adapter;
use crate::recipe::Recipe;

/// The optimizer and the moving average with their states.
pub(super) struct States {
    optimizer: AdamW,
    ema: EmaConfig,
    storage: Storage,
}

/// Running means and averages, in the module's order.
enum Storage {
    /// In main memory.
    Host(OnHost),
    /// On the device of the networks.
    Device(OnDevice),
}

/// States in main memory.
struct OnHost {
    /// Running means of the trained parameters of this rank.
    moments: Vec<Moments>,
    /// Averages of all parameters of this rank.
    averages: Vec<Vec<f32>>,
    /// The owners of sharded states.
    owners: Option<Owners>,
    /// The weights, if the networks are on another device, which gets copies.
    weights: Option<Vec<Vec<f32>>>,
}

/// States on the device of the networks.
struct OnDevice {
    weights: Rows,
    exp_avg: Rows,
    exp_avg_sq: Rows,
    averages: Rows,
    /// The weights of frozen parameters, which are their own average.
    frozen: Vec<Vec<f32>>,
}

impl States {
    /// The states of `model` at step 0 or of the checkpoint that `model` was loaded from. `groups`
    /// has the optimizer group of each parameter.
    pub fn new<R: Recipe>(
        model: &R::Model,
        checkpoint: Option<Checkpoint>,
        parts: &TrainerParts<R>,
        infos: &[ParameterInfo],
        groups: &[usize],
    ) -> Self {
        let (optim, ranks) = (&parts.config.optim, parts.group.ranks());
        // Frozen parameters have no running means.
        let lengths = trained_lengths(model);
        let shares = optim.shard_states && ranks.size() > 1;
        let owners = shares.then(|| Owners::new(ranks, lengths.clone()));
        let has = |index: usize| owners.as_ref().is_none_or(|owners| owners.has(index));
        let (steps, moments, averages) = match checkpoint {
            Some(checkpoint) => {
                // The checkpoint is sorted by name.
                let order = order_of(infos, &checkpoint);
                let (mut moments, mut averages) = (checkpoint.moments, checkpoint.ema);
                let taken = order.iter().enumerate().map(|(place, &index)| {
                    let average = std::mem::take(&mut averages[index].values);
                    let moments = std::mem::take(&mut moments[index]);
                    match has(place) {
                        true => (moments, average),
                        false => Default::default(),
                    }
                });
                let (moments, averages) = taken.unzip();
                (checkpoint.state.step, moments, averages)
            }
            None => {
                let lengths = lengths.iter().enumerate();
                let moments = lengths.map(|(index, &length)| match has(index) {
                    true => Moments::zeros(length),
                    false => Moments::default(),
                });
                let mut averages = parameters::values(model);
                let others = (0..infos.len()).filter(|&index| !has(index));
                others.for_each(|index| averages[index] = Vec::new());
                (0, moments.collect::<Vec<_>>(), averages)
            }
        };
        let decaying = infos.iter().map(|info| decays(optim, info)).collect();
        let optimizer = AdamW::new(optim, steps).with_decay_on(decaying);
        let on_device = match optim.offload {
            OptimPlace::Auto => !parts.on_host && ranks.size() == 1,
            OptimPlace::Host => false,
            OptimPlace::Device => true,
        };
        let storage = if on_device {
            let layout = Layout::new(&lengths, |index| {
                (groups[index], decays(optim, &infos[index]))
            });
            let device = parts.device.clone().inner();
            let put = |values: &[Vec<f32>]| Rows::put(&layout, values, &device);
            let (exp_avg, exp_avg_sq): (Vec<_>, Vec<_>) = moments
                .into_iter()
                .map(|moments| (moments.exp_avg, moments.exp_avg_sq))
                .unzip();
            Storage::Device(OnDevice {
                weights: put(&parameters::values(model)),
                exp_avg: put(&exp_avg),
                exp_avg_sq: put(&exp_avg_sq),
                averages: put(&averages),
                frozen: {
                    let frozen = averages.into_iter().zip(&lengths);
                    let frozen = frozen.map(|(values, &length)| match length {
                        0 => values,
                        _ => Vec::new(),
                    });
                    frozen.collect()
                },
            })
        } else {
            Storage::Host(OnHost {
                moments,
                averages,
                owners,
                weights: (!parts.on_host).then(|| parameters::values(model)),
            })
        };
        Self {
            optimizer,
            ema: parts.config.ema.clone(),
            storage,
        }
    }

    /// The layout of gradients on the device of the networks, if the states are there.
    pub fn on_device(&self) -> Option<&Rc<Layout>> {
        match &self.storage {
            Storage::Host(_) => None,
            Storage::Device(states) => Some(&states.weights.layout),
        }
    }

    /// The exchange between several ranks in the steps of `model`.
    pub fn exchange<M: Module>(&self, model: &M, ranks: &dyn Ranks) -> Option<Exchange> {
        let owners = match &self.storage {
            Storage::Host(states) if ranks.size() > 1 => states.owners.clone(),
            _ => return None,
        };
        Some(Exchange::new(ranks, &trained_lengths(model), owners))
    }

    /// A step of AdamW and the moving average, with gradients times `gradient_scale`.
    pub fn update<M: Module>(
        &mut self,
        model: M,
        gradients: &mut StepGradients,
        gradient_scale: f64,
        rates: &[f64],
        ranks: &dyn Ranks,
    ) -> M {
        self.optimizer.begin_step();
        let share = self.ema.share_at(self.optimizer.steps());
        let step = |index| self.optimizer.step(index, gradient_scale, rates[index]);
        match (&mut self.storage, gradients) {
            (Storage::Host(states), StepGradients::Host(gradients)) => {
                states.update(model, |index, parameter, moments, average| {
                    let average = share.map(|share| (average, share));
                    moments.update(step(index), parameter, &gradients[index], average);
                })
            }
            (Storage::Host(states), StepGradients::Ranks(exchange)) => {
                let model = states.update(model, |index, parameter, moments, average| {
                    if exchange.has(index) {
                        let average = share.map(|share| (average, share));
                        let gradient = exchange.gradient(index);
                        moments.update(step(index), parameter, gradient, average);
                        exchange.put(index, parameter);
                    }
                });
                match exchange.gather_weights(ranks) {
                    false => model,
                    true => on_host(model, states.weights.as_mut(), |index, values| {
                        if let Some(weights) = exchange.weights_of_other(index) {
                            values.copy_from_slice(weights);
                        }
                    }),
                }
            }
            (Storage::Device(states), StepGradients::Device(gradients)) => {
                for (row, first) in states.weights.layout.clone().first().enumerate() {
                    let average = states.averages.rows[row].clone();
                    let state = AdamWTensors {
                        parameter: states.weights.rows[row].clone(),
                        exp_avg: states.exp_avg.rows[row].clone(),
                        exp_avg_sq: states.exp_avg_sq.rows[row].clone(),
                        ema: share.map(|share| (average, share)),
                    };
                    let gradient = gradients.rows[row].clone();
                    let state = step(first).update_tensors(state, gradient);
                    states.weights.rows[row] = state.parameter;
                    states.exp_avg.rows[row] = state.exp_avg;
                    states.exp_avg_sq.rows[row] = state.exp_avg_sq;
                    if let Some((average, _)) = state.ema {
                        states.averages.rows[row] = average;
                    }
                }
                parameters::map(model, |index, _| states.weights.part(index))
            }
            _ => unreachable!("gradients are where the states are"),
        }
    }

    /// The averages of all parameters, on the ranks that receive them. Collective.
    pub fn averages(&self, ranks: &dyn Ranks, to: Receivers) -> Cow<'_, [Vec<f32>]> {
        match &self.storage {
            Storage::Host(states) => match &states.owners {
                Some(owners) => owners.gathered(ranks, to, states.averages.iter()).into(),
                None => states.averages.as_slice().into(),
            },
            Storage::Device(states) => {
                let mut averages = states.averages.read();
                for (average, frozen) in averages.iter_mut().zip(&states.frozen) {
                    average.extend(frozen);
                }
                averages.into()
            }
        }
    }

    /// The optimizer's running means of all parameters, on the ranks that receive them. Collective.
    pub fn moments(&self, ranks: &dyn Ranks, to: Receivers) -> Cow<'_, [Moments]> {
        let [exp_avg, exp_avg_sq] = match &self.storage {
            Storage::Host(states) => {
                let Some(owners) = &states.owners else {
                    return states.moments.as_slice().into();
                };
                let moments = states.moments.iter();
                [
                    owners.gathered(ranks, to, moments.clone().map(|each| &each.exp_avg)),
                    owners.gathered(ranks, to, moments.map(|each| &each.exp_avg_sq)),
                ]
            }
            Storage::Device(states) => [states.exp_avg.read(), states.exp_avg_sq.read()],
        };
        let moments = |(exp_avg, exp_avg_sq)| Moments {
            exp_avg,
            exp_avg_sq,
        };
        let pairs = exp_avg.into_iter().zip(exp_avg_sq);
        pairs.map(moments).collect::<Vec<_>>().into()
    }
}

impl OnHost {
    /// Calls `change` with every trained parameter, its running means and its average.
    fn update<M: Module>(
        &mut self,
        model: M,
        mut change: impl FnMut(usize, &mut [f32], &mut Moments, &mut [f32]),
    ) -> M {
        let Self {
            moments,
            averages,
            weights,
            ..
        } = self;
        on_host(model, weights.as_mut(), |index, values| {
            change(index, values, &mut moments[index], &mut averages[index]);
        })
    }
}

/// Number of elements of each parameter; 0 for a frozen one.
fn trained_lengths<M: Module>(model: &M) -> Vec<usize> {
    let infos = parameters::infos(model).into_iter();
    let trained = infos.zip(parameters::trainable(model));
    let lengths = trained.map(|(info, trained)| if trained { info.len() } else { 0 });
    lengths.collect()
}

/// Changes the trained parameters in main memory: in place, or in their copy `weights`.
fn on_host<M: Module>(
    model: M,
    weights: Option<&mut Vec<Vec<f32>>>,
    mut change: impl FnMut(usize, &mut [f32]),
) -> M {
    let Some(weights) = weights else {
        return parameters::update(model, change);
    };
    parameters::map(model, |index, tensor| {
        let values = &mut weights[index];
        change(index, values);
        let data = TensorData::new(values.clone(), [values.len()]);
        Tensor::from_data(data, &tensor.device())
    })
}

/// True if weight decay applies to a parameter.
pub(super) fn decays(optim: &OptimConfig, info: &ParameterInfo) -> bool {
    match optim.weight_decay_groups {
        WeightDecayGroups::All => true,
        WeightDecayGroups::Matrices => info.shape.len() >= 2 && !is_adapter(info),
    }
}
