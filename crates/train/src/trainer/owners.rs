//! Sharding of optimizer states over ranks (ZeRO-1, Rajbhandari et al. 2020,
//! <https://arxiv.org/abs/1910.02054>). A rank owns whole parameters, so that norms are added in
//! the same order as in one process.

use std::cmp::Reverse;

use kinegrad_ranks::{Ranks, Receivers};

/// The rank with the optimizer state and moving average of each parameter.
#[derive(Clone, Debug)]
pub(super) struct Owners {
    rank: usize,
    size: usize,
    /// The rank of each parameter.
    of: Vec<usize>,
    /// Number of elements of each parameter; 0 for a frozen one, whose state all ranks have.
    lengths: Vec<usize>,
}

impl Owners {
    /// Assigns parameters of these lengths, longest first, to the rank with the least load.
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

    /// True if this rank has the state of parameter `index`.
    pub fn has(&self, index: usize) -> bool {
        self.of[index] == self.rank || self.lengths[index] == 0
    }

    /// Number of elements of each rank.
    pub fn loads(&self) -> Vec<usize> {
        let of = |rank| self.of_rank(rank).map(|index| self.lengths[index]);
        (0..self.size).map(|rank| of(rank).sum()).collect()
    }

    /// The parameters of a rank, in order.
    pub fn of_rank(&self, rank: usize) -> impl Iterator<Item = usize> {
        (0..self.of.len()).filter(move |&index| self.of[index] == rank)
    }

    /// Gathers the tensors of all ranks; a rank that does not receive gets only frozen tensors.
    /// Collective.
    pub fn gathered<'a>(
        &self,
        ranks: &dyn Ranks,
        to: Receivers,
        tensors: impl Iterator<Item = &'a Vec<f32>>,
    ) -> Vec<Vec<f32>> {
        let receives = to == Receivers::All || ranks.is_first();
        let gather = |(index, tensor): (usize, &Vec<f32>)| {
            let length = self.lengths[index];
            if length == 0 {
                // All have it.
                return tensor.clone();
            }
            let mut lengths = vec![0; self.size];
            lengths[self.of[index]] = length;
            let mut values = vec![0.0; if receives { length } else { 0 }];
            let own = if self.has(index) { &tensor[..] } else { &[] };
            ranks.gather_into(own, &lengths, to, &mut values);
            values
        };
        tensors.enumerate().map(gather).collect()
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
        assert_eq!(
            owners.gathered(&Alone, Receivers::All, tensors.iter()),
            tensors
        );
        assert_eq!(
            owners.gathered(&Alone, Receivers::First, tensors.iter()),
            tensors
        );
    }
}
