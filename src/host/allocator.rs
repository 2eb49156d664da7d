//! Settings of glibc's allocator; elsewhere they do nothing.

#[cfg(all(target_os = "linux", target_env = "gnu"))]
mod glibc {
    /// Blocks of at least this size, bytes, are mapped and unmapped one by one; the allocator's largest on 64 bits.
    /// Larger: it is ignored. Smaller: the kernel clears an image's pages at every use, and interrupts the other
    /// threads to unmap them (a tenth of a view's time over depth per pixel).
    const MMAP_THRESHOLD: i32 = 32 << 20;
    /// Free memory at the top of the main arena, bytes, above which it is returned; other arenas return whole heaps.
    /// Larger: what a stage has freed stays until the program ends; smaller: as above.
    const TRIM_THRESHOLD: i32 = 128 << 20;
    /// How many arenas a server has. More: freed images stay in the arena of the thread that made them, which over
    /// minutes adds a hundred megabytes; fewer than two: threads wait for each other.
    const ARENAS: i32 = 2;

    fn set(parameter: i32, value: i32) {
        // SAFETY: it sets a number of the allocator, which takes effect where memory is next had or freed.
        unsafe {
            libc::mallopt(parameter, value);
        }
    }

    pub fn reuse_freed_memory() {
        set(libc::M_MMAP_THRESHOLD, MMAP_THRESHOLD);
        set(libc::M_TRIM_THRESHOLD, TRIM_THRESHOLD);
    }

    pub fn bound_arenas() {
        set(libc::M_ARENA_MAX, ARENAS);
    }
}

/// Keeps what one image has freed for the next. For programs alone, not for libraries in other processes.
pub fn reuse_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    glibc::reuse_freed_memory();
}

/// Keeps the memory of a server that runs for long near what it holds.
pub fn bound_arenas() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    glibc::bound_arenas();
}
