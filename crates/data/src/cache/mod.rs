//! Caches: items in memory, files of remote datasets on disk.

mod disk;
mod memory;

pub(crate) use disk::DiskCache;
pub(crate) use memory::MemoryCache;
