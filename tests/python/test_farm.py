"""`stlfr farm`: what the engines make of its description."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from filming import ROOT, run

OPENJD = Path(sys.executable).with_name("openjd")
FILM = ["--scene", "magazine", "--engine", "workbench", "--size", "160x120"]
FILM += ["--frames", "6", "--instants", "1"]
RENDER = ["--like", "cam3", "--times", "0.05:0.1:5", "--render-chunk", "2"]
RIG = str(ROOT / "rigs/linear8.json")


def farm(program: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return run([str(program), "farm", *map(str, arguments)])


@pytest.fixture(scope="module")
def job(program: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A job with all steps, in folders with names that quoting must keep."""
    folder = tmp_path_factory.mktemp("farm")
    capture, job = folder / "it's a capture", folder / "a job"
    chunks = ["--film-parts", "5", "--film-chunk", "3", "--preset", "draft"]
    result = farm(program, capture, "-o", job, "--rig", RIG, *FILM, *RENDER, *chunks)
    assert result.returncode == 0, result.stderr
    return job


def openjd(*arguments: object) -> subprocess.CompletedProcess[str]:
    return run([str(OPENJD), *map(str, arguments)])


def test_the_template_is_an_open_job_description(job: Path) -> None:
    checked = openjd("check", job / "openjd.json")
    assert checked.returncode == 0, checked.stdout
    summed = openjd("summary", job / "openjd.json", "-p", "FilmChunk=2")
    for words in ("Total steps: 8", "'film' (5 total", "'compare' (1 total"):
        assert words in summed.stdout, summed.stdout


def test_the_whole_template_runs_and_may_run_again(job: Path, program: Path) -> None:
    """By the reference engine: twice the same files, and those of one command."""
    capture = job.parent / "it's a capture"
    filmed = []
    for step, more in (
        ("compare", "--run-dependencies"),
        ("film", "--no-run-dependencies"),
        ("render", "--no-run-dependencies"),
    ):
        ended = openjd("run", job / "openjd.json", "--step", step, more)
        assert ended.returncode == 0, ended.stdout[-3000:]
        images = sorted(capture.glob("cam*/*.png"))
        filmed.append([(path.name, path.stat().st_mtime_ns) for path in images])
    assert filmed[0] == filmed[1] == filmed[2] and len(filmed[0]) >= 6 * 8
    assert (capture / "review/report.html").is_file()
    rendered = sorted((job / "frames").iterdir())
    assert [path.name for path in rendered] == [f"{k:06}.png" for k in range(5)]
    again = job.parent / "again"
    shutil.copytree(job / "frames", again)
    command = [str(program), "render", str(capture), *RENDER[:4], "--preset", "draft"]
    whole = run([*command, "-o", str(again / "%06d.png")])
    assert whole.returncode == 0, whole.stderr
    for path in rendered:
        assert path.read_bytes() == (again / path.name).read_bytes()


STUB = """
const tasks = [];
const author = {
    Command: (name, parameters) => ({name, parameters}),
    Task: (name, type) => ({
        name, type, commands: [], after: [],
        addCommand(command) { this.commands.push(command); },
        addDependency(task) { this.after.push(task.name); },
    }),
};
const settings = Object.fromEntries(JOB_TYPE.settings.map((s) => [s.key, s.default]));
compileJob({settings, addTask: (task) => tasks.push(task)});
document.title = "";
document.body.textContent = encodeURIComponent(JSON.stringify({label: JOB_TYPE.label, tasks}));
"""
"""What Flamenco's manager does with a job type."""


def test_flamenco_makes_the_tasks(job: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    script = (job / "stlfr.js").read_text()
    page.write_text(f"<body><script>{script}{STUB}</script></body>")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    dumped = run(["chromium", *options, f"--user-data-dir={tmp_path}", page.as_uri()])
    body = dumped.stdout.split("<body>")[1].split("</body>")[0]
    said: dict[str, Any] = json.loads(unquote(body))
    tasks = {task["name"]: task for task in said["tasks"]}
    assert said["label"] == "stlfr: it's a capture"
    assert list(tasks) == [
        "setup",
        "film 1-3/5",
        "film 4-5/5",
        "capture",
        "check",
        "offsets",
        "prepare",
        "render 1-2/5",
        "render 3-4/5",
        "render 5-5/5",
        "compare",
    ]
    assert tasks["capture"]["after"] == ["film 1-3/5", "film 4-5/5"]
    template = json.loads((job / "openjd.json").read_text())
    [command] = tasks["film 4-5/5"]["commands"]
    assert command["name"] == "exec"
    arguments = template["steps"][1]["script"]["actions"]["onRun"]["args"]
    assert command["parameters"]["args"] == [*arguments[:-1], "4-5/5"]


def test_what_a_job_cannot_be_made_of_is_refused(
    program: Path, capture_dir: Path, tmp_path: Path
) -> None:
    job = tmp_path / "job"
    for arguments, complaint in (
        ([tmp_path / "nowhere"], "nowhere/capture.json"),
        ([capture_dir, "--times", "0:1:3"], "--like"),
        ([capture_dir, "--times", "0:1:3", "--like", "cam9"], "the id 'cam9'"),
        ([capture_dir, "--options", tmp_path / "none.json"], "none.json"),
        ([capture_dir, "--scene", "magazine"], "--rig"),
        ([capture_dir, "--rig", RIG], "--scene"),
        (
            [capture_dir, capture_dir, "--rig", RIG, "--scene", "ball"],
            "--rig: films one",
        ),
        (
            [tmp_path / "{{x}}", "--rig", RIG, "--scene", "ball"],
            "can't be named in a job",
        ),
    ):
        result = farm(program, *arguments, "-o", job)
        assert result.returncode == 2 and complaint in result.stderr, result.stderr
        assert result.stderr.count("\n") == 1 and not job.exists()


def test_several_captures_have_steps_of_their_own(
    program: Path, capture_dir: Path, tmp_path: Path
) -> None:
    result = farm(program, capture_dir, capture_dir, "-o", tmp_path / "job")
    assert result.returncode == 0, result.stderr
    template = json.loads((tmp_path / "job/openjd.json").read_text())
    names = [step["name"] for step in template["steps"]]
    one = ["check", "offsets", "prepare", "compare"]
    assert names == ["setup", *(f"{name}-{k}" for k in (1, 2) for name in one)]
