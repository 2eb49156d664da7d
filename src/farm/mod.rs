//! Jobs for render farms. A job consists of steps, each a command of `stlfr`, such as filming or rendering. A job is
//! written for three engines (Open Job Description, Slurm and Flamenco), which all run the same commands. Every command
//! may be run again: it then continues its work, or writes the same files.
//!
//! Known limit: all machines must see the program, the captures and the job's folder at the same paths.

mod flamenco;
mod openjd;
mod slurm;

use crate::host::write_atomically;
use std::path::Path;

/// A render farm job: a list of steps, in which every step comes after the steps that it depends on.
#[derive(Clone, Debug)]
pub struct FarmJob {
    /// Name of the job, as users of the farm see it.
    pub name: String,
    /// Path of the program `stlfr` on the farm's machines. It is a default, which users can replace when they submit
    /// the job.
    pub program: String,
    pub steps: Vec<FarmStep>,
}

/// A step of a render farm job: one command. The command is run once, or once for every chunk of its work. Chunks may
/// be run in any order.
#[derive(Clone, Debug)]
pub struct FarmStep {
    /// Name of the step: lower-case letters, digits and `-`.
    pub name: String,
    /// Arguments of the command `stlfr`, without `--part`.
    pub arguments: Vec<String>,
    /// Names of earlier steps that must succeed before this step starts.
    pub after: Vec<String>,
    /// Division of the step's work into chunks. The command is run once per chunk, with the additional argument
    /// `--part FIRST-LAST/COUNT`. `None` for a command that is run once.
    pub chunks: Option<FarmChunks>,
    pub needs: FarmNeeds,
}

/// Division of a step's work into parts, and of the parts into chunks. All steps with the same `kind` have the same
/// number of parts in a chunk. Users can change this number when they submit the job.
#[derive(Clone, Debug)]
pub struct FarmChunks {
    /// Kind of the work, such as `film`: a lower-case word. The chunk size is a setting of the job, whose name contains
    /// this word.
    pub kind: &'static str,
    /// Number of parts into which the work is divided.
    pub count: u32,
    /// Default number of parts in a chunk. Each task of the render farm does one chunk.
    pub size: u32,
}

/// Processor cores and memory that a machine needs to run a task.
#[derive(Clone, Copy, Debug)]
pub struct FarmNeeds {
    pub cores: u32,
    pub memory_mib: u32,
}

impl FarmJob {
    /// Returns the job's files for Open Job Description, Slurm and Flamenco, as pairs of file name and contents.
    pub fn files(&self) -> Vec<(String, String)> {
        let mut files = vec![
            ("openjd.json".to_owned(), openjd::template(self)),
            ("stlfr.js".to_owned(), flamenco::job_type(self)),
        ];
        files.extend(slurm::scripts(self));
        files
    }

    /// Writes the job's files for Open Job Description, Slurm and Flamenco into a folder.
    pub fn write(&self, folder: &Path) -> std::io::Result<()> {
        let mut files = self.files().into_iter();
        files.try_for_each(|(name, text)| write_atomically(&folder.join(name), text.as_bytes()))
    }

    /// Returns one [`FarmChunks`] for each kind of work in the job. Of several steps with the same kind, the first
    /// step's is returned.
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

    /// An argument with characters that are special in shells and in string literals.
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

    /// Runs the scripts without Slurm, with the environment variables that Slurm would set.
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
