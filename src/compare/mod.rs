//! §8.
mod filter;
pub mod flip;
pub mod mask;
pub mod metrics;
pub mod ssim;
