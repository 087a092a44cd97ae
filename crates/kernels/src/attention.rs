use burn::backend::Dispatch;
use burn::tensor::Tensor;

use crate::backend::{FusedOps, Options};
use crate::composed;
use crate::mode::fuses;
use crate::{KeyRanges, Lengths};

/// `softmax(queries keys^T / sqrt(head channels)) values` for each head. The channels of a head are
/// contiguous; `keys_values` contains the keys, then the values.
///
/// With `lengths`, the queries of a sample attend to valid keys only. The CPU stores no scores for
/// the backward pass.
///
/// # Shapes
/// - queries, output: `[batch, channels, time]`
/// - keys_values: `[batch, 2 channels, keys]`
///
/// # Panics
/// Panics if the channels do not divide into the heads.
pub fn cross_attention(
    queries: Tensor<3>,
    keys_values: Tensor<3>,
    num_heads: usize,
    lengths: Option<&Lengths>,
) -> Tensor<3> {
    cross(queries, keys_values, num_heads, lengths.into())
}

/// [`cross_attention`] in which each query attends to a range of keys; an empty range gives zeros.
///
/// Time and memory are proportional to the number of queries times the widest range.
///
/// # Shapes
/// - queries, output: `[batch, channels, time]`
/// - keys_values: `[batch, 2 channels, keys]`
/// - ranges: one per query of each sample
///
/// # Panics
/// Panics if the channels do not divide into the heads, or the ranges do not fit.
pub fn ranged_attention(
    queries: Tensor<3>,
    keys_values: Tensor<3>,
    num_heads: usize,
    ranges: &KeyRanges,
) -> Tensor<3> {
    let options = Options {
        keys: Some(ranges.clone()),
        ..Options::default()
    };
    cross(queries, keys_values, num_heads, options)
}

fn cross(
    queries: Tensor<3>,
    keys_values: Tensor<3>,
    num_heads: usize,
    options: Options,
) -> Tensor<3> {
    let [batch, channels, time] = queries.dims();
    check(channels, num_heads);
    let [other_batch, both, num_keys] = keys_values.dims();
    assert_eq!(
        (other_batch, both),
        (batch, 2 * channels),
        "samples and channels of keys and values"
    );
    if let Some(lengths) = &options.lengths {
        lengths.check(batch, num_keys);
    }
    if let Some(ranges) = &options.keys {
        ranges.check(batch, time, num_keys);
    }
    if !fuses(&queries) {
        let keys = keys_values.clone().narrow(1, 0, channels);
        let values = keys_values.narrow(1, channels, channels);
        return match &options.keys {
            Some(ranges) => composed::ranged_attention(queries, keys, values, num_heads, ranges),
            None => composed::attention(queries, keys, values, num_heads, options.lengths.as_ref()),
        };
    }
    Tensor::from_dispatch(Dispatch::fused_cross_attention(
        queries.into_dispatch(),
        keys_values.into_dispatch(),
        num_heads,
        options,
    ))
}

/// [`cross_attention`] of a sequence to itself.
///
/// # Shapes
/// - queries_keys_values: `[batch, 3 channels, time]`, in this order
/// - output: `[batch, channels, time]`
///
/// # Panics
/// Panics if the channels do not divide into the heads.
pub fn self_attention(
    queries_keys_values: Tensor<3>,
    num_heads: usize,
    lengths: Option<&Lengths>,
) -> Tensor<3> {
    let [batch, all, time] = queries_keys_values.dims();
    assert!(
        all.is_multiple_of(3),
        "{all} channels are not three times as many"
    );
    let channels = all / 3;
    check(channels, num_heads);
    if let Some(lengths) = lengths {
        lengths.check(batch, time);
    }
    if !fuses(&queries_keys_values) {
        let part = |index: usize| {
            queries_keys_values
                .clone()
                .narrow(1, index * channels, channels)
        };
        return composed::attention(part(0), part(1), part(2), num_heads, lengths);
    }
    Tensor::from_dispatch(Dispatch::fused_self_attention(
        queries_keys_values.into_dispatch(),
        num_heads,
        lengths.into(),
    ))
}

fn check(channels: usize, num_heads: usize) {
    assert!(
        channels.is_multiple_of(num_heads),
        "{channels} channels do not divide into {num_heads} heads"
    );
}
