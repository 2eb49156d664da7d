"""Film in several worker processes, each with its own Blender.

One single-threaded process per core films 10 to 20 % faster than one process with a thread per core (measured at
320x240 on two cores), because animation, scene updates and PNG encoding are single-threaded in both cases.

Parent and worker exchange JSON lines over the worker's stdin and stdout. The parent first sends the settings, and the
worker answers with the views' camera objects. Then the parent sends one job at a time, and the worker answers when the
job's files are written.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import queue
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, Self

from . import rig as rigs
from .errors import BadInputError, FailureError
from .plan import Job, Options, Plan
from .sharing import LOOK_S, Member, Shared

NO_OPENGL = (
    "; Workbench needs OpenGL: apt-get install -y libegl1 libgl1-mesa-dri, "
    "or film with --engine cycles"
)
"""Addition to the error message if a Workbench worker ends, as Blender aborts without OpenGL."""

Cameras = dict[str, dict[str, Any]]
Answer = tuple["subprocess.Popen[str]", str]


class Crew:
    """The worker processes, each started by `command`; the cores are divided among them.

    Leaving the context kills all workers, even if they have jobs.
    """

    def __init__(
        self,
        plan: Plan,
        member: Member,
        command: list[str],
        workers: int,
        cores: int,
    ) -> None:
        self.command = command
        self.setting = json.dumps(
            {
                "options": {
                    **dataclasses.asdict(plan.options),
                    "rig_file": str(plan.options.rig_file),
                    "blend_file": str(plan.options.blend_file)
                    if plan.options.blend_file
                    else None,
                },
                "rig": plan.rig_content,
                "capture": str(member.capture),
                "scratch": str(member.scratch),
                "threads": max(1, cores // workers),
            }
        )
        self.size = workers
        self.lock = member.lock
        self.hint = NO_OPENGL if plan.options.engine == "workbench" else ""
        self.processes: list[subprocess.Popen[str]] = []

    def __enter__(self) -> Self:
        for _ in range(self.size):
            process = subprocess.Popen(
                self.command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                start_new_session=True,  # a Ctrl-C is the parent's to handle
                # If the parent is killed, its claims become free only when this worker has ended too.
                pass_fds=[self.lock] if os.name == "posix" else [],
            )
            self.processes.append(process)
            _send(process, self.setting)
        return self

    def __exit__(self, *_: object) -> None:
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.wait()

    def film(
        self,
        jobs: Shared[Job],
        on_done: Callable[[Job], None],
        on_notes: Callable[[list[str]], None],
    ) -> Cameras:
        """Do jobs until all are done, by these workers or by other processes. Returns every view's camera object by id.

        `on_notes` gets the notes on the scene that the first worker sends before it films.
        """
        busy: dict[int, Job] = {}
        idle: list[subprocess.Popen[str]] = []
        cameras: Cameras = {}
        answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
        for process in self.processes:
            threading.Thread(
                target=_listen, args=(process, answers), daemon=True
            ).start()
        while not (jobs.is_over and len(idle) == len(self.processes)):
            with contextlib.suppress(queue.Empty):
                process, line = answers.get(timeout=LOOK_S)
                content = _content(process, line, self.hint)
                if not cameras:
                    on_notes(content.get("notes", []))
                cameras.update(content.get("cameras", {}))
                if process.pid in busy:
                    on_done(busy.pop(process.pid))
                idle.append(process)
            while idle and (job := jobs.take()) is not None:
                process = idle.pop()
                busy[process.pid] = job
                _send(process, json.dumps(dataclasses.asdict(job)))
        return cameras


def _send(process: subprocess.Popen[str], line: str) -> None:
    assert process.stdin is not None
    # If the worker has ended, `_listen` reports this.
    with contextlib.suppress(BrokenPipeError):
        process.stdin.write(line + "\n")
        process.stdin.flush()


def _listen(process: subprocess.Popen[str], answers: queue.SimpleQueue[Answer]) -> None:
    """Put the lines that a worker writes into the queue, and an empty line when it has ended."""
    assert process.stdout is not None
    for line in process.stdout:
        answers.put((process, line))
    answers.put((process, ""))


def _content(process: subprocess.Popen[str], line: str, hint: str) -> dict[str, Any]:
    """The content of a worker's answer. Raises the error that the worker reports, or `FailureError` if it has ended."""
    if not line:
        raise FailureError(
            f"a filming process ended unexpectedly (exit status {process.wait()}){hint}"
        )
    answer: dict[str, Any] = json.loads(line)
    if "error" in answer:
        raise (BadInputError if answer["exit_code"] == 2 else FailureError)(
            answer["error"]
        )
    return answer


def work() -> None:
    """The main function of a worker process: does jobs from stdin until stdin ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # Blender's own messages go to stderr, those from C code too

    def answer(content: dict[str, Any]) -> None:
        answers.write(json.dumps(content) + "\n")
        answers.flush()

    try:
        _work(sys.stdin, answer)
    except (BadInputError, FailureError) as error:
        answer({"error": str(error), "exit_code": error.exit_code})
    except Exception as error:  # noqa: BLE001 - whatever it is, the parent has to hear of it
        where = traceback.extract_tb(error.__traceback__)[-1]
        answer(
            {
                "error": f"filming failed: {error} ({type(error).__name__} in {Path(where.filename).name} "
                f"line {where.lineno})",
                "exit_code": 1,
            }
        )


def _work(orders: IO[str], answer: Callable[[dict[str, Any]], None]) -> None:
    setting = json.loads(orders.readline())
    options = Options(**setting["options"])
    from . import film, scenes, tracks, workbench

    rig = rigs.from_content(setting["rig"])
    if options.size_px is not None:
        rig = rigs.resized(rig, *options.size_px)
    scene = scenes.open_scene(
        options.scene_name, Path(options.blend_file) if options.blend_file else None
    )
    studio = film.Studio(
        scene, (*rig.cameras, *rig.views), setting["threads"], options.engine
    )
    cameras = {view_id: studio.describe(view_id) for view_id in studio.views}
    is_workbench = options.engine == "workbench"
    notes = workbench.lost_textures(scene) if is_workbench else []
    answer({"cameras": cameras, "notes": notes})
    capture = Path(setting["capture"])
    scratch = Path(setting["scratch"])
    for line in orders:
        job = Job(**json.loads(line))
        if job.is_tracks:
            exposures = tracks.exposures(rig, options.frames)
            followed = tracks.follow(studio, exposures, options.tracks, rig.seed)
            tracks.write(followed, (capture / job.files[0]).parent, scratch)
        else:
            studio.do(job, capture, scratch, rig.reference_camera.rate_hz)
        answer({})
