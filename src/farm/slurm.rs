//! Writes shell scripts for the cluster scheduler Slurm: a batch script for every step, and `submit.sh`, which submits
//! all batch scripts.

use super::{FarmChunks, FarmJob, FarmStep};
use std::fmt::Write;

pub(super) fn scripts(job: &FarmJob) -> Vec<(String, String)> {
    let steps = job.steps.iter().map(|step| (file(step), script(job, step)));
    steps.chain([("submit.sh".to_owned(), submit(job))]).collect()
}

fn file(step: &FarmStep) -> String {
    format!("{}.sh", step.name)
}

/// Returns the name of the environment variable for the number of parts in a chunk.
fn variable(chunks: &FarmChunks) -> String {
    format!("{}_CHUNK", chunks.kind.to_uppercase())
}

/// Returns a word in single quotes, escaped so that the shell takes it literally.
fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// Returns the batch script of a step. If the node that runs a task fails, Slurm runs the task again on another node.
fn script(job: &FarmJob, step: &FarmStep) -> String {
    let words: Vec<String> = step.arguments.iter().map(|word| quoted(word)).collect();
    let mut command = format!("\"$program\" {}", words.join(" "));
    let mut parts = String::new();
    let mut log = "%x-%j.out";
    if let Some(FarmChunks { count, .. }) = step.chunks {
        parts = format!(
            "first=$(( (SLURM_ARRAY_TASK_ID - 1) * CHUNK + 1 ))\n\
             last=$(( first + CHUNK - 1 ))\n\
             if [ \"$last\" -gt {count} ]; then last={count}; fi\n"
        );
        command += &format!(" --part \"$first-$last/{count}\"");
        log = "%x-%A-%a.out";
    }
    format!(
        "#!/bin/sh\n\
         #SBATCH --job-name=stlfr-{name}\n\
         #SBATCH --output={log}\n\
         #SBATCH --open-mode=append\n\
         #SBATCH --requeue\n\
         #SBATCH --ntasks=1\n\
         #SBATCH --cpus-per-task={cores}\n\
         #SBATCH --mem={memory}M\n\
         program=${{STLFR:-{program}}}\n\
         {parts}exec {command}\n",
        name = step.name,
        cores = step.needs.cores,
        memory = step.needs.memory_mib,
        program = quoted(&job.program),
    )
}

fn submit(job: &FarmJob) -> String {
    let mut text = "#!/bin/sh\n\
                    # Submits all steps; each starts when those that it needs have succeeded.\n\
                    # Arguments are those of sbatch, such as --partition=NAME. Variables:\n\
                    # STLFR, the program; and the number of parts that one task does:\n"
        .to_owned();
    for chunks in job.kinds() {
        let _ = writeln!(text, "# {}, {} if it is not set.", variable(chunks), chunks.size);
    }
    text += "set -eu\ncd \"$(dirname \"$0\")\"\n";
    for chunks in job.kinds() {
        let _ = writeln!(text, ": \"${{{}:={}}}\"", variable(chunks), chunks.size);
    }
    for step in &job.steps {
        let mut options = String::new();
        if !step.after.is_empty() {
            let after: Vec<String> =
                step.after.iter().map(|name| format!("${{{}%%;*}}", id(name))).collect();
            let _ = write!(
                options,
                " --dependency=afterok:{} --kill-on-invalid-dep=yes",
                after.join(":")
            );
        }
        if let Some(chunks) = &step.chunks {
            let (count, size) = (chunks.count, variable(chunks));
            let _ = write!(options, " --array=1-$(( ({count} + {size} - 1) / {size} ))");
            let _ = write!(options, " --export=ALL,CHUNK=\"${size}\"");
        }
        let (id, file) = (id(&step.name), file(step));
        let _ = writeln!(text, "{id}=$(sbatch --parsable{options} \"$@\" {file})");
        let _ = writeln!(text, "echo \"${{{id}%%;*}} {}\"", step.name);
    }
    text
}

/// Returns the name of the shell variable that holds the Slurm job id of a step.
fn id(step: &str) -> String {
    step.replace('-', "_")
}
