//! The seed of one item's samples.

use kinegrad_random::{Key, Purpose};

/// The seed of the samples for the item `id`. Within a call, samples differ in noise by their
/// number only. Items of separate calls would share noise under one seed.
pub fn item_seed(seed: u64, id: &str) -> u64 {
    Key::new(seed, Purpose::PhraseSeed).named(id).seed()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_and_seeds_have_their_own_noise() {
        let seeds = [(0, "a"), (0, "b"), (1, "a"), (1, "b")].map(|(seed, id)| item_seed(seed, id));
        for (index, seed) in seeds.iter().enumerate() {
            assert!(!seeds[index + 1..].contains(seed));
        }
    }
}
