//! `stlfr options`

use super::CliError;
use super::files::OptionsArgs;
use super::print::Page;
use stlfr::option::DeclaredOption;
use stlfr::options::RenderOptions;

/// List all options of an options file, with their values, ranges and units
///
/// `--options FILE` reads such a file, and `--set NAME=VALUE` sets one option.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr options\n  \
    stlfr options --preset draft --set blend.cameras=2\n  \
    stlfr options --schema > options.schema.json")]
pub struct Args {
    #[command(flatten)]
    options: OptionsArgs,
    /// Print the list as JSON and nothing else.
    #[arg(long)]
    json: bool,
    /// Print the JSON Schema of an options file and nothing else.
    #[arg(long, conflicts_with = "json")]
    schema: bool,
}

pub fn run(args: &Args, page: &mut Page) -> Result<(), CliError> {
    let options = args.options.read()?.declared();
    match (args.schema, args.json) {
        (true, _) => page.json(&RenderOptions::schema()),
        (_, true) => page.json(&options),
        _ => {
            let rows: Vec<[String; 4]> = options.iter().map(row).collect();
            let width = |column: usize| rows.iter().map(|row| row[column].len()).max().unwrap_or(0);
            let [name, value, allowed] = [0, 1, 2].map(width);
            for row in &rows {
                let [n, v, a, help] = row;
                page.line(format_args!("{n:name$}  {v:value$}  {a:allowed$}  {help}"));
            }
            Ok(())
        }
    }
}

/// Name, value, allowed values, and help.
fn row(option: &DeclaredOption) -> [String; 4] {
    let value = option.value.as_str().map_or_else(|| option.value.to_string(), str::to_owned);
    let allowed = match option.range {
        Some([min, max]) => format!("{min}..{max} {}", option.unit.unwrap_or_default()),
        None => option.choices.iter().map(|choice| choice.name).collect::<Vec<_>>().join("|"),
    };
    [option.name.clone(), value, allowed, option.help.clone()]
}
