//! Checks of a column's pages against its footer (Parquet format, "Data Pages").

use polars_parquet_format::thrift::protocol::TCompactInputProtocol;
use polars_parquet_format::{Encoding, PageHeader, PageType};

/// Memory limit of a parsed page header, per byte of its column.
const HEADER_BUDGET: usize = 8;

/// Supported encodings. Delta encodings contain their own counts, which polars trusts without a
/// check.
const ENCODINGS: [Encoding; 5] = [
    Encoding::PLAIN,
    Encoding::PLAIN_DICTIONARY,
    Encoding::RLE,
    Encoding::RLE_DICTIONARY,
    Encoding::BYTE_STREAM_SPLIT,
];

/// Number of unpacked bytes, at most `limit`, of a flat column with `values` values in one row
/// group.
pub(super) fn unpacked_bytes(
    mut pages: &[u8],
    values: usize,
    limit: usize,
) -> Result<usize, String> {
    let mut values_left = values;
    let mut unpacked_left = limit;
    let mut may_be_dictionary = true;
    // A column without values may still have a dictionary.
    while values_left > 0 || (may_be_dictionary && !pages.is_empty()) {
        let (values, unpacked_bytes) = next(&mut pages, may_be_dictionary)?;
        values_left = values_left
            .checked_sub(values)
            .ok_or("a page has more values than the column")?;
        unpacked_left = unpacked_left
            .checked_sub(unpacked_bytes)
            .ok_or("it unpacks to more than such a file can hold")?;
        may_be_dictionary = false;
    }
    Ok(limit - unpacked_left)
}

/// Number of values and unpacked bytes of the next page, from the page header.
fn next(rest: &mut &[u8], may_be_dictionary: bool) -> Result<(usize, usize), String> {
    let budget = HEADER_BUDGET * rest.len();
    let mut protocol = TCompactInputProtocol::new(&mut *rest, budget);
    let header = PageHeader::read_from_in_protocol(&mut protocol)
        .map_err(|error| format!("a page without a readable header: {error}"))?;
    let packed_bytes = count(header.compressed_page_size)?;
    let unpacked_bytes = count(header.uncompressed_page_size)?;
    *rest = rest.get(packed_bytes..).ok_or("a page beyond its end")?;
    let values = match header.type_ {
        PageType::DICTIONARY_PAGE if may_be_dictionary => {
            let dictionary = header.dictionary_page_header.ok_or("half a page header")?;
            if count(dictionary.num_values)? > unpacked_bytes {
                return Err("a dictionary with more values than bytes".to_owned());
            }
            0
        }
        PageType::DATA_PAGE => {
            let data = header.data_page_header.ok_or("half a page header")?;
            check_encoding(data.encoding)?;
            count(data.num_values)?
        }
        PageType::DATA_PAGE_V2 => {
            let data = header.data_page_header_v2.ok_or("half a page header")?;
            check_encoding(data.encoding)?;
            let values = count(data.num_values)?;
            let levels = count(data.definition_levels_byte_length)?
                + count(data.repetition_levels_byte_length)?;
            if levels > packed_bytes.min(unpacked_bytes)
                || count(data.num_nulls)? > values
                || count(data.num_rows)? != values
            {
                return Err("a page whose header contradicts itself".to_owned());
            }
            values
        }
        _ => return Err("a page of an unknown kind".to_owned()),
    };
    Ok((values, unpacked_bytes))
}

fn count(number: i32) -> Result<usize, &'static str> {
    usize::try_from(number).map_err(|_| "a page with a negative size or count")
}

fn check_encoding(encoding: Encoding) -> Result<(), String> {
    if ENCODINGS.contains(&encoding) {
        return Ok(());
    }
    let found = match encoding {
        Encoding::DELTA_BINARY_PACKED => "DELTA_BINARY_PACKED".to_owned(),
        Encoding::DELTA_LENGTH_BYTE_ARRAY => "DELTA_LENGTH_BYTE_ARRAY".to_owned(),
        Encoding::DELTA_BYTE_ARRAY => "DELTA_BYTE_ARRAY".to_owned(),
        Encoding(other) => format!("number {other}"),
    };
    Err(format!(
        "encoding {found} found; PLAIN, RLE, dictionaries and BYTE_STREAM_SPLIT allowed"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use polars_parquet_format::thrift::protocol::TCompactOutputProtocol;
    use polars_parquet_format::{DataPageHeader, DataPageHeaderV2, DictionaryPageHeader};

    /// A page of 8 bytes that unpacks to 16 bytes.
    fn page(type_: PageType) -> PageHeader {
        PageHeader::new(type_, 16, 8, None, None, None, None, None)
    }

    fn dictionary(values: i32) -> PageHeader {
        let dictionary = DictionaryPageHeader::new(values, Encoding::PLAIN, None);
        PageHeader {
            dictionary_page_header: Some(dictionary),
            ..page(PageType::DICTIONARY_PAGE)
        }
    }

    fn data(values: i32, encoding: Encoding) -> PageHeader {
        let data = DataPageHeader::new(values, encoding, Encoding::RLE, Encoding::RLE, None);
        PageHeader {
            data_page_header: Some(data),
            ..page(PageType::DATA_PAGE)
        }
    }

    fn second(values: i32, nulls: i32, rows: i32, levels: i32) -> PageHeader {
        let data =
            DataPageHeaderV2::new(values, nulls, rows, Encoding::PLAIN, levels, 0, None, None);
        PageHeader {
            data_page_header_v2: Some(data),
            ..page(PageType::DATA_PAGE_V2)
        }
    }

    /// The result for a column of 5 values in these pages, with at most 40 unpacked bytes.
    fn read(pages: &[PageHeader]) -> Result<usize, String> {
        let mut bytes = Vec::new();
        for page in pages {
            page.write_to_out_protocol(&mut TCompactOutputProtocol::new(&mut bytes))
                .unwrap();
            bytes.extend([0; 8]);
        }
        unpacked_bytes(&bytes, 5, 40)
    }

    #[test]
    fn pages_of_both_versions_are_read() {
        let plain = Encoding::PLAIN;
        assert_eq!(read(&[data(5, plain)]), Ok(16));
        assert_eq!(
            read(&[dictionary(16), data(5, Encoding::RLE_DICTIONARY)]),
            Ok(32)
        );
        assert_eq!(read(&[data(2, plain), second(3, 1, 3, 8)]), Ok(32));
    }

    #[test]
    fn contradictions_are_refused() {
        let plain = Encoding::PLAIN;
        for (pages, expected) in [
            (vec![data(-2, plain)], "negative"),
            (vec![data(6, plain)], "more values than the column"),
            (vec![data(4, plain)], "without a readable header"),
            (vec![data(1, plain); 5], "unpacks to more"),
            (
                vec![dictionary(17), data(5, plain)],
                "more values than bytes",
            ),
            (vec![data(2, plain), dictionary(1)], "unknown kind"),
            (vec![page(PageType::DATA_PAGE)], "half a page header"),
            (vec![page(PageType::INDEX_PAGE)], "unknown kind"),
            (vec![second(5, 6, 5, 0)], "contradicts itself"),
            (vec![second(5, 0, 4, 0)], "contradicts itself"),
            (vec![second(5, 0, 5, 9)], "contradicts itself"),
            (
                vec![data(5, Encoding::DELTA_BYTE_ARRAY)],
                "DELTA_BYTE_ARRAY found",
            ),
        ] {
            let message = read(&pages).unwrap_err();
            assert!(message.contains(expected), "{message} lacks {expected}");
        }
        let longer = PageHeader {
            compressed_page_size: 9,
            ..data(5, plain)
        };
        assert_eq!(read(&[longer]), Err("a page beyond its end".to_owned()));
    }
}
