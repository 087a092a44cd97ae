//! The order of items in the endless stream of samples.

use kinegrad_random::{Key, Purpose};

/// Every epoch visits each item once, in a new order.
#[derive(Clone, Debug)]
pub(crate) struct Order {
    seed: u64,
    items: usize,
    /// Cache of the latest epoch and its permutation; empty before the first item.
    latest: (u64, Vec<usize>),
}

impl Order {
    /// The order of a run with this `seed` over at least one item.
    pub fn new(items: usize, seed: u64) -> Self {
        Self {
            seed,
            items,
            latest: (0, Vec::new()),
        }
    }

    /// The item of sample `n`, determined by seed, number of items and `n`.
    pub fn item(&mut self, n: u64) -> usize {
        let epoch = n / self.items as u64;
        let place = (n % self.items as u64) as usize;
        if self.latest.0 != epoch || self.latest.1.is_empty() {
            let key = Key::new(self.seed, Purpose::DataOrder).at(epoch);
            self.latest = (epoch, key.permutation(self.items));
        }
        self.latest.1[place]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_epoch_visits_each_item_once_in_another_order() {
        let mut order = Order::new(9, 4);
        let epochs: Vec<Vec<usize>> = (0..3)
            .map(|epoch| (epoch * 9..epoch * 9 + 9).map(|n| order.item(n)).collect())
            .collect();
        for epoch in &epochs {
            let mut sorted = epoch.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..9).collect::<Vec<_>>());
        }
        assert!(epochs[0] != epochs[1] && epochs[1] != epochs[2]);
        assert_ne!(
            (0..9).map(|n| Order::new(9, 5).item(n)).collect::<Vec<_>>(),
            epochs[0]
        );
    }

    #[test]
    fn any_sample_can_be_made_at_any_time() {
        let mut forward = Order::new(5, 1);
        let samples: Vec<usize> = (0..40).map(|n| forward.item(n)).collect();
        let mut backward = Order::new(5, 1);
        for n in (0..40).rev() {
            assert_eq!(backward.item(n), samples[n as usize]);
        }
    }
}
