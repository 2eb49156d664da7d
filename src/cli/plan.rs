//! `stlfr plan`

use super::CliError;
use super::error::written;
use super::files::{CommandOutput, OptionsArgs, open_capture};
use super::print::Page;
use std::path::PathBuf;
use std::sync::Arc;
use stlfr::host::write_json;
use stlfr::options::AutoOptions;
use stlfr::pipeline;
use stlfr::plan::{Plan, plan};
use stlfr::progress::Reporter;

/// What this capture requires, and why: for every stage the cheapest method that keeps its error
/// within a budget.
///
/// `--sync auto`, `--proxy auto` and `--blend auto` of `render`, and `auto` in an options file, choose by it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr plan .captures/demo\n  \
    stlfr plan .captures/demo --budget-px 0.1 -o options.json\n  \
    stlfr render .captures/demo --options options.json --like cam3 --time 0.1 -o cam3.png")]
pub struct PlanArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// How far a cheaper method may move what is seen, pixels [default: 0.25].
    #[arg(long, value_name = "PX")]
    budget_px: Option<f64>,
    /// Print JSON and nothing else.
    #[arg(long)]
    json: bool,
    /// Write the options of all stages, with the methods chosen, into a file.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    options: OptionsArgs,
}

pub fn run(args: &PlanArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    let mut options = args.options.read()?;
    options.auto.budget_px = args.budget_px.unwrap_or(options.auto.budget_px);
    let given = &options.auto;
    let (budget_px, budget_db) = (given.budget_px, given.budget_db);
    options.auto = AutoOptions { budget_px, budget_db, ..AutoOptions::all() };
    options.check().map_err(|error| CliError::BadInput(error.to_string()))?;
    let capture = Arc::new(open_capture(&args.capture, reporter)?);
    if let Some(output) = &args.output {
        CommandOutput::File(output).check(Some(&args.capture))?;
    }
    let field = pipeline::open_field(capture.clone(), &options, reporter)?;
    let plan = plan(&field, &options, reporter)?;
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
    for decision in &plan.decisions {
        let (stage, method) = (decision.choice.stage().name(), decision.choice.name());
        page.line(format_args!("{stage:<11} {method:<15} {}", decision.because));
    }
    page.line(format_args!("Budget: {} px.", plan.budget_px));
}
