//! Verdicts on evaluations: sentences about the main measures.

use super::table::ratio;
use super::{Better, Column};

/// The main measure that is furthest from real motion, as a sentence; `None` without such measures.
pub(crate) fn furthest_from_real(samples: &Column, real: &Column) -> Option<String> {
    let near = samples.main();
    let near = near.filter(|(_, number)| number.better == Some(Better::NearReal));
    let ratios = near.filter_map(|(group, number)| {
        let real = real.number(group.key, &number.name)?.value?;
        let title = number.line.as_ref()?.0.split(", ").next()?;
        let of = match group.title {
            "" => String::new(),
            of => format!(" ({})", of.to_lowercase()),
        };
        Some((format!("{title}{of}"), ratio(number.value?, real)?))
    });
    let far = |ratio: f64| ratio.ln().abs();
    let furthest = ratios.max_by(|a, b| far(a.1).total_cmp(&far(b.1)));
    let (title, ratio) = furthest?;
    Some(format!(
        "furthest from real motion: {title}, {ratio:.2} times real"
    ))
}

/// The columns with the best value of each main measure, by measure; empty where values tie or are
/// missing in a column. `real` has the columns of real motion.
pub fn best_columns(columns: &[&Column], real: &[&Column]) -> Vec<Vec<usize>> {
    let Some(first) = columns.first() else {
        return Vec::new();
    };
    let of_measure = |(group, number): (&super::Group, &super::Number)| {
        let value = |column: &Column| column.number(group.key, &number.name)?.value;
        let values = columns.iter().zip(real);
        let values = values.map(|(column, real)| [value(column), value(real)]);
        let better = number.better.expect("a main measure");
        best_places(better, &values.collect::<Vec<_>>())
    };
    first.main().map(of_measure).collect()
}

/// The places of the best of several values of a measure, each with the value of real motion; empty
/// where values tie or are missing.
pub fn best_places(better: Better, values: &[[Option<f64>; 2]]) -> Vec<usize> {
    let badness = values
        .iter()
        .map(|[value, real]| better.badness(*value, *real));
    let badness: Option<Vec<f64>> = badness.collect();
    let badness = badness.unwrap_or_default();
    let best = badness.iter().copied().fold(f64::INFINITY, f64::min);
    let places = (0..badness.len()).filter(|&place| badness[place] == best);
    let places: Vec<usize> = places.collect();
    match places.len() == badness.len() {
        true => Vec::new(),
        false => places,
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Group, Number};
    use super::*;

    fn column(values: [Option<f64>; 4]) -> Column {
        column_of("", values)
    }

    fn column_of(title: &'static str, values: [Option<f64>; 4]) -> Column {
        let [error, rate, jerk, speed] = values;
        let numbers = Number::list([
            ("error", error, ", m"),
            ("rate", rate, ""),
            ("jerk", jerk, ", m/s^3"),
            ("speed", speed, ""),
        ]);
        let main = [
            ("error", Better::Lower),
            ("rate", Better::Higher),
            ("jerk", Better::NearReal),
            ("speed", Better::NearReal),
        ];
        let numbers = Number::mark(numbers, &main);
        Column {
            facts: Vec::new(),
            groups: vec![Group {
                key: "samples",
                title,
                numbers,
            }],
        }
    }

    #[test]
    fn the_best_value_is_lowest_highest_or_nearest_to_real() {
        let real = column([Some(0.0), Some(1.0), Some(60.0), Some(1.0)]);
        let one = column([Some(0.2), Some(0.5), Some(30.0), Some(1.0)]);
        let two = column([Some(0.1), Some(0.4), Some(90.0), None]);
        let found = best_columns(&[&one, &two], &[&real, &real]);
        assert_eq!(found, [vec![1], vec![0], vec![1], vec![]]);
        assert_eq!(
            best_columns(&[&one], &[&real]),
            vec![Vec::<usize>::new(); 4]
        );
        let said = furthest_from_real(&one, &real);
        let expected = "furthest from real motion: jerk, 0.50 times real";
        assert_eq!(said.as_deref(), Some(expected));
        assert_eq!(furthest_from_real(&one, &column([None; 4])), None);
        let raw = column_of("RAW", [None, None, Some(30.0), None]);
        let said = furthest_from_real(&raw, &real);
        let expected = "furthest from real motion: jerk (raw), 0.50 times real";
        assert_eq!(said.as_deref(), Some(expected));
    }
}
