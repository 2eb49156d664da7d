
function compileJob(job) {
    const tasks = {};
    for (const step of STEPS) {
        tasks[step.name] = parts(step.chunks, job.settings).map((part) => {
            const name = part.length ? step.name + " " + part[1] : step.name;
            const task = author.Task(name, "misc");
            task.addCommand(author.Command("exec", {
                exe: job.settings.program,
                args: step.arguments.concat(part),
            }));
            for (const earlier of step.after) {
                tasks[earlier].forEach((other) => task.addDependency(other));
            }
            job.addTask(task);
            return task;
        });
    }
}

// Returns one list per task of a step: the task's additional arguments, which choose its parts of the work.
function parts(chunks, settings) {
    if (!chunks) {
        return [[]];
    }
    const size = Math.max(1, settings[chunks.setting]);
    const found = [];
    for (let first = 1; first <= chunks.count; first += size) {
        const last = Math.min(first + size - 1, chunks.count);
        found.push(["--part", first + "-" + last + "/" + chunks.count]);
    }
    return found;
}
