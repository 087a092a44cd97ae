//! Whether the counts and sizes in a Parquet file agree, before polars decodes it.
//!
//! polars (0.55) takes them at their word: a page that claims a negative number of values asks for
//! 2^61 bytes, and a failed allocation ends the process without unwinding. Here the footer is
//! parsed within a budget, then every page header is walked (Parquet format, "File Format" and
//! "Data Pages").

use polars::io::parquet::metadata::FileMetadata;
use polars_parquet_format::thrift::protocol::TCompactInputProtocol;
use polars_parquet_format::{FileMetaData, PageHeader, PageType, SchemaElement};

/// The longest footer: it grows with columns and groups of rows, not with rows.
const MAX_FOOTER_BYTES: usize = 4 << 20;

/// Memory that a parsed footer or page header may take for each of its bytes. An element of a list
/// counts for 8 bytes, and takes 1 in the file at least.
const THRIFT_BUDGET: usize = 8;

/// The deepest nesting of columns.
const MAX_DEPTH: usize = 16;

/// The most values for each byte of the file. Every row has a checksum of its own, whose 32 bytes no
/// compression shortens; so this allows for 256 columns.
const MAX_VALUES_PER_BYTE: usize = 8;

/// The most unpacked bytes for each byte of the file, beside [`SPARE_BYTES`]: rows of 8 KiB.
const MAX_UNPACKING: usize = 256;

/// Unpacked bytes that every file may have.
const SPARE_BYTES: usize = 1 << 20;

/// Refuses a footer whose lists are longer than what they are made of, or nested too deeply.
///
/// # Errors
/// What is wrong with it.
pub(super) fn check_footer(bytes: &[u8]) -> Result<(), String> {
    let [.., a, b, c, d, b'P', b'A', b'R', b'1'] = *bytes else {
        return Err("it does not end with PAR1".to_owned());
    };
    let length = u32::from_le_bytes([a, b, c, d]) as usize;
    let end = bytes.len() - 8;
    if length > end.min(MAX_FOOTER_BYTES) {
        return Err(format!("its footer claims {length} bytes"));
    }
    let footer = &bytes[end - length..end];
    let mut protocol = TCompactInputProtocol::new(footer, THRIFT_BUDGET * length);
    let footer = FileMetaData::read_from_in_protocol(&mut protocol)
        .map_err(|error| format!("its footer: {error}"))?;
    check_depth(&footer.schema)
}

/// Columns are listed depth first, each with the number of its children.
fn check_depth(schema: &[SchemaElement]) -> Result<(), String> {
    let mut open = Vec::new();
    for element in schema {
        while open.last() == Some(&0) {
            open.pop();
        }
        if let Some(children) = open.last_mut() {
            *children -= 1;
        }
        open.push(element.num_children.unwrap_or(0).max(0));
        if open.len() > MAX_DEPTH {
            return Err("its columns are nested too deeply".to_owned());
        }
    }
    Ok(())
}

/// Refuses pages that claim more values than their column has, or unpack to more bytes than
/// a manifest of that length can.
///
/// # Errors
/// What is wrong, with the column.
pub(super) fn check_pages(metadata: &FileMetadata, bytes: &[u8]) -> Result<(), String> {
    let mut values_left = bytes.len() * MAX_VALUES_PER_BYTE;
    let mut unpacked_left = SPARE_BYTES + bytes.len() * MAX_UNPACKING;
    let mut rows = 0_usize;
    for group in &metadata.row_groups {
        rows = group.num_rows().saturating_add(rows);
        for column in group.parquet_columns() {
            let descriptor = column.descriptor();
            let name = descriptor.path_in_schema.join(".");
            let refused = |problem: &str| format!("column `{name}`: {problem}");
            let values = usize::try_from(column.num_values()).unwrap_or(usize::MAX);
            let nested = descriptor.descriptor.max_rep_level > 0;
            if !nested && values != group.num_rows() {
                return Err(refused("as many values as rows expected"));
            }
            values_left = values_left
                .checked_sub(values)
                .ok_or_else(|| refused("more values than such a file can hold"))?;
            let range = column.byte_range();
            let pages = bytes
                .get(range.start as usize..range.end as usize)
                .ok_or_else(|| refused("it lies outside the file"))?;
            let unpacked = Pages {
                rest: pages,
                nested,
            }
            .check(values, unpacked_left)
            .map_err(refused)?;
            unpacked_left -= unpacked;
        }
    }
    if rows != metadata.num_rows {
        return Err("its groups of rows do not add up".to_owned());
    }
    Ok(())
}

/// The pages of one column in one group of rows.
struct Pages<'a> {
    rest: &'a [u8],
    nested: bool,
}

impl Pages<'_> {
    /// Their unpacked bytes, where they hold just `values` values in at most `limit` bytes.
    fn check(mut self, values: usize, limit: usize) -> Result<usize, &'static str> {
        let mut values_left = values;
        let mut unpacked_left = limit;
        let mut first = true;
        // A column without values may still have a dictionary.
        while values_left > 0 || (first && !self.rest.is_empty()) {
            let (page_values, unpacked) = self.next(first)?;
            values_left = values_left
                .checked_sub(page_values)
                .ok_or("a page has more values than the column")?;
            unpacked_left = unpacked_left
                .checked_sub(unpacked)
                .ok_or("it unpacks to more than such a file can hold")?;
            first = false;
        }
        Ok(limit - unpacked_left)
    }

    /// The number of values and of unpacked bytes of the next page.
    fn next(&mut self, first: bool) -> Result<(usize, usize), &'static str> {
        let length = self.rest.len();
        let mut protocol = TCompactInputProtocol::new(&mut self.rest, THRIFT_BUDGET * length);
        let header = PageHeader::read_from_in_protocol(&mut protocol)
            .map_err(|_| "a page without a readable header")?;
        let size =
            |size: i32| usize::try_from(size).map_err(|_| "a page with a negative size or count");
        let packed = size(header.compressed_page_size)?;
        let unpacked = size(header.uncompressed_page_size)?;
        self.rest = self.rest.get(packed..).ok_or("a page beyond its end")?;
        let values = match header.type_ {
            PageType::DICTIONARY_PAGE if first => {
                let dictionary = header.dictionary_page_header.ok_or("half a page header")?;
                if size(dictionary.num_values)? > unpacked {
                    return Err("a dictionary with more values than bytes");
                }
                0
            }
            PageType::DATA_PAGE => {
                let data = header.data_page_header.ok_or("half a page header")?;
                size(data.num_values)?
            }
            PageType::DATA_PAGE_V2 => {
                let data = header.data_page_header_v2.ok_or("half a page header")?;
                let values = size(data.num_values)?;
                let levels = size(data.definition_levels_byte_length)?
                    + size(data.repetition_levels_byte_length)?;
                let rows = size(data.num_rows)?;
                if levels > packed.min(unpacked)
                    || size(data.num_nulls)? > values
                    || rows > values
                    || (!self.nested && rows != values)
                {
                    return Err("a page whose header contradicts itself");
                }
                values
            }
            _ => return Err("a page of an unknown kind"),
        };
        Ok((values, unpacked))
    }
}
