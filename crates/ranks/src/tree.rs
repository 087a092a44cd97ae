//! Sums in one order, whoever forms their parts.

/// Sizes of the two parts that a sum of `count` terms is formed of, the larger one first. Halves of an
/// even number are equal: of 2^k ranks that take equally many consecutive terms each forms a branch.
pub fn split(count: u64) -> [u64; 2] {
    let first = count.div_ceil(2);
    [first, count - first]
}

/// Adds `other` to `sum`, term by term.
///
/// # Panics
/// Panics if their lengths differ.
pub fn add(sum: &mut [f32], other: &[f32]) {
    assert_eq!(sum.len(), other.len(), "terms of a sum have one length");
    for (sum, other) in sum.iter_mut().zip(other) {
        *sum += other;
    }
}

/// The sum of some lists of equal length, formed as [`split`] says.
///
/// # Panics
/// Panics without a list, or if their lengths differ.
pub fn pairwise(parts: &mut [Vec<f32>]) -> Vec<f32> {
    match parts {
        [] => panic!("a sum has terms"),
        [part] => std::mem::take(part),
        _ => {
            let [first, _] = split(parts.len() as u64);
            let (left, right) = parts.split_at_mut(first as usize);
            let mut sum = pairwise(left);
            add(&mut sum, &pairwise(right));
            sum
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Terms whose sum depends on the order in which they are added.
    fn terms(count: u64) -> Vec<Vec<f32>> {
        let term = |n: u64| {
            let value =
                |k: u64| ((n * 31 + k * 17) % 97) as f32 * 1e-3 + 10f32.powi((n % 7) as i32);
            (0..5).map(value).collect()
        };
        (0..count).map(term).collect()
    }

    #[test]
    fn up_to_three_terms_are_added_one_after_another() {
        for count in 1..=3 {
            let mut expected = terms(count)[0].clone();
            for term in &terms(count)[1..] {
                add(&mut expected, term);
            }
            assert_eq!(pairwise(&mut terms(count)), expected);
        }
        assert_eq!(split(5), [3, 2]);
    }

    #[test]
    fn branches_of_two_four_and_eight_ranks_are_those_of_one() {
        for count in [8, 16, 24, 40] {
            let whole = pairwise(&mut terms(count));
            for ranks in [2, 4, 8] {
                let terms = terms(count);
                let each = (count / ranks) as usize;
                let parts = terms.chunks(each).map(|part| pairwise(&mut part.to_vec()));
                assert_eq!(
                    pairwise(&mut parts.collect::<Vec<_>>()),
                    whole,
                    "{count} {ranks}"
                );
            }
            let mut in_order = terms(count)[0].clone();
            terms(count)[1..]
                .iter()
                .for_each(|term| add(&mut in_order, term));
            assert_ne!(in_order, whole, "the order matters");
        }
    }
}
