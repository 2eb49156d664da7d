//! The command line. A command's module has the arguments of the command, and calls the library. The program
//! `stlfr` and the command that the Python module installs both call [`main`].

mod calibrate;
mod capture;
mod compare;
mod display;
mod error;
mod export;
mod farm;
mod files;
mod frames;
mod import;
mod info;
mod offsets;
mod options;
mod plan;
mod prepare;
mod print;
mod publish;
mod render;
mod rig;
mod shots;
mod toolchain;
mod tradeoff;
mod values;
mod view;
mod view_writer;
mod viewpoint;

use crate::host::{remove_unfinished_on_signals, reuse_freed_memory};
use crate::progress::Reporter;
use clap::{Parser, Subcommand};
use error::CliError;
use print::Page;
use std::ffi::OsString;
use std::path::Path;

/// Runs a command line and returns the exit code. The first of the `arguments` is the name of the program. `program` is
/// the path of the program, which `stlfr farm` writes into jobs. If `in_lines` is true, progress is printed on standard
/// output as lines of JSON. After this call, SIGINT, SIGTERM and SIGHUP end the process.
pub fn main(program: &Path, arguments: impl IntoIterator<Item = OsString>, in_lines: bool) -> u8 {
    reuse_freed_memory();
    // If this call fails, the next run removes the files that an interrupted run leaves.
    let _ = remove_unfinished_on_signals();
    match Cli::try_parse_from(arguments) {
        Ok(cli) => {
            let reporter = if in_lines { Reporter::lines() } else { Reporter::new(cli.quiet) };
            error::exit(cli.run(program, &reporter))
        }
        Err(error) => error::usage(&error),
    }
}

/// Render the view from anywhere, at any instant, from cameras that are not synchronized.
#[derive(Debug, Parser)]
#[command(
    name = "stlfr",
    version,
    propagate_version = true,
    arg_required_else_help = true,
    after_help = "Exit codes: 0 done, 2 something given is wrong, 1 the work failed.\n\
                  Times are seconds on the reference camera's clock."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print no progress and no notes; errors are still printed on stderr.
    #[arg(long, short, global = true, display_order = 998)]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(toolchain::DemoArgs),
    Setup(toolchain::SetupArgs),
    Rig(Box<rig::RigArgs>),
    Capture(Box<capture::CaptureArgs>),
    Info(info::InfoArgs),
    Calibrate(Box<calibrate::CalibrateArgs>),
    Refine(calibrate::RefineArgs),
    Check(toolchain::CheckArgs),
    Plan(plan::PlanArgs),
    Offsets(offsets::OffsetsArgs),
    Prepare(prepare::PrepareArgs),
    Render(Box<render::RenderArgs>),
    View(view::ViewArgs),
    Publish(publish::PublishArgs),
    Compare(compare::CompareArgs),
    Tradeoff(tradeoff::TradeoffArgs),
    Options(options::OptionListArgs),
    Import(Box<import::ImportArgs>),
    Export(Box<export::ExportArgs>),
    Farm(Box<farm::FarmArgs>),
}

impl Cli {
    /// Runs the command, and prints the output that it has collected, even if the command fails.
    fn run(&self, program: &Path, reporter: &Reporter) -> Result<(), CliError> {
        let mut page = Page::default();
        let result = self.run_on(program, &mut page, reporter);
        result.and(page.print())
    }

    fn run_on(&self, program: &Path, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
        match &self.command {
            Command::Demo(args) => toolchain::run_demo(args, page, reporter),
            Command::Setup(args) => toolchain::run_setup(args, page, reporter),
            Command::Rig(args) => rig::run(args, page),
            Command::Capture(args) => capture::run(args, page, reporter),
            Command::Info(args) => info::run(args, page, reporter),
            Command::Calibrate(args) => calibrate::run(args, page, reporter),
            Command::Refine(args) => calibrate::run_refine(args, page, reporter),
            Command::Check(args) => toolchain::run_check(args, page, reporter),
            Command::Plan(args) => plan::run(args, page, reporter),
            Command::Offsets(args) => offsets::run(args, page, reporter),
            Command::Prepare(args) => prepare::run(args, page, reporter),
            Command::Render(args) => render::run(args, reporter),
            Command::View(args) => view::run(args, reporter),
            Command::Publish(args) => publish::run(args, page, reporter),
            Command::Compare(args) => compare::run(args, page, reporter),
            Command::Tradeoff(args) => tradeoff::run(args, page, reporter),
            Command::Options(args) => options::run(args, page),
            Command::Import(args) => import::run(args, reporter),
            Command::Export(args) => export::run(args, reporter),
            Command::Farm(args) => farm::run(args, program, page, reporter),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definitions_hold() {
        Cli::command().debug_assert();
    }
}
