//! Optimiser states of which each rank keeps a part (ZeRO-1, Rajbhandari et al. 2020,
//! <https://arxiv.org/abs/1910.02054>): whole parameters, so that norms are added in the same order as
//! in one process.

use std::cmp::Reverse;

use kinegrad_ranks::{Ranks, Receivers};

/// Which rank keeps the optimiser's state and the moving average of each parameter.
#[derive(Clone, Debug)]
pub(super) struct Owners {
    rank: usize,
    size: usize,
    /// The rank of each parameter.
    of: Vec<usize>,
    /// Elements of each parameter; none of a frozen one, whose state is no rank's alone.
    lengths: Vec<usize>,
}

impl Owners {
    /// Owners of parameters of these lengths: the longest first, to whom has least.
    pub fn new(ranks: &dyn Ranks, lengths: Vec<usize>) -> Self {
        let size = ranks.size();
        let mut order: Vec<usize> = (0..lengths.len()).collect();
        order.sort_by_key(|&index| Reverse(lengths[index]));
        let (mut of, mut loads) = (vec![0; lengths.len()], vec![0usize; size]);
        for index in order {
            let least = (0..size).min_by_key(|&rank| loads[rank]).expect("a rank");
            of[index] = least;
            loads[least] += lengths[index];
        }
        Self {
            rank: ranks.rank(),
            size,
            of,
            lengths,
        }
    }

    /// Whether this rank keeps the state of parameter `index`.
    pub fn has(&self, index: usize) -> bool {
        self.of[index] == self.rank || self.lengths[index] == 0
    }

    /// Elements of the parameters of each rank.
    pub fn loads(&self) -> Vec<usize> {
        let of = |rank| self.of_rank(rank).map(|index| self.lengths[index]);
        (0..self.size).map(|rank| of(rank).sum()).collect()
    }

    /// The parameters of a rank, in order.
    pub fn of_rank(&self, rank: usize) -> impl Iterator<Item = usize> {
        (0..self.of.len()).filter(move |&index| self.of[index] == rank)
    }

    /// All tensors, of those that each rank keeps; to who does not receive them, the frozen ones alone.
    pub fn gathered(
        &self,
        ranks: &dyn Ranks,
        to: Receivers,
        tensors: &[Vec<f32>],
    ) -> Vec<Vec<f32>> {
        let own = self.of_rank(self.rank);
        let own = own.map(|index| &tensors[index][..self.lengths[index]]);
        let own = own.collect::<Vec<_>>().concat();
        let lengths = self.loads();
        let receives = to == Receivers::All || ranks.is_first();
        let mut values = vec![0.0; if receives { lengths.iter().sum() } else { 0 }];
        ranks.gather_into(&own, &lengths, to, &mut values);
        let mut all = self.frozen(tensors);
        if !receives {
            return all;
        }
        let mut rest = &values[..];
        for (rank, length) in lengths.into_iter().enumerate() {
            let (values, behind) = rest.split_at(length);
            self.put(rank, values, &mut all);
            rest = behind;
        }
        all
    }

    /// The tensors of frozen parameters, which all ranks have; empty in the place of the others.
    fn frozen(&self, tensors: &[Vec<f32>]) -> Vec<Vec<f32>> {
        let of = |(tensor, &length): (&Vec<f32>, &usize)| match length {
            0 => tensor.clone(),
            _ => Vec::new(),
        };
        tensors.iter().zip(&self.lengths).map(of).collect()
    }

    /// Puts the values of a rank's tensors in their places.
    fn put(&self, rank: usize, mut values: &[f32], all: &mut [Vec<f32>]) {
        for index in self.of_rank(rank) {
            let (tensor, rest) = values.split_at(self.lengths[index]);
            if !tensor.is_empty() {
                all[index] = tensor.to_vec();
            }
            values = rest;
        }
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_ranks::Alone;

    use super::*;

    #[test]
    fn one_rank_keeps_all_and_gives_it_back() {
        // The second is frozen.
        let tensors = vec![vec![1.0, 2.0], vec![5.0; 3], vec![3.0]];
        let owners = Owners::new(&Alone, vec![2, 0, 1]);
        assert_eq!(owners.gathered(&Alone, Receivers::All, &tensors), tensors);
        assert_eq!(owners.gathered(&Alone, Receivers::First, &tensors), tensors);
    }
}
