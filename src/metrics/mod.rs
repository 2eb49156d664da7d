//! Image quality in comparison with a ground-truth image: PSNR, SSIM and FLIP, over any set of pixels.

mod filter;
pub mod flip;
mod mask;
mod scores;
pub mod ssim;

pub use mask::moving_part;
pub use scores::{ErrorMaps, ReferenceImage, RegionScores, Scores, median};
