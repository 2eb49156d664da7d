//! Writes the job type for Flamenco, Blender's render farm manager. A job type is a script, which the user copies into
//! the folder `scripts` of Flamenco Manager.

use super::{FarmChunks, FarmJob};
use serde_json::json;

const SCRIPT: &str = include_str!("flamenco.js");

pub(super) fn job_type(job: &FarmJob) -> String {
    let mut settings = vec![json!({
        "key": "program", "type": "string", "required": true, "default": job.program,
        "description": "The program stlfr, as the workers find it",
    })];
    settings.extend(job.kinds().iter().map(|chunks| {
        json!({
            "key": setting(chunks), "type": "int32", "required": true, "default": chunks.size,
            "description": format!("Parts that a task of the step {} does", chunks.kind),
        })
    }));
    let steps = job.steps.iter().map(|step| {
        let chunks = step.chunks.as_ref();
        let chunks = chunks.map(|c| json!({"setting": setting(c), "count": c.count}));
        json!({"name": step.name, "arguments": step.arguments, "after": step.after, "chunks": chunks})
    });
    let steps: Vec<_> = steps.collect();
    let job_type = json!({"label": format!("stlfr: {}", job.name), "settings": settings});
    let values = [("JOB_TYPE", job_type), ("STEPS", steps.into())];
    let constants = values.map(|(name, value)| format!("const {name} = {value:#};\n"));
    constants.concat() + SCRIPT
}

/// Returns the name of the Flamenco job setting for the number of parts in a chunk.
fn setting(chunks: &FarmChunks) -> String {
    format!("{}_chunk", chunks.kind)
}
