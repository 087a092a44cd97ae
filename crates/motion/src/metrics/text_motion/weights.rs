//! Named arrays as they come from a file, and what an encoder asks of them.

use std::collections::{BTreeMap, BTreeSet};

use super::TextMotionError;

/// Arrays by name: shape and values, row-major.
pub type NamedArrays = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// The arrays of the three encoders, named as their PyTorch modules name them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EvaluatorWeights {
    /// Frames to one vector for every four: `main.0`, `main.3`, `out_net`.
    pub movement_encoder: NamedArrays,
    /// Those vectors to an embedding: `input_emb`, `gru`, `hidden`, `output_net`.
    pub motion_encoder: NamedArrays,
    /// Words to an embedding: the same and `pos_emb`.
    pub text_encoder: NamedArrays,
}

/// How long an axis is.
#[derive(Clone, Copy, Debug)]
pub(super) enum Axis {
    /// As long as every network has it.
    Exactly(usize),
    /// As long as the first array with this size has it.
    Size(&'static str),
    /// A multiple of such a size.
    Times(usize, &'static str),
}

/// A named array and its axes.
pub(super) type Expected = (&'static str, &'static [Axis]);

/// More problems than this are counted, not listed.
const LISTED: usize = 24;

/// Accepts `arrays` if they are those of `expected` and their sizes agree.
///
/// # Errors
/// [`TextMotionError::Weights`] with all that is missing, not known, of another shape or not
/// finite.
pub(super) fn check(
    part: &'static str,
    arrays: &NamedArrays,
    expected: &[&[Expected]],
) -> Result<(), TextMotionError> {
    let expected = expected.concat();
    let sizes = sizes(arrays, &expected);
    let mut problems = Vec::new();
    for (name, axes) in &expected {
        match arrays.get(*name) {
            None => problems.push(format!("`{name}` is missing")),
            Some((shape, values)) => {
                if let Some(found) = unfit(shape, values, axes, &sizes) {
                    problems.push(format!("`{name}` {found}"));
                }
            }
        }
    }
    let known: BTreeSet<&str> = expected.iter().map(|(name, _)| *name).collect();
    let extra = arrays.keys().filter(|name| !known.contains(name.as_str()));
    problems.extend(extra.map(|name| format!("`{name}` is not one of its arrays")));
    if problems.is_empty() {
        return Ok(());
    }
    if let Some(more) = problems.len().checked_sub(LISTED).filter(|more| *more > 0) {
        problems.truncate(LISTED);
        problems.push(format!("and {more} more"));
    }
    Err(TextMotionError::Weights {
        part,
        problems: problems.join("; "),
    })
}

/// Each size as the first array that has it says.
fn sizes(arrays: &NamedArrays, expected: &[Expected]) -> BTreeMap<&'static str, usize> {
    let mut sizes = BTreeMap::new();
    for (name, axes) in expected {
        let Some((shape, _)) = arrays
            .get(*name)
            .filter(|(shape, _)| shape.len() == axes.len())
        else {
            continue;
        };
        for (axis, length) in axes.iter().zip(shape) {
            let (times, size) = match *axis {
                Axis::Exactly(_) => continue,
                Axis::Size(size) => (1, size),
                Axis::Times(times, size) => (times, size),
            };
            if *length > 0 && length.is_multiple_of(times) {
                sizes.entry(size).or_insert(length / times);
            }
        }
    }
    sizes
}

/// What is wrong with an array.
fn unfit(
    shape: &[usize],
    values: &[f32],
    axes: &[Axis],
    sizes: &BTreeMap<&'static str, usize>,
) -> Option<String> {
    let length = |axis: &Axis| match *axis {
        Axis::Exactly(length) => Some(length),
        Axis::Size(size) => sizes.get(size).copied(),
        Axis::Times(times, size) => sizes.get(size).map(|length| times * length),
    };
    let wanted: Vec<Option<usize>> = axes.iter().map(length).collect();
    if shape.len() != wanted.len() || shape.iter().zip(&wanted).any(|(a, b)| Some(*a) != *b) {
        let named = |length: &Option<usize>| length.map_or("any".into(), |n| n.to_string());
        let wanted: Vec<String> = wanted.iter().map(named).collect();
        return Some(format!("is {shape:?}, expected [{}]", wanted.join(", ")));
    }
    let count = shape
        .iter()
        .try_fold(1, |count: usize, axis| count.checked_mul(*axis));
    if count != Some(values.len()) {
        return Some(format!("has {} values for {shape:?}", values.len()));
    }
    let broken = values.iter().position(|value| !value.is_finite())?;
    Some(format!("holds {} at place {broken}", values[broken]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: &[Expected] = &[
        ("weight", &[Axis::Times(3, "state"), Axis::Size("input")]),
        ("bias", &[Axis::Times(3, "state")]),
        ("initial", &[Axis::Exactly(2), Axis::Size("state")]),
    ];

    fn arrays(shapes: &[(&str, &[usize])]) -> NamedArrays {
        let array = |shape: &[usize]| (shape.to_vec(), vec![0.5; shape.iter().product()]);
        let named = shapes.iter();
        named.map(|(n, s)| (n.to_string(), array(s))).collect()
    }

    fn problems(arrays: &NamedArrays) -> String {
        match check("gru", arrays, &[TABLE]) {
            Ok(()) => String::new(),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn sizes_are_those_of_the_arrays() {
        for state in [1, 4] {
            let fitting = arrays(&[
                ("weight", &[3 * state, 7]),
                ("bias", &[3 * state]),
                ("initial", &[2, state]),
            ]);
            assert_eq!(problems(&fitting), "");
        }
    }

    #[test]
    fn everything_that_does_not_fit_is_listed() {
        let mut unfit = arrays(&[("weight", &[6, 7]), ("initial", &[2, 3]), ("other", &[1])]);
        let message = "the weights of `gru` do not fit: `bias` is missing; `initial` is [2, 3], \
                       expected [2, 2]; `other` is not one of its arrays";
        assert_eq!(problems(&unfit), message);
        unfit.remove("other");
        unfit.insert("bias".into(), (vec![6], vec![0.0; 5]));
        unfit.insert(
            "initial".into(),
            (vec![2, 2], vec![0.0, 1.0, f32::NAN, 0.0]),
        );
        let message = "the weights of `gru` do not fit: `bias` has 5 values for [6]; `initial` \
                       holds NaN at place 2";
        assert_eq!(problems(&unfit), message);
        unfit.insert("weight".into(), (vec![6, usize::MAX], vec![0.0; 7]));
        assert!(problems(&unfit).contains("`weight` has 7 values for [6, "));
        unfit.insert("weight".into(), (vec![7], vec![0.0; 7]));
        assert!(problems(&unfit).contains("`weight` is [7], expected [6, any]"));
    }

    #[test]
    fn a_wholly_different_file_does_not_flood_the_message() {
        let names: Vec<String> = (0..100).map(|i| format!("layer{i}")).collect();
        let shapes: Vec<(&str, &[usize])> = names.iter().map(|n| (n.as_str(), &[1][..])).collect();
        let message = problems(&arrays(&shapes));
        assert!(message.ends_with("; and 79 more"), "{message}");
    }
}
