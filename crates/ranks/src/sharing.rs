//! Work that ranks share; any rank may fail.

use std::ops::Range;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::Alone;

/// Ranks that share work and exchange their results or failures.
pub trait Sharing<E> {
    /// Number of this rank, from 0.
    fn rank(&self) -> usize;

    /// Number of ranks.
    fn size(&self) -> usize;

    /// Gathers a value of every rank, in rank order. Collective. Fails with this rank's error or
    /// another rank's failure.
    fn exchange(&self, own: Result<Vec<u8>, E>) -> Result<Vec<Vec<u8>>, E>;
}

impl<E> Sharing<E> for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn exchange(&self, own: Result<Vec<u8>, E>) -> Result<Vec<Vec<u8>>, E> {
        own.map(|own| vec![own])
    }
}

/// Computes results of numbered items: `work` takes the items of this rank and returns one result
/// per item. Item n belongs to rank `owner(n)`, modulo the number of ranks. All ranks receive all
/// results in order. Collective. Fails as [`Sharing::exchange`]. Panics if another rank shares
/// other work.
pub fn shared<T, E>(
    sharing: &dyn Sharing<E>,
    numbers: Range<usize>,
    owner: impl Fn(usize) -> usize,
    work: impl FnOnce(Vec<usize>) -> Result<Vec<T>, E>,
) -> Result<Vec<T>, E>
where
    T: Serialize + DeserializeOwned,
{
    let (rank, size) = (sharing.rank(), sharing.size());
    if size == 1 {
        return work(numbers.collect());
    }
    let own = numbers
        .clone()
        .filter(|&number| owner(number) % size == rank);
    let own = work(own.collect());
    let all = sharing.exchange(own.map(|own| to_bytes(&own)))?;
    let all = all.iter().map(|bytes| from_bytes::<Vec<T>>(bytes));
    let mut all: Vec<_> = all.map(Vec::into_iter).collect();
    let each = numbers.map(|number| all[owner(number) % size].next());
    Ok(each
        .map(|result| result.expect("one result of each"))
        .collect())
}

/// A value as bytes, including numbers that are not finite.
pub fn to_bytes(value: &impl Serialize) -> Vec<u8> {
    let mut bytes = Vec::new();
    ciborium::into_writer(value, &mut bytes).expect("plain data");
    bytes
}

/// The value that [`to_bytes`] wrote. Panics for other bytes.
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> T {
    ciborium::from_reader(bytes).expect("bytes of another rank of this program")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The last of three ranks, and the other ranks' results.
    struct Last(Vec<Vec<u8>>);

    impl Sharing<String> for Last {
        fn rank(&self) -> usize {
            2
        }

        fn size(&self) -> usize {
            3
        }

        fn exchange(&self, own: Result<Vec<u8>, String>) -> Result<Vec<Vec<u8>>, String> {
            let mut all = self.0.clone();
            all.push(own?);
            Ok(all)
        }
    }

    #[test]
    fn results_are_in_order_and_unchanged() {
        let broken = [f64::NAN, f64::INFINITY, -0.0, 0.1, f64::MIN_POSITIVE / 2.0];
        let square = |n: usize| (n * n, broken.to_vec());
        let of = |own: &[usize]| to_bytes(&own.iter().map(|&n| square(n)).collect::<Vec<_>>());
        // Rank 0 has two of the four items 10 to 13.
        let last = Last(vec![of(&[10, 13]), of(&[11])]);
        let mut assigned = Vec::new();
        let all = shared(
            &last,
            10..14,
            |n| n + 2,
            |own| {
                assigned.clone_from(&own);
                Ok(own.into_iter().map(square).collect())
            },
        );
        assert_eq!(assigned, [12]);
        let all: Vec<(usize, Vec<f64>)> = all.expect("nothing failed");
        let squares: Vec<usize> = all.iter().map(|(square, _)| *square).collect();
        assert_eq!(squares, [100, 121, 144, 169]);
        for (_, values) in all {
            let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&values[1..]), bits(&broken[1..]));
            assert!(values[0].is_nan());
        }
        let failed = shared::<u8, _>(&last, 0..3, |n| n, |_| Err("a bad file".to_owned()));
        assert_eq!(failed, Err("a bad file".to_owned()));
        let alone = shared::<usize, String>(&Alone, 3..6, |n| n, Ok);
        assert_eq!(alone, Ok(vec![3, 4, 5]));
    }
}
