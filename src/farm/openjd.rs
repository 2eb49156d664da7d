//! Writes the job template for Open Job Description, version 2023-09 with the extension `TASK_CHUNKING`. AWS Deadline
//! Cloud runs such templates; the program `openjd` runs them on one machine.

use super::{FarmChunks, FarmJob, FarmStep};
use serde_json::{Value, json};

pub(super) fn template(job: &FarmJob) -> String {
    let mut parameters = vec![json!({
        "name": "Program", "type": "STRING", "default": job.program,
        "description": "The program stlfr, as the machines find it.",
    })];
    parameters.extend(job.kinds().iter().map(|chunks| {
        json!({
            "name": parameter(chunks), "type": "INT", "default": chunks.size, "minValue": 1,
            "description": format!("Parts that a task of the step {} does.", chunks.kind),
        })
    }));
    let template = json!({
        "specificationVersion": "jobtemplate-2023-09",
        "extensions": ["TASK_CHUNKING"],
        "name": job.name,
        "parameterDefinitions": parameters,
        "steps": job.steps.iter().map(step).collect::<Vec<_>>(),
    });
    format!("{template:#}\n")
}

/// Returns the name of the template's parameter for the number of parts in a chunk.
fn parameter(chunks: &FarmChunks) -> String {
    let (initial, rest) = chunks.kind.split_at(1);
    format!("{}{rest}Chunk", initial.to_uppercase())
}

fn step(step: &FarmStep) -> Value {
    let mut arguments = step.arguments.clone();
    let mut described = json!({
        "name": step.name,
        "hostRequirements": {"amounts": [
            {"name": "amount.worker.vcpu", "min": step.needs.cores},
            {"name": "amount.worker.memory", "min": step.needs.memory_mib},
        ]},
    });
    if !step.after.is_empty() {
        let after: Vec<Value> = step.after.iter().map(|name| json!({"dependsOn": name})).collect();
        described["dependencies"] = after.into();
    }
    if let Some(chunks) = &step.chunks {
        arguments.extend(["--part".into(), format!("{{{{Task.Param.Part}}}}/{}", chunks.count)]);
        described["parameterSpace"] = json!({"taskParameterDefinitions": [{
            "name": "Part", "type": "CHUNK[INT]", "range": format!("1-{}", chunks.count),
            "chunks": {
                "defaultTaskCount": format!("{{{{Param.{}}}}}", parameter(chunks)),
                "rangeConstraint": "CONTIGUOUS",
            },
        }]});
    }
    described["script"] =
        json!({"actions": {"onRun": {"command": "{{Param.Program}}", "args": arguments}}});
    described
}
