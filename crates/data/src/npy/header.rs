//! The header of a `.npy` file: a magic string, and a Python dictionary of dtype, order and shape
//! (NumPy's `numpy.lib.format`, versions 1 to 3).

use crate::FileError;

/// NumPy's limit.
pub(super) const MAX_HEADER_BYTES: usize = 10_000;

/// NumPy's limit, since version 2.
const MAX_AXES: usize = 64;

/// NumPy's alignment of the data for memory mapping.
const ALIGNMENT: usize = 64;

/// The type of an array's elements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Dtype {
    /// float32.
    Single,
    /// float64.
    Double,
    /// Python objects, pickled.
    Objects,
}

/// A parsed header.
#[derive(Debug, PartialEq)]
pub(super) struct Header {
    pub(super) dtype: Dtype,
    /// True if the first axis is the fastest, false if the last axis is.
    pub(super) fortran_order: bool,
    pub(super) shape: Vec<usize>,
    /// The product of the axes.
    pub(super) length: u64,
    /// Offset of the data, bytes.
    pub(super) data_start: usize,
}

/// The header of a little-endian float32 array of this shape, in C order.
pub(super) fn write(shape: &[usize]) -> Vec<u8> {
    let axes: String = shape.iter().map(|axis| format!("{axis}, ")).collect();
    let axes = match shape {
        [_] => axes.trim_end(),
        _ => axes.trim_end_matches(", "),
    };
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({axes}), }}");
    // Magic string, version, length of the text, and final line feed.
    let around = 10 + 1;
    let padded = (text.len() + around).next_multiple_of(ALIGNMENT) - around;
    text.extend(std::iter::repeat_n(' ', padded - text.len()));
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

/// Reads the header of a file's `bytes`; `file` names the file in errors.
pub(super) fn read(bytes: &[u8], file: &str) -> Result<Header, FileError> {
    let not_npy = |reason: String| {
        let hint = "write it again with numpy.save(path, array.astype(\"<f4\")) or \
                    numpy.savez_compressed";
        FileError::unusable(file, format!("not a .npy array: {reason}"), hint)
    };
    let (text, data_start) = text(bytes).map_err(not_npy)?;
    let [descr, fortran_order, shape] = entries(text).map_err(not_npy)?;
    let dtype = match descr {
        "'<f4'" | "\"<f4\"" => Dtype::Single,
        "'<f8'" | "\"<f8\"" => Dtype::Double,
        "'|O'" | "\"|O\"" | "'O'" => Dtype::Objects,
        _ => {
            let problem = format!(
                "dtype {descr} found, little-endian float32 ('<f4') or float64 ('<f8') allowed"
            );
            let hint = "convert it with array.astype(\"<f4\") before saving";
            return Err(FileError::unusable(file, problem, hint));
        }
    };
    let fortran_order = match fortran_order {
        "True" => true,
        "False" => false,
        found => {
            return Err(not_npy(format!(
                "fortran_order {found} found, True or False allowed"
            )));
        }
    };
    let shape = axes(shape).map_err(not_npy)?;
    // An axis of length zero can hide an axis longer than the file.
    let length = shape
        .iter()
        .try_fold(1u64, |product, &axis| product.checked_mul(axis as u64))
        .ok_or_else(|| not_npy(TOO_LARGE.to_owned()))?;
    Ok(Header {
        dtype,
        fortran_order,
        shape,
        length,
        data_start,
    })
}

const TOO_LARGE: &str = "its header declares an array too large to exist";

/// The first bytes of every file.
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";

/// The header's text and the offset of the data.
fn text(bytes: &[u8]) -> Result<(&str, usize), String> {
    if bytes.len() < 10 || !bytes.starts_with(MAGIC) {
        return Err("it lacks the magic string".to_owned());
    }
    let (start, length) = match bytes[6] {
        1 => (10, usize::from(u16::from_le_bytes([bytes[8], bytes[9]]))),
        2 | 3 if bytes.len() >= 12 => {
            let length = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
            (12, length as usize)
        }
        2 | 3 => return Err("its header is cut off".to_owned()),
        version => return Err(format!("format version {version} found, 1 to 3 allowed")),
    };
    if length > MAX_HEADER_BYTES {
        return Err(format!(
            "header of {length} bytes found, {MAX_HEADER_BYTES} allowed"
        ));
    }
    let text = bytes
        .get(start..start + length)
        .ok_or_else(|| "its header is cut off".to_owned())?;
    let text = str::from_utf8(text).map_err(|_| "its header is not text".to_owned())?;
    Ok((text, start + length))
}

/// The keys of the dictionary.
const KEYS: [&str; 3] = ["descr", "fortran_order", "shape"];

/// The dictionary's values of [`KEYS`], as text.
fn entries(text: &str) -> Result<[&str; 3], String> {
    let no_dictionary = || "its header is not a dictionary".to_owned();
    let mut rest = text
        .trim_ascii()
        .strip_prefix('{')
        .and_then(|text| text.strip_suffix('}'))
        .ok_or_else(no_dictionary)?
        .trim_ascii();
    let mut values = [None; 3];
    while !rest.is_empty() {
        let (entry, behind) = rest.split_at(end_of_entry(rest)?);
        rest = behind.strip_prefix(',').unwrap_or(behind).trim_ascii();
        let (key, value) = entry.split_once(':').ok_or_else(no_dictionary)?;
        let key = key.trim_ascii();
        let bare = ['\'', '"']
            .iter()
            .find_map(|&quote| key.strip_prefix(quote)?.strip_suffix(quote));
        let place = bare.and_then(|bare| KEYS.iter().position(|known| *known == bare));
        let place = place.ok_or_else(|| format!("its header has the unknown entry {key}"))?;
        if values[place].replace(value.trim_ascii()).is_some() {
            return Err(format!("its header has {key} twice"));
        }
    }
    match values.iter().position(Option::is_none) {
        Some(missing) => Err(format!("its header has no entry '{}'", KEYS[missing])),
        None => Ok(values.map(Option::unwrap_or_default)),
    }
}

/// The end of the first entry of `text`: the first comma outside brackets and quotes, or the end.
fn end_of_entry(text: &str) -> Result<usize, String> {
    let (mut depth, mut quote) = (0usize, None);
    for (place, byte) in text.bytes().enumerate() {
        match (quote, byte) {
            (None, b'\'' | b'"') => quote = Some(byte),
            (None, b'(' | b'[' | b'{') => depth += 1,
            (None, b')' | b']' | b'}') => {
                depth = depth
                    .checked_sub(1)
                    .ok_or("its header closes a bracket that is not open")?;
            }
            (None, b',') if depth == 0 => return Ok(place),
            (Some(open), close) if open == close => quote = None,
            _ => {}
        }
    }
    if depth > 0 || quote.is_some() {
        return Err("its header leaves a bracket or quote open".to_owned());
    }
    Ok(text.len())
}

/// The axes of a tuple such as `(3, 25)`, `(3,)` or `()`; Python 2 wrote `(3L, 25L)`.
fn axes(tuple: &str) -> Result<Vec<usize>, String> {
    let wrong = || format!("shape {tuple} found, a tuple of axes allowed");
    let inside = tuple
        .strip_prefix('(')
        .and_then(|text| text.strip_suffix(')'))
        .ok_or_else(wrong)?
        .trim_ascii();
    if inside.is_empty() {
        return Ok(Vec::new());
    }
    let closed = inside.strip_suffix(',');
    let axes = closed.unwrap_or(inside).split(',');
    let axes: Vec<usize> = axes
        .map(|axis| self::axis(axis.trim_ascii()))
        .collect::<Result<_, _>>()?;
    if axes.len() > MAX_AXES {
        return Err(format!("{} axes found, {MAX_AXES} allowed", axes.len()));
    }
    // In Python, a single number in brackets is not a tuple.
    if axes.len() == 1 && closed.is_none() {
        return Err(wrong());
    }
    Ok(axes)
}

fn axis(text: &str) -> Result<usize, String> {
    let digits = text.strip_suffix('L').unwrap_or(text);
    if text.starts_with('-') {
        return Err(format!("its header has the negative axis {text}"));
    }
    let leading_zero = digits.len() > 1 && digits.starts_with('0');
    let plain = digits.bytes().all(|digit| digit.is_ascii_digit());
    if digits.is_empty() || leading_zero || !plain {
        return Err(format!(
            "its header has the axis {text:?}, which is not a whole number"
        ));
    }
    digits.parse().map_err(|_| TOO_LARGE.to_owned())
}
