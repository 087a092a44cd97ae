//! The values of columns.

use polars::prelude::{Column, DataType};

/// The values of a column of numbers.
pub(super) fn numbers(column: &Column) -> Result<Vec<Option<f64>>, String> {
    let column = cast(column, &DataType::Float64)?;
    let numbers = column.f64().map_err(|error| error.to_string())?;
    Ok(numbers.iter().collect())
}

/// A column cast to the type `to`.
pub(super) fn cast(column: &Column, to: &DataType) -> Result<Column, String> {
    let broken = |error| format!("column `{}`: {error}", column.name());
    column.cast(to).map_err(broken)
}
