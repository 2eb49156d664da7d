//! Offset errors, rung by rung, on a capture with truth.
//!
//! `cargo bench --bench offsets -- CAPTURE`

use std::time::Instant;
use stlfr::capture::{Capture, Truth};
use stlfr::offset::{OffsetOptions, OffsetRung, estimate};
use stlfr::progress::Reporter;
use stlfr::registration::RegistrationOptions;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folders = std::env::args().skip(1).filter(|a| !a.starts_with("--"));
    for folder in folders {
        let capture = std::sync::Arc::new(Capture::open(folder.as_ref())?);
        let truth = Truth::open(folder.as_ref())?.ok_or("has no truth")?;
        println!("{folder}: errors in frames");
        for rung in [OffsetRung::Pairwise, OffsetRung::Joint, OffsetRung::JointCurved] {
            let options = OffsetOptions { rung, ..Default::default() };
            let start = Instant::now();
            let estimate =
                estimate(&capture, &options, &RegistrationOptions::default(), &Reporter::silent())?;
            let seconds = start.elapsed().as_secs_f64();
            let mut errors = Vec::new();
            print!("  {rung:12?}");
            for o in &estimate.offsets.cameras {
                match (o.offset_s, truth.offset_s(&o.id)) {
                    (Some(o_s), Some(t_s)) => {
                        let error = (o_s - t_s) / capture.frame_s();
                        let z = (o_s - t_s) / o.std_err_s.unwrap_or(0.0).max(1e-12);
                        print!(" {}{error:+.4} ({z:+.1}σ)", if o_s == 0.0 { "=" } else { "" });
                        if o_s != 0.0 {
                            errors.push(error.abs());
                        }
                    }
                    _ => print!(" unknown"),
                }
            }
            errors.sort_by(f64::total_cmp);
            if let Some(worst) = errors.last() {
                print!("  median {:.4}, worst {worst:.4}", errors[errors.len() / 2]);
            }
            println!("  {} pairs, {seconds:.2} s", estimate.pairs.len());
        }
    }
    Ok(())
}
