//! The command `stlfr plan`, which chooses methods by measurements of a capture.

use super::CliError;
use super::error::written;
use super::files::{CommandOutput, OptionsArgs, open_capture};
use super::print::Page;
use crate::host::write_json;
use crate::options::AutoOptions;
use crate::pipeline;
use crate::plan::{Decision, Plan};
use crate::progress::Reporter;
use std::path::PathBuf;

/// Choose for every stage the cheapest method whose error on this capture is within a budget, and give the reason.
///
/// `--sync auto`, `--proxy auto` and `--blend auto` of `render`, and `auto` in an options file, use this plan to choose
/// methods.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr plan .captures/demo\n  \
    stlfr plan .captures/demo --budget-px 0.1 -o options.json\n  \
    stlfr render .captures/demo --options options.json --like cam3 --time 0.1 -o cam3.png")]
pub struct PlanArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// Largest displacement of a surface in the image that a cheaper method may cause, in pixels [default: 0.25].
    #[arg(long, value_name = "PX")]
    budget_px: Option<f64>,
    /// Print JSON and nothing else.
    #[arg(long)]
    json: bool,
    /// Write the options of all stages, with the chosen methods, into a file.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    options: OptionsArgs,
}

pub fn run(args: &PlanArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    let mut options = args.options.read()?;
    options.auto.budget_px = args.budget_px.unwrap_or(options.auto.budget_px);
    let AutoOptions { budget_px, budget_db, .. } = options.auto;
    options.auto = AutoOptions { budget_px, budget_db, ..AutoOptions::all() };
    options.check()?;
    let output = args.output.as_deref().map(CommandOutput::File);
    let capture = open_capture(&args.capture, output, reporter)?;
    let field = pipeline::open_field(capture, &options, reporter)?;
    let plan = pipeline::plan_again(&field, &options, reporter)?;
    if let Some(output) = &args.output {
        written(output, write_json(output, &plan.options))?;
    }
    if args.json {
        page.json(&plan)?;
    } else {
        print_table(&plan, page);
    }
    Ok(())
}

fn print_table(plan: &Plan, page: &mut Page) {
    for Decision { stage, method, because, .. } in &plan.decisions {
        page.line(format_args!("{stage:<11} {method:<15} {because}"));
    }
    page.line(format_args!("Budget: {} px.", plan.budget_px));
}
