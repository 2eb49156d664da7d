//! Access to the machine: bounded reading and atomic writing of files, child processes, signals, clocks, the
//! allocator, caches in memory and on disk, and work items that processes share.

mod cache;
mod claims;
mod disk_cache;
mod file_hashes;
mod files;
mod machine;
pub(crate) mod process;
pub(crate) mod temporary;

pub use cache::{BoundedCache, Memo};
pub use claims::{Claim, Claims, Taken};
pub(crate) use disk_cache::ENTRY_OVERHEAD_BYTES;
pub use disk_cache::{CacheKind, CacheUse, DiskCache};
pub(crate) use file_hashes::{HeldFile, file_hash, file_hashes};
pub(crate) use files::{FileRead, FileState, read_hashed};
pub(crate) use files::{beneath, hash_file, ignore_absent, remove_special};
pub use files::{obstacle, open_bounded, open_file, read_bytes, read_text};
pub(crate) use machine::lock;
pub use machine::{
    Elapsed, Stopwatch, bound_arenas, memory_bytes, on_workers, process_cpu_s, reuse_freed_memory,
};
pub use temporary::{remove_unfinished_on_signals, try_folder, write_atomically, write_json};
