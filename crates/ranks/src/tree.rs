//! Sums in one order for any number of ranks.

/// Sizes of the two parts of a sum of `count` terms, the larger part first. An even number is
/// halved, so each of 2^k ranks with the same number of consecutive terms sums a branch.
pub fn split(count: u64) -> [u64; 2] {
    let first = count.div_ceil(2);
    [first, count - first]
}

/// Adds `other` to `sum`, term by term. Panics if their lengths differ.
pub fn add(sum: &mut [f32], other: &[f32]) {
    assert_eq!(sum.len(), other.len(), "terms of a sum have one length");
    for (sum, other) in sum.iter_mut().zip(other) {
        *sum += other;
    }
}

/// Adds concatenated rows of `each` terms in the order of [`split`]. The sum replaces the first
/// row; the other rows are consumed. Panics if `rows` is empty or ends within a row.
pub fn pairwise(rows: &mut [f32], each: usize) {
    let count = rows.len() / each;
    assert_eq!((count.max(1)) * each, rows.len(), "whole rows");
    if count > 1 {
        let [first, _] = split(count as u64);
        let (left, right) = rows.split_at_mut(first as usize * each);
        pairwise(left, each);
        pairwise(right, each);
        add(&mut left[..each], &right[..each]);
    }
}

/// Adds row `own`, number `place` of all rows, and the concatenated `others` in the order of
/// [`pairwise`]. The sum replaces `own`; `others` are consumed. Panics if `others` ends within a
/// row, or `place` is out of range.
pub fn pairwise_with(own: &mut [f32], place: usize, others: &mut [f32]) {
    let each = own.len();
    if each == 0 {
        return;
    }
    let count = others.len() / each + 1;
    assert_eq!((count - 1) * each, others.len(), "whole rows");
    assert!(place < count, "a place among the rows");
    if count > 1 {
        let [first, _] = split(count as u64).map(|rows| rows as usize);
        if place < first {
            let (left, right) = others.split_at_mut((first - 1) * each);
            pairwise_with(own, place, left);
            pairwise(right, each);
            add(own, &right[..each]);
        } else {
            let (left, right) = others.split_at_mut(first * each);
            pairwise(left, each);
            pairwise_with(own, place - first, right);
            add(own, &left[..each]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The sum of some lists.
    fn summed(terms: &[Vec<f32>]) -> Vec<f32> {
        let each = terms[0].len();
        let mut rows = terms.concat();
        pairwise(&mut rows, each);
        rows[..each].to_vec()
    }

    /// Terms whose sum depends on the order of additions.
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
            assert_eq!(summed(&terms(count)), expected);
        }
        assert_eq!(split(5), [3, 2]);
    }

    #[test]
    fn a_separate_row_is_added_at_its_place() {
        for count in 1..=9 {
            let all = terms(count);
            for place in 0..count as usize {
                let (mut own, mut others) = (all[place].clone(), all.clone());
                others.remove(place);
                pairwise_with(&mut own, place, &mut others.concat());
                assert_eq!(own, summed(&all), "{place} of {count}");
            }
        }
        pairwise_with(&mut [], 2, &mut []);
    }

    #[test]
    fn branches_of_two_four_and_eight_ranks_are_those_of_one() {
        for count in [8, 16, 24, 40] {
            let whole = summed(&terms(count));
            for ranks in [2, 4, 8] {
                let terms = terms(count);
                let each = (count / ranks) as usize;
                let parts = terms.chunks(each).map(summed);
                assert_eq!(summed(&parts.collect::<Vec<_>>()), whole, "{count} {ranks}");
            }
            let mut in_order = terms(count)[0].clone();
            terms(count)[1..]
                .iter()
                .for_each(|term| add(&mut in_order, term));
            assert_ne!(in_order, whole, "the order matters");
        }
    }
}
