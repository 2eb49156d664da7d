"""Film a scene with a simulated camera rig, into a capture folder.

Run as `python -I blender/capture.py RIG --scene NAME -o CAPTURE`. Stdout carries only JSON lines with progress and
notes. An error is one sentence on stderr, with exit code 2 for bad input and 1 for a failure. If the command is
stopped, the same command resumes filming where it stopped.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import re
import signal
import sys
from pathlib import Path
from typing import Any, NoReturn

HERE = Path(__file__).resolve()

sys.path.insert(0, str(HERE.parent))
own_packages: Any = importlib.import_module("own_packages")
sys.path.pop(0)
own_packages.load_extension()
errors, plans, folder, videos, sharing, in_blender, rolling = (
    importlib.import_module(f"stlfr_extension.{name}")
    for name in (
        "errors",
        "plan",
        "folder",
        "video",
        "sharing",
        "in_blender",
        "rolling",
    )
)


class Parser(argparse.ArgumentParser):
    """A parser that raises `BadInputError` for wrong arguments, instead of printing the usage and exiting."""

    def error(self, message: str) -> NoReturn:
        raise errors.BadInputError(message)


def size(text: str) -> tuple[int, int]:
    """Parse an image size such as `320x240` to (width, height) in pixels, each at least 8."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not match or min(int(match[1]), int(match[2])) < 8:
        raise argparse.ArgumentTypeError(
            f"{text} isn't a size like 320x240, at least 8x8"
        )
    return int(match[1]), int(match[2])


def count(minimum: int) -> Any:
    """An argument type for `argparse`: parses a whole number from `minimum` to 100000."""

    def parse(text: str) -> int:
        if not text.isdecimal() or not minimum <= int(text) <= 100_000:
            raise argparse.ArgumentTypeError(
                f"{text} isn't a whole number from {minimum} to 100000"
            )
        return int(text)

    return parse


def seconds(text: str) -> tuple[float, ...]:
    """Parse a list of times in seconds, such as `0.1,0.15`."""
    try:
        times_s = tuple(float(part) for part in text.split(","))
    except ValueError:
        times_s = ()
    if not times_s or not all(map(math.isfinite, times_s)):
        raise argparse.ArgumentTypeError(f"{text} isn't a list of times like 0.1,0.15")
    return times_s


def parts(text: str) -> tuple[int, int, int]:
    """Parse parts of the work, such as `3-6/100` or `3/100`, to (first part, last part, number of parts)."""
    match = re.fullmatch(r"(\d{1,6})(?:-(\d{1,6}))?/(\d{1,6})", text)
    if match:
        first, last, count = int(match[1]), int(match[2] or match[1]), int(match[3])
        if 1 <= first <= last <= count:
            return first, last, count
    raise argparse.ArgumentTypeError(f"{text} isn't parts of a number, like 3-6/100")


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Parse the command line. Raises `BadInputError` if an argument is wrong."""
    parser = Parser(
        prog="capture.py", description="Film a scene with a simulated camera rig."
    )
    add_scene(parser)
    add_film(parser)
    add_truth(parser)
    add_processes(parser)
    return parser.parse_args(arguments)


def add_scene(parser: Parser) -> None:
    """Add the arguments for the rig, the scene and the capture folder."""
    parser.add_argument("rig", type=Path, metavar="RIG", help="rig file")
    scene = parser.add_mutually_exclusive_group(required=True)
    scene.add_argument("--scene", metavar="NAME", help="a scene of blender/scenes")
    scene.add_argument(
        "--blend",
        metavar="FILE",
        type=Path,
        help="a .blend; its object `rig` or its camera holds the rig",
    )
    parser.add_argument(
        "-o",
        dest="capture",
        metavar="CAPTURE",
        type=Path,
        required=True,
        help="capture folder",
    )


def add_film(parser: Parser) -> None:
    """Add the arguments for image size, number of frames, samples per pixel, render engine and video output."""
    parser.add_argument(
        "--size",
        type=size,
        metavar="WxH",
        help="film all cameras at this size (same aspect)",
    )
    parser.add_argument(
        "--frames",
        type=count(1),
        default=9,
        metavar="N",
        help="frames of the reference camera (9); the others film as long",
    )
    parser.add_argument(
        "--samples",
        type=count(1),
        default=16,
        metavar="N",
        help="samples per pixel (16), by Cycles four times as many for truth",
    )
    parser.add_argument(
        "--engine",
        choices=plans.ENGINES,
        default="cycles",
        help="what renders the pictures (cycles)",
    )
    parser.add_argument(
        "--video",
        action="store_true",
        help="keep each camera's frames as one lossless video",
    )


def add_truth(parser: Parser) -> None:
    """Add the arguments for ground truth: instants, point tracks and a slow-motion video."""
    instants = parser.add_mutually_exclusive_group()
    instants.add_argument(
        "--instants",
        type=count(0),
        default=3,
        metavar="N",
        help="instants with truth (3)",
    )
    instants.add_argument(
        "--instants-s",
        type=seconds,
        default=(),
        metavar="T,T",
        help="instants with truth, in seconds on the reference's clock",
    )
    parser.add_argument(
        "--tracks",
        type=count(0),
        default=0,
        metavar="N",
        help="points of the scene whose tracks are written (0)",
    )
    parser.add_argument(
        "--truth-video",
        type=count(0),
        default=0,
        metavar="N",
        help="frames of slow motion from the rig's first view (0)",
    )
    parser.add_argument("--no-truth", action="store_true", help="film without truth")


def add_processes(parser: Parser) -> None:
    """Add the arguments for worker processes, here and on other machines."""
    parser.add_argument(
        "--part",
        type=parts,
        metavar="K-L/N",
        help="film only parts K to L of N, and leave the rest to other commands",
    )
    parser.add_argument(
        "--silence",
        type=count(5),
        default=sharing.SILENCE_S,
        metavar="SECONDS",
        help=f"film what another process left that was silent for so long ({sharing.SILENCE_S})",
    )
    parser.add_argument(
        "--workers", type=count(1), metavar="N", help="filming processes (one per core)"
    )
    parser.add_argument(
        "--module",
        metavar="FOLDER",
        help="where the module stlfr lies (in this Python's packages)",
    )
    parser.add_argument(
        "--blender",
        metavar="FILE",
        help="film in this program of Blender's (in this Python, which has bpy)",
    )


def filming_options(arguments: argparse.Namespace) -> Any:
    """The options of the filming plan, as given on the command line. Also puts `--module` on the module path."""
    if arguments.module:
        sys.path.insert(0, arguments.module)
    return plans.Options(
        rig_file=arguments.rig.resolve(),
        scene_name=arguments.scene,
        blend_file=arguments.blend.resolve() if arguments.blend else None,
        size_px=arguments.size,
        frames=arguments.frames,
        samples=arguments.samples,
        instants=arguments.instants,
        truth_video=arguments.truth_video,
        truth=not arguments.no_truth,
        engine=arguments.engine,
        tracks=arguments.tracks,
        instants_s=arguments.instants_s,
    )


CORES = (
    len(os.sched_getaffinity(0))
    if hasattr(os, "sched_getaffinity")
    else os.cpu_count() or 1
)
"""Cores that this process may use."""


class Filming:
    """The filming of one capture by this process, and its progress: `done` of `total` steps."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.plan = plans.make(filming_options(arguments))
        self.target = arguments.capture.resolve()
        self.done = self.total = 0

    def run(self) -> None:
        """Film the images that are still missing; then, unless only parts were asked for, finish the capture."""
        for path in sorted(self.folders()):
            if path.is_symlink():  # images would be written or deleted elsewhere
                raise errors.BadInputError(
                    f"{path} is a link, and must lie in the capture"
                )
        sharing.claim_folder(self.plan, self.target)
        chosen = self.chosen_jobs()
        jobs = [job for job in chosen if not self.is_filmed(job)]
        is_part = self.arguments.part is not None
        packed = self.plan.rig.cameras if self.arguments.video and not is_part else []
        unpacked = [c for c in packed if not videos.is_packed(c, self.target)]
        self.total = len(chosen) + len(unpacked)
        self.done = len(chosen) - len(jobs)
        if not jobs and not unpacked and (is_part or self.is_whole):
            report(self.done, self.total, "already filmed")
            return
        note = expected(self.plan, jobs, CORES) if jobs else None
        report(self.done, self.total, "starting Blender", note)
        with sharing.Member(self.target, self.arguments.silence) as member:
            try:
                cameras = self.film(jobs, member)
                if not is_part:
                    self.finish(cameras, unpacked, member)
            except (errors.FailureError, OSError):
                # Another process finished the capture and removed temporary files that this one was using.
                if not member.is_over:
                    raise

    def folders(self) -> set[Path]:
        """All folders inside the capture's folder that filming writes into."""
        files = [Path(file) for job in self.plan.jobs for file in job.files]
        inside = {parent for file in files for parent in file.parents if parent.name}
        names = [plans.HIDDEN_FOLDER, "colmap", "truth"]
        return {self.target / path for path in (*inside, *map(Path, names))}

    @property
    def is_whole(self) -> bool:
        """Whether the capture is complete: capture.json, which is written last, exists."""
        return (self.target / plans.CAPTURE_FILE).is_file()

    def is_filmed(self, job: Any) -> bool:
        """Whether a job's files are complete, or packed into a video; whichever process wrote them."""
        return videos.holds(job, self.target) or job.is_finished(self.target)

    def chosen_jobs(self) -> list[Any]:
        """The jobs of the parts given by `--part`; without it, all jobs."""
        jobs = self.plan.jobs
        first, last, count = self.arguments.part or (1, 1, 1)
        return jobs[(first - 1) * len(jobs) // count : last * len(jobs) // count]

    def on_done(self, what: str) -> None:
        """Count one more step as done, and report it."""
        self.done += 1
        report(self.done, self.total, what)

    def on_notes(self, notes: list[str]) -> None:
        """Report the notes about the scene that the first worker process sent."""
        for note in notes:
            report(self.done, self.total, "starting Blender", note)

    def film(self, jobs: list[Any], member: Any) -> dict[str, Any]:
        """Do the jobs in worker processes, sharing them with other commands that film this capture.

        Returns the camera object of every view, by the view's id.
        """
        workers = min(self.arguments.workers or CORES, max(1, len(jobs)))
        crews = importlib.import_module("stlfr_extension.workers")
        command = [sys.executable, "-I", str(HERE), "--worker"]
        if self.arguments.blender:
            command[-1:] = ["--worker-in", self.arguments.blender]
        items = {job.files[0].replace("/", "+"): job for job in jobs}
        shared = sharing.Shared(
            member, items, self.is_filmed, lambda job: self.on_done(elsewhere(job.what))
        )
        try:
            with crews.Crew(self.plan, member, command, workers, CORES) as crew:
                return crew.film(
                    shared, lambda job: self.on_done(job.what), self.on_notes
                )
        except errors.BadInputError:
            plans.release(self.target)
            raise

    def finish(self, cameras: dict[str, Any], unpacked: list[Any], member: Any) -> None:
        """Pack the cameras `unpacked` into videos, and write the capture's description, with capture.json last.

        Other processes that film this capture share these steps, so that each is done once. `cameras` has the camera
        object of every view.
        """
        packing = sharing.Shared(
            member,
            {videos.video_file(camera.id): camera for camera in unpacked},
            lambda camera: videos.is_packed(camera, self.target),
            lambda camera: self.on_done(elsewhere(videos.video_file(camera.id))),
        )
        for camera in packing.each():
            videos.pack(camera, self.target, member.scratch)
            self.on_done(videos.video_file(camera.id))
        whole = sharing.Shared(
            member, {plans.CAPTURE_FILE: True}, lambda _: self.is_whole, lambda _: None
        )
        for _ in whole.each():
            folder.write_all(self.plan, cameras, self.target)
        member.end()


def elsewhere(what: str) -> str:
    """The description of a step that another process did, for a progress line."""
    return f"{what} (elsewhere)"


CYCLES_SAMPLE_S = 1.1e-6
"""Time that one core takes for one sample of one pixel in Cycles, seconds; measured on this project's scenes."""

IMAGE_S = 0.3
"""Time that one core takes for an image, seconds: in Cycles without its samples, in Workbench altogether."""

BAND_S = 0.1
"""Time that one core takes for each further band of rows of a frame with a rolling shutter, seconds."""


def expected(plan: Any, jobs: list[Any], cores: int) -> str:
    """A sentence for the user with the estimated duration of these jobs on `cores` cores."""
    samples = sum(job.width_px * job.height_px * job.samples for job in jobs)
    by_sample = CYCLES_SAMPLE_S * samples if plan.options.engine == "cycles" else 0.0
    bands = sum(further_bands(plan.rig, job) for job in jobs)
    minutes = (by_sample + IMAGE_S * len(jobs) + BAND_S * bands) / cores / 60
    time = f"{minutes:.0f} minutes" if minutes >= 1.5 else "a minute"
    return f"Filming {len(jobs)} images may take {time}, and longer in a heavy scene."


def further_bands(rig: Any, job: Any) -> int:
    """The number of bands of rows after the first in which a job's image is rendered: 0 without a rolling shutter."""
    by_id = {camera.id: camera for camera in rig.cameras}
    camera = by_id.get(job.view_id)
    if camera is None or job.is_geometry:
        return 0
    size_px = (job.width_px, job.height_px)
    return len(rolling.bands(size_px, camera.readout_s)) - 1


def report(done: int, total: int, what: str, note: str | None = None) -> None:
    """Print one line of progress, with a sentence for the user if there is one."""
    line = {"done": done, "total": total, "what": what}
    print(json.dumps(line | ({"note": note} if note else {})), flush=True)


def stop(*_: object) -> NoReturn:
    """Signal handler: raises an error, so that the context managers end the worker processes."""
    raise errors.FailureError(
        "filming was stopped; the same command goes on where it was"
    )


def main() -> int:
    """Run the command, or a worker process; print an error as one sentence on stderr. Returns the exit code."""
    arguments = in_blender.own_arguments()
    match arguments:
        case ["--worker-in", blender]:
            in_blender.become(blender, HERE)
        case ["--worker-answers", number]:
            in_blender.take_answers(number)
            arguments = ["--worker"]
    if arguments == ["--worker"]:
        importlib.import_module("stlfr_extension.workers").work()
        return 0
    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    try:
        Filming(parse_arguments(arguments)).run()
    except (errors.BadInputError, errors.FailureError) as error:
        print(error, file=sys.stderr)
        return int(error.exit_code)
    except OSError as error:
        print(
            f"{error.filename or 'filming'}: {error.strerror or error}", file=sys.stderr
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
