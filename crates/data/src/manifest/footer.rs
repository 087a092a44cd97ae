//! A validated footer that replaces the file's own footer for polars.
//!
//! polars (0.55) trusts a Parquet file. A page of -2 values, a list of 2^31 columns or an Arrow
//! schema of 2000 nested lists aborts the process, because failed allocations and stack overflows
//! do not unwind. This module parses the footer within a budget and rewrites it with the flat
//! columns of text and numbers, whose pages are checked (Parquet format, "Metadata").

use std::collections::HashSet;

use polars_parquet_format::thrift::protocol::{TCompactInputProtocol, TCompactOutputProtocol};
use polars_parquet_format::{
    ColumnChunk, ColumnMetaData, ConvertedType, FieldRepetitionType, FileMetaData, IntType,
    LogicalType, RowGroup, SchemaElement, Type,
};

use super::pages::unpacked_bytes;

/// Largest footer; its size grows with columns and row groups, not with rows.
const MAX_FOOTER_BYTES: usize = 4 << 20;

/// Memory limit of the parsed footer, per byte. A list element counts for 8 bytes and takes 1 or
/// more.
const FOOTER_BUDGET: usize = 8;

/// Maximum number of values per byte of the file. Nearly every row has an incompressible checksum
/// of 32 bytes; the maximum allows some 256 columns.
const MAX_VALUES_PER_BYTE: usize = 8;

/// Maximum number of unpacked bytes per byte of the file, beyond [`SPARE_BYTES`].
const MAX_UNPACKING: usize = 256;

/// Number of unpacked bytes that every file may have.
const SPARE_BYTES: usize = 1 << 20;

/// Maximum number of unpacked bytes for a file of `length` bytes.
pub(super) fn most_unpacked(length: usize) -> usize {
    length.saturating_mul(MAX_UNPACKING) + SPARE_BYTES
}

/// The file with a footer of the `wanted` columns, or of all; nested columns, dates and times are
/// left out.
pub(super) fn rewritten(mut file: Vec<u8>, wanted: Option<&[&str]>) -> Result<Vec<u8>, String> {
    let [.., a, b, c, d, b'P', b'A', b'R', b'1'] = *file.as_slice() else {
        return Err("it does not end with PAR1".to_owned());
    };
    let length = u32::from_le_bytes([a, b, c, d]) as usize;
    let end = file.len() - 8;
    if length > end.min(MAX_FOOTER_BYTES) {
        return Err(format!(
            "a footer of {length} bytes found, {MAX_FOOTER_BYTES} and no more than the file allowed"
        ));
    }
    let start = end - length;
    let mut protocol = TCompactInputProtocol::new(&file[start..end], FOOTER_BUDGET * length);
    let footer = FileMetaData::read_from_in_protocol(&mut protocol)
        .map_err(|error| format!("its footer: {error}"))?;
    let footer = checked(footer, &file[..start], file.len(), wanted)?;
    file.truncate(start);
    let mut protocol = TCompactOutputProtocol::new(&mut file);
    footer
        .write_to_out_protocol(&mut protocol)
        .map_err(|error| format!("its footer: {error}"))?;
    let length = u32::try_from(file.len() - start).map_err(|_| "its footer is too long")?;
    file.extend_from_slice(&length.to_le_bytes());
    file.extend_from_slice(b"PAR1");
    Ok(file)
}

/// The footer of the columns to read, if it matches the column pages in `body`.
fn checked(
    footer: FileMetaData,
    body: &[u8],
    file_length: usize,
    wanted: Option<&[&str]>,
) -> Result<FileMetaData, String> {
    let leaves = leaves(&footer.schema, wanted)?;
    let mut schema: Vec<_> = footer.schema.into_iter().take(1).collect();
    schema.extend(leaves.iter().flatten().cloned());
    let root = schema.first_mut().ok_or("it has no schema")?;
    root.num_children = Some(leaves.iter().flatten().count() as i32);
    let mut rows = 0_usize;
    let mut values_left = file_length.saturating_mul(MAX_VALUES_PER_BYTE);
    let mut unpacked_left = most_unpacked(file_length);
    let mut row_groups = Vec::new();
    for group in footer.row_groups {
        if group.columns.len() != leaves.len() {
            return Err("a group of rows lacks columns".to_owned());
        }
        let group_rows = usize::try_from(group.num_rows).map_err(|_| "a negative count of rows")?;
        rows = rows.saturating_add(group_rows);
        let mut columns = Vec::new();
        for (column, leaf) in group.columns.into_iter().zip(&leaves) {
            let Some(leaf) = leaf else {
                continue;
            };
            let name = &leaf.name;
            let refused = |problem: &str| format!("column `{name}`: {problem}");
            values_left = values_left
                .checked_sub(group_rows)
                .ok_or_else(|| refused("more values than such a file can hold"))?;
            let column = chunk(column, leaf, group.num_rows).map_err(refused)?;
            let pages = range(&column)
                .and_then(|range| body.get(range))
                .ok_or_else(|| refused("it lies outside the file"))?;
            unpacked_left -= unpacked_bytes(pages, group_rows, unpacked_left)
                .map_err(|problem| refused(&problem))?;
            columns.push(ColumnChunk::new(
                None, 0, column, None, None, None, None, None, None,
            ));
        }
        let (total, rows) = (group.total_byte_size, group.num_rows);
        row_groups.push(RowGroup::new(columns, total, rows, None, None, None, None));
    }
    if i64::try_from(rows) != Ok(footer.num_rows) {
        return Err("its groups of rows do not add up".to_owned());
    }
    if rows > file_length.saturating_mul(MAX_VALUES_PER_BYTE) {
        return Err("more rows than such a file can hold".to_owned());
    }
    let (version, rows) = (footer.version, footer.num_rows);
    Ok(FileMetaData::new(
        version, schema, rows, row_groups, None, None, None, None, None,
    ))
}

/// The leaves of a schema in order; a leaf that is not read is `None`.
fn leaves(
    schema: &[SchemaElement],
    wanted: Option<&[&str]>,
) -> Result<Vec<Option<SchemaElement>>, String> {
    let mut leaves = Vec::new();
    let mut names = HashSet::new();
    // Number of remaining elements in the current nested column, depth first.
    let mut nested = 0_usize;
    for element in schema.iter().skip(1) {
        let flat = nested == 0;
        nested = nested.saturating_sub(1);
        if let Some(children) = element.num_children {
            nested = nested.saturating_add(usize::try_from(children).unwrap_or_default());
        }
        if element.type_.is_none() {
            continue;
        }
        let is_wanted = wanted.is_none_or(|wanted| wanted.contains(&element.name.as_str()));
        let leaf = (flat && is_wanted).then(|| readable(element)).flatten();
        if let Some(leaf) = &leaf
            && !names.insert(leaf.name.clone())
        {
            return Err(format!("column `{}` occurs twice", leaf.name));
        }
        leaves.push(leaf);
    }
    Ok(leaves)
}

/// A column of text, numbers or booleans in the types of this polars build.
fn readable(element: &SchemaElement) -> Option<SchemaElement> {
    let mut leaf = element.clone();
    if !matches!(
        element.repetition_type,
        Some(FieldRepetitionType::REQUIRED | FieldRepetitionType::OPTIONAL)
    ) || element.num_children.is_some_and(|children| children != 0)
    {
        return None;
    }
    let plain = element.logical_type.is_none() && element.converted_type.is_none();
    let is_read = match element.type_? {
        Type::BOOLEAN | Type::FLOAT | Type::DOUBLE => plain,
        Type::INT32 | Type::INT64 => match (&element.logical_type, element.converted_type) {
            (None, None) => true,
            (Some(LogicalType::INTEGER(IntType { bit_width, .. })), _) => {
                if *bit_width < 32 {
                    leaf.logical_type = None;
                    leaf.converted_type = None;
                }
                true
            }
            (None, Some(kind)) => [
                ConvertedType::INT_32,
                ConvertedType::INT_64,
                ConvertedType::UINT_32,
                ConvertedType::UINT_64,
            ]
            .contains(&kind),
            _ => false,
        },
        Type::BYTE_ARRAY => match (&element.logical_type, element.converted_type) {
            (None, None) => true,
            (Some(kind), _) => matches!(
                kind,
                LogicalType::STRING(_) | LogicalType::ENUM(_) | LogicalType::JSON(_)
            ),
            (None, Some(kind)) => [
                ConvertedType::UTF8,
                ConvertedType::ENUM,
                ConvertedType::JSON,
            ]
            .contains(&kind),
        },
        _ => false,
    };
    is_read.then_some(leaf)
}

/// Position and codec of a column, without statistics and indexes.
fn chunk(
    column: ColumnChunk,
    leaf: &SchemaElement,
    rows: i64,
) -> Result<ColumnMetaData, &'static str> {
    if column.file_path.is_some() {
        return Err("it lies in another file");
    }
    let column = column
        .meta_data
        .filter(|_| column.crypto_metadata.is_none())
        .ok_or("it is encrypted")?;
    if Some(column.type_) != leaf.type_ {
        return Err("another type in the schema");
    }
    Ok(ColumnMetaData::new(
        column.type_,
        column.encodings,
        vec![leaf.name.clone()],
        column.codec,
        rows,
        column.total_uncompressed_size,
        column.total_compressed_size,
        None,
        column.data_page_offset,
        None,
        // Some writers use 0 for a column without a dictionary.
        column.dictionary_page_offset.filter(|offset| *offset > 0),
        None,
        None,
        None,
        None,
        None,
    ))
}

/// The byte range of a column's pages, as polars reads it.
fn range(column: &ColumnMetaData) -> Option<std::ops::Range<usize>> {
    let start = column.dictionary_page_offset;
    let start = usize::try_from(start.unwrap_or(column.data_page_offset)).ok()?;
    let length = usize::try_from(column.total_compressed_size).ok()?;
    Some(start..start.checked_add(length)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::table::{decode, encode};
    use crate::manifest::tests::row;
    use polars_parquet_format::{KeyValue, TimeUnit, TimestampType};

    /// A manifest of two phrases whose footer is edited by `change`.
    fn changed(change: impl FnOnce(&mut FileMetaData)) -> Vec<u8> {
        let mut file = encode(vec![row("a"), row("b")]).unwrap();
        let end = file.len() - 8;
        let length = u32::from_le_bytes(file[end..end + 4].try_into().unwrap()) as usize;
        let start = end - length;
        let mut protocol = TCompactInputProtocol::new(&file[start..end], FOOTER_BUDGET * length);
        let mut footer = FileMetaData::read_from_in_protocol(&mut protocol).unwrap();
        change(&mut footer);
        file.truncate(start);
        footer
            .write_to_out_protocol(&mut TCompactOutputProtocol::new(&mut file))
            .unwrap();
        let length = (file.len() - start) as u32;
        file.extend(length.to_le_bytes());
        file.extend(b"PAR1");
        file
    }

    #[test]
    fn columns_that_polars_cannot_read_are_left_out() {
        let file = changed(|footer| {
            let frames = footer.schema.iter_mut().find(|c| c.name == "frames");
            let unit = TimeUnit::MILLIS(Default::default());
            frames.unwrap().logical_type =
                Some(LogicalType::TIMESTAMP(TimestampType::new(true, unit)));
            let fps = footer.schema.iter_mut().find(|c| c.name == "fps");
            fps.unwrap().repetition_type = Some(FieldRepetitionType::REPEATED);
            let schema = KeyValue::new("ARROW:schema".to_owned(), "no schema".to_owned());
            footer.key_value_metadata = Some(vec![schema]);
        });
        let frame = decode(file, None).unwrap();
        assert_eq!((frame.height(), frame.width()), (2, 14));
        assert!(frame.column("id").is_ok() && frame.column("frames").is_err());
    }

    #[test]
    fn contradictions_are_refused() {
        type Change = fn(&mut FileMetaData);
        let cases: [(Change, &str); 8] = [
            (|footer| footer.num_rows = 1 << 29, "do not add up"),
            (
                |footer| {
                    footer.num_rows = 1 << 40;
                    footer.row_groups[0].num_rows = 1 << 40;
                },
                "more values than such a file can hold",
            ),
            (
                |footer| {
                    footer.num_rows = 3;
                    footer.row_groups[0].num_rows = 3;
                },
                "a page without a readable header",
            ),
            (
                |footer| footer.row_groups[0].num_rows = -1,
                "negative count",
            ),
            (
                |footer| drop(footer.row_groups[0].columns.pop()),
                "lacks columns",
            ),
            (
                |footer| footer.schema[2].name = "id".to_owned(),
                "`id` occurs twice",
            ),
            (
                |footer| {
                    let column = footer.row_groups[0].columns[0].meta_data.as_mut();
                    column.unwrap().total_compressed_size = i64::MAX;
                },
                "`id`: it lies outside the file",
            ),
            (
                |footer| footer.schema[6].type_ = Some(Type::FLOAT),
                "`fps`: another type in the schema",
            ),
        ];
        for (change, expected) in cases {
            let message = decode(changed(change), None).expect_err(expected);
            assert!(message.contains(expected), "{message} lacks {expected}");
        }
        // Without columns, only the file's length limits the rows.
        let empty = changed(|footer| {
            footer.schema.truncate(1);
            footer.num_rows = 1 << 29;
            footer.row_groups[0].num_rows = 1 << 29;
            footer.row_groups[0].columns.clear();
        });
        let message = decode(empty, None).unwrap_err();
        assert!(message.contains("more rows"), "{message}");
    }
}
