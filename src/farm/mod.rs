//! The work on a capture, described for the engines that share work among machines: Open Job Description, Slurm and
//! Flamenco. All run the same commands. Every one may be run again, and continues or gives the same files.
//!
//! Known limits: the machines see the program, the captures and the job's folder at the same paths.

mod flamenco;
mod openjd;
mod slurm;

use crate::host::write_atomically;
use std::path::Path;

/// The work, in an order in which it can be done.
#[derive(Clone, Debug)]
pub struct FarmJob {
    /// Its name for people.
    pub name: String,
    /// The program, which the engines' users may replace.
    pub program: String,
    pub steps: Vec<FarmStep>,
}

/// A command, run once, or for all chunks of its parts in any order.
#[derive(Clone, Debug)]
pub struct FarmStep {
    /// Lower-case letters, digits and `-`.
    pub name: String,
    /// Arguments of the program.
    pub arguments: Vec<String>,
    /// Names of earlier steps that must have succeeded.
    pub after: Vec<String>,
    /// `None`: the command is run once. Else `--part FIRST-LAST/COUNT` is added.
    pub chunks: Option<FarmChunks>,
    pub needs: FarmNeeds,
}

/// The parts of a step. Steps of one `kind` share the chunk size that the engine's user sets.
#[derive(Clone, Debug)]
pub struct FarmChunks {
    /// A lower-case word.
    pub kind: &'static str,
    /// Number of parts.
    pub count: u32,
    /// Parts that one task does, unless the engine's user changes it.
    pub size: u32,
}

/// What a machine must have for a task.
#[derive(Clone, Copy, Debug)]
pub struct FarmNeeds {
    pub cores: u32,
    pub memory_mib: u32,
}

impl FarmJob {
    /// The files that describe the work, by their names.
    pub fn files(&self) -> Vec<(String, String)> {
        let mut files = vec![
            ("openjd.json".to_owned(), openjd::template(self)),
            ("stlfr.js".to_owned(), flamenco::job_type(self)),
        ];
        files.extend(slurm::scripts(self));
        files
    }

    /// Writes the files that describe the work into a folder.
    pub fn write(&self, folder: &Path) -> std::io::Result<()> {
        let mut files = self.files().into_iter();
        files.try_for_each(|(name, text)| write_atomically(&folder.join(name), text.as_bytes()))
    }

    /// The first chunks of each kind.
    fn kinds(&self) -> Vec<&FarmChunks> {
        let mut kinds: Vec<&FarmChunks> = Vec::new();
        for chunks in self.steps.iter().filter_map(|step| step.chunks.as_ref()) {
            if kinds.iter().all(|known| known.kind != chunks.kind) {
                kinds.push(chunks);
            }
        }
        kinds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A name that a shell and a script's string would break.
    const NAME: &str = "it's a \"$HOME\" `x` \\";

    fn job() -> FarmJob {
        let needs = FarmNeeds { cores: 2, memory_mib: 3000 };
        let step = |name: &str, arguments: &[&str], after: &[&str], chunks| FarmStep {
            name: name.to_owned(),
            arguments: arguments.iter().map(|&a| a.to_owned()).collect(),
            after: after.iter().map(|&a| a.to_owned()).collect(),
            chunks,
            needs,
        };
        let chunks = Some(FarmChunks { kind: "film", count: 25, size: 10 });
        FarmJob {
            name: "test".to_owned(),
            program: "printf".to_owned(),
            steps: vec![
                step("setup", &["%s."], &[], None),
                step("film", &["%s.", NAME], &["setup"], chunks),
                step("check", &["%s.", "-x"], &["setup", "film"], None),
            ],
        }
    }

    fn file(name: &str) -> String {
        job().files().into_iter().find(|(n, _)| n == name).unwrap().1
    }

    /// The scripts run without Slurm, as Slurm would run them.
    #[test]
    fn slurm_scripts_give_the_arguments_as_they_are() {
        let folder = tempfile::tempdir().unwrap();
        job().write(folder.path()).unwrap();
        let mut said = String::new();
        for task in 1..=3 {
            let mut command = std::process::Command::new("sh");
            command.arg(folder.path().join("film.sh")).env("CHUNK", "10");
            let output = command.env("SLURM_ARRAY_TASK_ID", task.to_string()).output().unwrap();
            said += &String::from_utf8(output.stdout).unwrap();
        }
        let task = |parts: &str| format!("{NAME}.--part.{parts}/25.");
        assert_eq!(said, task("1-10") + &task("11-20") + &task("21-25"));
    }

    #[test]
    fn slurm_steps_wait_for_earlier_ones() {
        let submit = file("submit.sh");
        let lines: Vec<&str> = submit.lines().filter(|line| line.contains("=$(sbatch")).collect();
        assert!(lines[0].starts_with("setup=$(") && !lines[0].contains("--dependency"));
        assert!(lines[1].contains("--dependency=afterok:${setup%%;*}"), "{submit}");
        assert!(lines[1].contains("--array=1-$(( (25 + FILM_CHUNK - 1) / FILM_CHUNK ))"));
        assert!(lines[2].contains("--dependency=afterok:${setup%%;*}:${film%%;*}"), "{submit}");
        assert!(file("film.sh").contains("#SBATCH --mem=3000M\n"));
    }

    #[test]
    fn the_template_and_the_job_type_hold_every_argument() {
        let template: serde_json::Value = serde_json::from_str(&file("openjd.json")).unwrap();
        let action = &template["steps"][1]["script"]["actions"]["onRun"];
        assert_eq!(action["args"][1], NAME);
        assert_eq!(action["args"][3], "{{Task.Param.Part}}/25");
        let job_type = file("stlfr.js");
        assert!(job_type.contains(&serde_json::to_string(NAME).unwrap()), "{job_type}");
    }
}
