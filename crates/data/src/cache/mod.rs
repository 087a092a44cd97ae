//! Caches: items in memory, remote files on disk.

mod disk;
mod memory;

pub(crate) use disk::DiskCache;
pub(crate) use memory::MemoryCache;
