//! Bounded reading of files that users name.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

/// Largest text file: configs, goals, plans, lists of ids.
pub const MAX_TEXT_BYTES: u64 = 64 << 20;

/// Largest tensor file, which is read whole.
pub const MAX_TENSOR_BYTES: u64 = 2 << 30;

/// Reads the file at `path`, at most `limit` bytes. Fails if the file is unreadable or longer, or
/// if `path` is a folder, pipe or device.
pub fn read_file(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let too_long = |found: u64| {
        let message = format!("{found} bytes found, at most {limit} are read");
        io::Error::new(io::ErrorKind::FileTooLarge, message)
    };
    let stated = match regular(path) {
        // The shell passes a descriptor, as in `config show <(...)`.
        Err(_) if is_descriptor(path) => 0,
        found => found?,
    };
    if stated > limit {
        return Err(too_long(stated));
    }
    let mut bytes = Vec::new();
    // One extra byte lets the read find the end without reallocation.
    bytes.try_reserve_exact(stated as usize + 1)?;
    // The file may grow meanwhile.
    File::open(path)?.take(limit + 1).read_to_end(&mut bytes)?;
    match bytes.len() as u64 > limit {
        true => Err(too_long(bytes.len() as u64)),
        false => Ok(bytes),
    }
}

/// True if the path is an open descriptor of this process.
fn is_descriptor(path: &Path) -> bool {
    ["/dev/fd", "/dev/stdin", "/proc/self/fd"]
        .iter()
        .any(|open| path.starts_with(open))
}

/// Reads the UTF-8 or UTF-16 text of the file at `path`, without a byte order mark. Fails as
/// [`read_file`] with [`MAX_TEXT_BYTES`], and for text in another encoding.
pub fn read_text(path: &Path) -> io::Result<String> {
    let bytes = read_file(path, MAX_TEXT_BYTES)?;
    let text = utf_16(&bytes).map_or_else(|| String::from_utf8(bytes), Ok);
    let text = text.map_err(|error| {
        let place = error.utf8_error().valid_up_to();
        let problem = format!("byte {place} is not UTF-8 text: save the file in UTF-8");
        io::Error::new(io::ErrorKind::InvalidData, problem)
    })?;
    Ok(text
        .strip_prefix('\u{feff}')
        .map(str::to_owned)
        .unwrap_or(text))
}

/// The text of UTF-16 bytes, which begin with a byte order mark or a letter of ASCII; none for
/// other bytes. Malformed pairs become replacement characters.
pub fn utf_16(bytes: &[u8]) -> Option<String> {
    let word: fn([u8; 2]) -> u16 = match bytes {
        [0xff, 0xfe, ..] => u16::from_le_bytes,
        [0xfe, 0xff, ..] => u16::from_be_bytes,
        [1..=0x7f, 0, 1..=0x7f, 0, ..] => u16::from_le_bytes,
        [0, 1..=0x7f, 0, 1..=0x7f, ..] => u16::from_be_bytes,
        _ => return None,
    };
    let (pairs, _) = bytes.as_chunks::<2>();
    let words: Vec<u16> = pairs.iter().map(|pair| word(*pair)).collect();
    Some(String::from_utf16_lossy(&words))
}

/// True if `path` lies in the folder `root` after links are followed. Fails if either is missing.
pub fn is_inside(root: &Path, path: &Path) -> io::Result<bool> {
    Ok(path.canonicalize()?.starts_with(root.canonicalize()?))
}

/// The length of the file at `path`. Fails for a missing file, a folder, a pipe or a device.
pub fn regular(path: &Path) -> io::Result<u64> {
    let metadata = fs::metadata(path)?;
    match metadata.is_file() {
        true => Ok(metadata.len()),
        false if metadata.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
        false => Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "it is a pipe or a device, not a file",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_within_the_bound_are_read() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        fs::write(&path, "four").expect("written");
        assert_eq!(read_file(&path, 4).expect("short enough"), b"four");
        let error = read_file(&path, 3).expect_err("too long").to_string();
        assert_eq!(error, "4 bytes found, at most 3 are read");
        let error = read_file(folder.path(), 4).expect_err("a folder");
        assert_eq!(error.kind(), io::ErrorKind::IsADirectory);
    }

    #[test]
    fn texts_are_read_in_the_encodings_of_windows() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        let text = "[train]\nname = \"tänzerin\"\n";
        let marked = format!("\u{feff}{text}");
        let utf_16 = |text: &str, bytes: fn(u16) -> [u8; 2]| -> Vec<u8> {
            text.encode_utf16().flat_map(bytes).collect()
        };
        for bytes in [
            text.as_bytes().to_vec(),
            marked.as_bytes().to_vec(),
            utf_16(&marked, u16::to_le_bytes),
            utf_16(&marked, u16::to_be_bytes),
            utf_16(text, u16::to_le_bytes),
            utf_16(text, u16::to_be_bytes),
        ] {
            fs::write(&path, &bytes).expect("written");
            assert_eq!(read_text(&path).expect("text"), text, "{bytes:?}");
        }
        fs::write(&path, b"name = \"t\xe4nzerin\"").expect("written");
        let error = read_text(&path).expect_err("Latin-1").to_string();
        assert_eq!(error, "byte 9 is not UTF-8 text: save the file in UTF-8");
    }

    #[cfg(unix)]
    #[test]
    fn what_may_never_end_is_not_opened() {
        let error = read_text(Path::new("/dev/zero")).expect_err("a device");
        assert!(error.to_string().contains("a device"), "{error}");
    }
}
