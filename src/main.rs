//! The program `stlfr`, the library's command line.

use std::process::ExitCode;

fn main() -> ExitCode {
    let program = std::env::current_exe().unwrap_or_else(|_| "stlfr".into());
    ExitCode::from(stlfr::cli::main(&program, std::env::args_os(), false))
}
