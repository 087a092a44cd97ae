//! The order in which an endless stream of samples visits the phrases.

use kinegrad_random::{Key, Purpose};

/// Every epoch visits each phrase once, in an order of its own.
#[derive(Clone, Debug)]
pub(crate) struct Order {
    seed: u64,
    phrases: usize,
    /// The latest epoch asked for and its permutation: a cache, nothing more.
    latest: Option<(u64, Vec<usize>)>,
}

impl Order {
    /// The order of a run with this `seed` over so many phrases, at least one.
    pub fn new(phrases: usize, seed: u64) -> Self {
        Self {
            seed,
            phrases,
            latest: None,
        }
    }

    /// Which phrase is sample `n`. Depends on the seed, the number of phrases and `n` alone.
    pub fn phrase(&mut self, n: u64) -> usize {
        let epoch = n / self.phrases as u64;
        let place = (n % self.phrases as u64) as usize;
        match &self.latest {
            Some((latest, permutation)) if *latest == epoch => permutation[place],
            _ => {
                let key = Key::new(self.seed, Purpose::DataOrder).at(epoch);
                let permutation = key.permutation(self.phrases);
                let phrase = permutation[place];
                self.latest = Some((epoch, permutation));
                phrase
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_epoch_visits_each_phrase_once_in_another_order() {
        let mut order = Order::new(9, 4);
        let epochs: Vec<Vec<usize>> = (0..3)
            .map(|epoch| {
                (epoch * 9..epoch * 9 + 9)
                    .map(|n| order.phrase(n))
                    .collect()
            })
            .collect();
        for epoch in &epochs {
            let mut sorted = epoch.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..9).collect::<Vec<_>>());
        }
        assert!(epochs[0] != epochs[1] && epochs[1] != epochs[2]);
        assert_ne!(
            (0..9)
                .map(|n| Order::new(9, 5).phrase(n))
                .collect::<Vec<_>>(),
            epochs[0]
        );
    }

    #[test]
    fn any_sample_can_be_asked_for_at_any_time() {
        let mut forward = Order::new(5, 1);
        let samples: Vec<usize> = (0..40).map(|n| forward.phrase(n)).collect();
        let mut backward = Order::new(5, 1);
        for n in (0..40).rev() {
            assert_eq!(backward.phrase(n), samples[n as usize]);
        }
    }
}
