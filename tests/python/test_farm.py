"""`stlfr farm`: its job files, run by Open Job Description's reference engine and by a fake of Flamenco."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import bpy
import pytest
from filming import ROOT, camera, described, run

OPENJD = Path(sys.executable).with_name("openjd")
FILM = ["--scene", "magazine", "--engine", "workbench", "--size", "160x120"]
FILM += ["--frames", "6", "--instants", "1"]
RENDER = ["--like", "cam3", "--times", "0.05:0.1:5", "--render-chunk", "2"]
RIG = str(ROOT / "rigs/linear8.json")


def farm(program: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return run([str(program), "farm", *map(str, arguments)])


@pytest.fixture(scope="module")
def job(program: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A job with all steps, in folders whose names need quoting."""
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
    """The reference engine runs the job twice. Both runs write the same files as single commands."""
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
"""JavaScript that simulates how Flamenco's manager compiles a job type."""


def flamenco(job: Path, tmp_path: Path) -> dict[str, Any]:
    """The job type's label, and its compiled tasks with their commands."""
    page = tmp_path / "page.html"
    script = (job / "stlfr.js").read_text()
    page.write_text(f"<body><script>{script}{STUB}</script></body>")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    dumped = run(["chromium", *options, f"--user-data-dir={tmp_path}", page.as_uri()])
    body = dumped.stdout.split("<body>")[1].split("</body>")[0]
    said: dict[str, Any] = json.loads(unquote(body))
    return said


def test_flamenco_makes_the_tasks(job: Path, tmp_path: Path) -> None:
    said = flamenco(job, tmp_path)
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


PATH = ["--path", "bullet-time", "--duration", "0.2", "--preset", "draft"]
CHUNKS = ["1-3/7", "4-6/7", "7-7/7"]


def run_openjd(job: Path, _tmp_path: Path) -> None:
    step = ["--step", "render", "--no-run-dependencies"]
    ended = openjd("run", job / "openjd.json", *step)
    assert ended.returncode == 0, ended.stdout[-3000:]


def run_slurm(job: Path, _tmp_path: Path) -> None:
    for task in range(1, len(CHUNKS) + 1):
        array = ["CHUNK=3", f"SLURM_ARRAY_TASK_ID={task}"]
        ended = run(["env", *array, "sh", str(job / "render.sh")])
        assert ended.returncode == 0, ended.stderr


def run_flamenco(job: Path, tmp_path: Path) -> None:
    tasks = flamenco(job, tmp_path)["tasks"]
    tasks = [task for task in tasks if task["name"].startswith("render")]
    assert [task["name"] for task in tasks] == [f"render {c}" for c in CHUNKS]
    for task in reversed(tasks):
        [command] = task["commands"]
        words = command["parameters"]
        ended = run([words["exe"], *words["args"]])
        assert ended.returncode == 0, ended.stderr


@pytest.fixture(scope="module")
def path_job(
    program: Path, capture_dir: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A job that renders along a path, and in the same folder the frames that a single command renders."""
    folder = tmp_path_factory.mktemp("path")
    capture, whole = folder / "capture", folder / "whole" / "%06d.png"
    shutil.copytree(capture_dir, capture)
    rendered = run([str(program), "render", str(capture), *PATH, "-o", str(whole)])
    assert rendered.returncode == 0, rendered.stderr
    made = farm(program, capture, "-o", folder / "job", *PATH, "--render-chunk", "3")
    assert made.returncode == 0, made.stderr
    return folder / "job"


@pytest.mark.parametrize("engine", [run_openjd, run_slurm, run_flamenco])
def test_a_path_in_chunks_has_the_bytes_of_one_command(
    engine: Callable[[Path, Path], None], path_job: Path, tmp_path: Path
) -> None:
    shutil.rmtree(path_job / "frames", ignore_errors=True)
    engine(path_job, tmp_path)
    whole = sorted((path_job.parent / "whole").iterdir())
    assert [path.name for path in whole] == [f"{k:06}.png" for k in range(7)]
    assert len(list((path_job / "frames").iterdir())) == len(whole)
    for path in whole:
        assert path.read_bytes() == (path_job / "frames" / path.name).read_bytes()


def test_a_path_file_is_named_as_all_machines_see_it(
    program: Path, capture_dir: Path, tmp_path: Path
) -> None:
    capture = json.loads((capture_dir / "capture.json").read_text())
    filmed = capture["cameras"][3]
    view = {key: filmed[key] for key in ("width", "height", "model", "params")}
    view["cam_from_world"] = filmed["cam_from_world"]
    keys = [{"at_s": at_s, "time_s": 0.1, "camera": view} for at_s in (0, 1)]
    path = {"format": "stlfr-path", "version": 1, "rate_hz": 24, "keys": keys}
    (tmp_path / "path.json").write_text(json.dumps(path))
    near = os.path.relpath(tmp_path / "path.json")
    result = farm(program, capture_dir, "-o", tmp_path / "job", "--path", near)
    assert result.returncode == 0, result.stderr
    template = json.loads((tmp_path / "job/openjd.json").read_text())
    step = next(step for step in template["steps"] if step["name"] == "render")
    arguments = step["script"]["actions"]["onRun"]["args"]
    [named] = [a for a in arguments if a.startswith("--path=")]
    assert Path(named.removeprefix("--path=")).resolve() == tmp_path / "path.json"
    assert Path(named.removeprefix("--path=")).is_absolute()
    assert arguments[-1] == "{{Task.Param.Part}}/25"


def test_what_a_job_cannot_be_made_of_is_refused(
    program: Path, capture_dir: Path, tmp_path: Path
) -> None:
    job = tmp_path / "job"
    formatted = tmp_path / "{{Param.Program}}.json"
    formatted.write_text("{}")
    for arguments, complaint in (
        ([tmp_path / "nowhere"], "nowhere/capture.json"),
        ([capture_dir, "--options", formatted], "can't be named in a job"),
        ([capture_dir, "--times", "0:1:3"], "--like"),
        ([capture_dir, "--like", "cam3"], "--times or --path"),
        ([capture_dir, "--like", "cam3", "--time", "0.1"], "--times or --path"),
        ([capture_dir, "--path", tmp_path / "none.json"], "none.json"),
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


def test_the_camera_of_a_blend_is_rendered_in_chunks(
    program: Path, capture_dir: Path, tmp_path: Path
) -> None:
    """Each frame of the scene becomes an image, byte-identical to that of a single command."""
    own = Path(shutil.copytree(capture_dir, tmp_path / "own"))
    filmed = json.loads((own / "capture.json").read_text())["cameras"][3]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 3
    scene.render.fps, scene.render.fps_base = 24, 1.0
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    matrix = camera.blender_matrix(described.pose_of(filmed)).tolist()
    scene.camera.matrix_world = importlib.import_module("mathutils").Matrix(matrix)
    blend = tmp_path / "my.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    render = ["--path", blend, "--time", "0.1", "--preset", "draft"]
    made = farm(program, own, "-o", tmp_path / "job", *render, "--render-chunk", "2")
    assert made.returncode == 0, made.stderr
    run_openjd(tmp_path / "job", tmp_path)
    whole = tmp_path / "whole"
    command = [program, "render", own, *render, "-o", whole / "%06d.png"]
    rendered = run([*map(str, command)])
    assert rendered.returncode == 0, rendered.stderr
    names = [path.name for path in sorted(whole.iterdir())]
    assert names == [f"{k:06}.png" for k in range(3)]
    for name in names:
        assert (whole / name).read_bytes() == (
            tmp_path / "job/frames" / name
        ).read_bytes()
