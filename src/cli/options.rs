//! The command `stlfr options`, which lists all options.

use super::CliError;
use super::files::OptionsArgs;
use super::print::Page;
use crate::option::DeclaredOption;
use crate::options::RenderOptions;

/// List all options of an options file, with their values, ranges and units
///
/// `--options FILE` reads such a file, and `--set NAME=VALUE` sets one option.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr options\n  \
    stlfr options --preset draft --set blend.cameras=2\n  \
    stlfr options --schema > options.schema.json")]
pub struct OptionListArgs {
    #[command(flatten)]
    options: OptionsArgs,
    /// Print the list as JSON and nothing else.
    #[arg(long)]
    json: bool,
    /// Print the JSON Schema of an options file and nothing else.
    #[arg(long, conflicts_with = "json")]
    schema: bool,
}

pub fn run(args: &OptionListArgs, page: &mut Page) -> Result<(), CliError> {
    let options = args.options.read()?.declared();
    match (args.schema, args.json) {
        (true, _) => page.json(&RenderOptions::schema()),
        (_, true) => page.json(&options),
        _ => {
            let rows: Vec<[String; 4]> = options.iter().map(row).collect();
            let width = |column: usize| rows.iter().map(|row| row[column].len()).max().unwrap_or(0);
            let [name, value, range] = [0, 1, 2].map(width);
            for [n, v, r, help] in &rows {
                page.line(format_args!("{n:name$}  {v:value$}  {r:range$}  {help}"));
            }
            Ok(())
        }
    }
}

/// Returns the four columns of an option's row in the table: name, value, range with unit, and help text. The range is
/// empty unless the option is a number. For a choice, the help text lists the allowed names.
fn row(option: &DeclaredOption) -> [String; 4] {
    let value = option.value.as_str().map_or_else(|| option.value.to_string(), str::to_owned);
    let range = option.range.map(|range| {
        let [min, max] = range.map(|limit| match limit.abs() {
            0.0 | 1e-3..1e6 => limit.to_string(),
            _ => format!("{limit:e}"),
        });
        format!("{min}..{max} {}", option.unit.unwrap_or_default())
    });
    let names: Vec<_> = option.choices.iter().map(|choice| choice.name).collect();
    let names = if names.is_empty() { String::new() } else { format!(" ({})", names.join(", ")) };
    let help = format!("{}{names}", option.help.trim_end_matches('.'));
    [option.name.clone(), value, range.unwrap_or_default(), help]
}
