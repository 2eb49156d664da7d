//! How time and memory grow with what is filmed: pixels, cameras, features, frames.
//!
//! `cargo bench --bench growth -- [pixels|cameras|features|frames|memory|largest]`

mod growth {
    pub mod memory;

    use std::path::PathBuf;
    use stlfr::offset::chart::{Chart, svg};

    type Done<T> = Result<T, Box<dyn std::error::Error>>;

    /// An empty folder for a film, beside the other captures.
    pub fn folder(name: &str) -> Done<PathBuf> {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(".captures/growth").join(name);
        if folder.exists() {
            std::fs::remove_dir_all(&folder)?;
        }
        std::fs::create_dir_all(&folder)?;
        Ok(folder)
    }

    /// Writes charts, and says where.
    pub fn draw(name: &str, charts: &[Chart]) -> Done<()> {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/growth");
        std::fs::create_dir_all(&folder)?;
        let path = folder.join(name);
        std::fs::write(&path, svg(charts, 2))?;
        println!("{}", path.display());
        Ok(())
    }
}
#[path = "../common/peak.rs"]
mod peak;
#[path = "../common/swing.rs"]
#[allow(dead_code)]
mod swing;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    growth::memory::grow(&[100, 300, 1000, 3000])
}
