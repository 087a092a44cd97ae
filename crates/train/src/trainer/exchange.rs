//! The exchange of a step: gradients, and with sharded optimizer state also new weights.

use std::ops::Range;

use kinegrad_kernels::optimizer::{self, sum_of_squares};
use kinegrad_ranks::Ranks;

use super::owners::Owners;
use crate::process_group::{ProcessGroup, Tag};

/// The concatenated gradients of all trained parameters, in memory reused between steps.
#[derive(Debug)]
pub(super) struct Exchange {
    /// The range of each parameter; empty for a frozen one.
    places: Vec<Range<usize>>,
    /// Number of elements that each rank adds up, in order.
    lengths: Vec<usize>,
    /// The first element that this rank adds up.
    first: usize,
    /// The owners of sharded states: each rank adds up the gradients of its own parameters only.
    owners: Option<Owners>,
    all: Vec<f32>,
    /// Buffers received from or sent to other ranks.
    received: Vec<f32>,
}

impl Exchange {
    /// The exchange of parameters with these lengths, 0 for frozen parameters. Each rank adds up
    /// its own parameters or, without owners, an equal share of the elements.
    pub fn new(ranks: &dyn Ranks, lengths: &[usize], owners: Option<Owners>) -> Self {
        let mut places = vec![0..0; lengths.len()];
        let mut end = 0;
        let mut put = |index: usize| {
            places[index] = end..end + lengths[index];
            end += lengths[index];
        };
        let lengths = match &owners {
            Some(owners) => {
                (0..ranks.size()).for_each(|rank| owners.of_rank(rank).for_each(&mut put));
                owners.loads()
            }
            None => {
                (0..lengths.len()).for_each(&mut put);
                let share = end.div_ceil(ranks.size());
                let of = |rank: usize| end.saturating_sub(rank * share).min(share);
                (0..ranks.size()).map(of).collect()
            }
        };
        Self {
            places,
            first: lengths[..ranks.rank()].iter().sum(),
            lengths,
            owners,
            all: Vec::new(),
            received: Vec::new(),
        }
    }

    /// Adds `gradients` over the ranks and divides by `divisor`. Collective.
    pub fn sum(&mut self, ranks: &dyn Ranks, gradients: Vec<Vec<f32>>, divisor: f64) {
        self.all.resize(self.lengths.iter().sum(), 0.0);
        for (gradient, place) in gradients.into_iter().zip(&self.places) {
            if !place.is_empty() {
                self.all[place.clone()].copy_from_slice(&gradient);
            }
        }
        ranks.scatter_sums(&mut self.all, &self.lengths, &mut self.received);
        let own = self.first..self.first + self.lengths[ranks.rank()];
        optimizer::divide(&mut self.all[own], divisor);
        if self.owners.is_none() {
            ranks.gather_parts(&mut self.all, &self.lengths, &mut self.received);
        }
    }

    /// True if this rank updates parameter `index`.
    pub fn has(&self, index: usize) -> bool {
        self.owners.as_ref().is_none_or(|owners| owners.has(index))
    }

    /// The gradient of a parameter that this rank updates.
    pub fn gradient(&self, index: usize) -> &[f32] {
        &self.all[self.places[index].clone()]
    }

    /// The sum of the squares of each parameter's gradient. Collective.
    pub fn squares(&self, group: &ProcessGroup) -> Vec<f64> {
        let mut squares = vec![0.0; self.places.len()];
        let own =
            (0..squares.len()).filter(|&index| self.has(index) && !self.places[index].is_empty());
        for index in own {
            squares[index] = sum_of_squares(self.gradient(index));
        }
        let Some(owners) = &self.owners else {
            return squares;
        };
        let own = owners.of_rank(group.ranks().rank());
        let own: Vec<u8> = own.flat_map(|index| squares[index].to_le_bytes()).collect();
        for (rank, squared) in group.gather(Tag::Squares, &own).iter().enumerate() {
            let (numbers, _) = squared.as_chunks::<8>();
            for (index, number) in owners.of_rank(rank).zip(numbers) {
                squares[index] = f64::from_le_bytes(*number);
            }
        }
        squares
    }

    /// Replaces the gradient of a parameter by the new weights, if states are sharded.
    pub fn put(&mut self, index: usize, weights: &[f32]) {
        if self.owners.is_some() {
            self.all[self.places[index].clone()].copy_from_slice(weights);
        }
    }

    /// Gathers the new weights; returns false if states are not sharded. Collective.
    pub fn gather_weights(&mut self, ranks: &dyn Ranks) -> bool {
        let shares = self.owners.is_some();
        if shares {
            ranks.gather_parts(&mut self.all, &self.lengths, &mut self.received);
        }
        shares
    }

    /// The gathered weights of a parameter that another rank updated.
    pub fn weights_of_other(&self, index: usize) -> Option<&[f32]> {
        (!self.has(index)).then(|| &self.all[self.places[index].clone()])
    }
}
