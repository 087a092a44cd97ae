//! Weights that `torch.save` wrote: `kinegrad_train::published::read_tensors`.

#![no_main]

use std::path::PathBuf;
use std::sync::LazyLock;
use std::{env, fs, process};

use kinegrad_fuzz::{MIB, bounded};
use kinegrad_train::published::read_tensors;
use libfuzzer_sys::fuzz_target;

/// The reader needs a file.
static PATH: LazyLock<PathBuf> =
    LazyLock::new(|| env::temp_dir().join(format!("kinegrad_fuzz_{}.pt", process::id())));

// The reader of pickles copies at most 2^20 values and 64 MiB. A value has at least one byte in the
// file and takes a hundred in memory. All tensors together are at most four times the file.
fuzz_target!(|bytes: &[u8]| {
    fs::write(&*PATH, bytes).expect("a temporary file");
    let limit = 512 * MIB + 512 * bytes.len();
    let Ok(tensors) = bounded(limit, || read_tensors(&PATH)) else {
        return;
    };
    for tensor in tensors.values() {
        let read = bounded(limit, || tensor.read());
        assert!(read.is_err() || read.is_ok_and(|read| read.len() <= 4 * bytes.len()));
    }
});
