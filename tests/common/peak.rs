//! The most memory that a program held at once.

use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// What a run took.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    /// Resident at most, MiB.
    pub peak_mib: f64,
    pub seconds: f64,
    pub status: ExitStatus,
}

/// Runs a program to its end; what it says is passed over.
pub fn run(command: &mut Command) -> Run {
    let start = Instant::now();
    let mut child =
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts");
    // The kernel's own high-water mark of the program after its start, unlike that of getrusage,
    // which holds what the process was before it. It only rises, so that little is lost at the end.
    let mut peak_mib = 0.0_f64;
    loop {
        peak_mib = peak_mib.max(high_water_mib(&child).unwrap_or(0.0));
        if let Some(status) = child.try_wait().expect("the program can be waited for") {
            return Run { peak_mib, seconds: start.elapsed().as_secs_f64(), status };
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn high_water_mib(child: &Child) -> Option<f64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0)
}
