"""The plan of a capture: which images it consists of, and which of them exist already. Does not import `bpy`.

A capture folder belongs to one plan. Its hidden folder `.film` holds the plan's fingerprint: a hash of the rig, the
scene, the options and the source files that affect the pixels. Filming resumes in a folder with the same fingerprint,
and refuses a folder with another fingerprint or with other files.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from . import native, png, scenes, truth
from . import rig as rigs
from .errors import BadInputError
from .rig import Rig, Shutter

HIDDEN_FOLDER = ".film"
PLAN_FILE = "plan.txt"
CAPTURE_FILE = "capture.json"

TRACKS_FILE = "truth/tracks/tracks.json"

ENGINES = ("cycles", "workbench")

TRUTH_SAMPLES_FACTOR = 4
"""Samples per pixel of ground truth images by Cycles, as a multiple of those of the frames; four times the samples have
half the noise. If larger, ground truth takes longer to render; if smaller, its noise counts as an error of the results.
Images by Workbench have no noise, and more samples would only change how edges and textures are antialiased: 48 dB
between a frame and the truth of the same view."""

PIXEL_SOURCES = (
    "camera.py",
    "described.py",
    "distortion.py",
    "exr.py",
    "film.py",
    "folder.py",
    "native.py",
    "plan.py",
    "png.py",
    "rig.py",
    "rolling.py",
    "scenes.py",
    "sensor.py",
    "tracks.py",
    "truth.py",
)
"""The modules of this folder that affect the contents of a capture's files; the fingerprint of a plan includes them."""


@dataclass(frozen=True)
class Options:
    """What to film. Either `blend_file` or `scene_name` is set, and the other is None.

    `frames` counts the reference camera's frames, `samples` are those per pixel, `instants` are those with ground
    truth. `truth_video` is the number of frames of a slow-motion video, and `tracks` the number of points with tracks.
    """

    rig_file: Path
    scene_name: str | None
    blend_file: Path | None
    size_px: tuple[int, int] | None
    frames: int
    samples: int
    instants: int
    truth_video: int
    truth: bool
    engine: str = "cycles"
    tracks: int = 0
    instants_s: tuple[float, ...] = ()
    """Instants with ground truth, seconds on the reference's clock. If empty, the plan chooses `instants` instants."""

    @property
    def title(self) -> str:
        """The scene's name for display: `scene_name`, or the .blend file's name without its suffix."""
        if self.scene_name is not None:
            return self.scene_name
        assert self.blend_file is not None
        return self.blend_file.stem

    @property
    def truth_samples(self) -> int:
        """Samples per pixel of ground truth images."""
        return self.samples * (TRUTH_SAMPLES_FACTOR if self.engine == "cycles" else 1)


@dataclass(frozen=True)
class Job:
    """One piece of filming work: an image to render, depth and motion of one view, or the point tracks.

    `files` are the output files, relative to the capture's folder. `what` describes the job in progress messages.
    """

    what: str
    view_id: str
    width_px: int
    height_px: int
    world_time_s: float
    samples: int
    seed: int
    files: tuple[str, ...]

    @property
    def is_geometry(self) -> bool:
        """Whether the job writes depth and motion instead of an image."""
        return self.files[0].endswith(".npy")

    @property
    def is_tracks(self) -> bool:
        """Whether the job writes the point tracks."""
        return self.files[0] == TRACKS_FILE

    @property
    def is_frame(self) -> bool:
        """Whether the job renders a camera's frame, which gets sensor noise; ground truth gets none."""
        return not self.files[0].startswith("truth/")

    def is_finished(self, capture: Path) -> bool:
        """Whether all files of the job exist in the folder `capture` and are complete."""
        if self.is_tracks:  # this file is the last one written
            return (capture / TRACKS_FILE).is_file()
        check = is_whole_npy if self.is_geometry else png.is_whole
        return all(
            check(capture / file, self.width_px, self.height_px) for file in self.files
        )


@dataclass(frozen=True)
class Plan:
    """All that a capture will consist of, computed before anything is rendered.

    `instants_s` (the instants with ground truth) and `video_times_s` are seconds on the reference camera's clock.
    """

    options: Options
    rig_content: native.Content
    """The content of the checked rig file, at its original image sizes."""
    rig: Rig
    shutters: list[Shutter]
    instants_s: list[float]
    video_times_s: list[float]
    jobs: list[Job]
    fingerprint: str


def _must_suit_workbench(rig: rigs.Rig) -> None:
    """Raises `BadInputError` if a camera has an exposure time: Workbench renders only instantaneous exposures."""
    for camera in rig.cameras:
        if camera.exposure_s > 0.0:
            raise BadInputError(
                f"--engine workbench can't film {camera.id} of rig {rig.name}: "
                "its exposure_s needs --engine cycles"
            )


def make(options: Options) -> Plan:
    """Check the options, and make the plan with its jobs. Raises `BadInputError` if an option or the rig is wrong."""
    rig_content = native.read_rig(options.rig_file)
    rig = rigs.from_content(rig_content)
    if options.size_px is not None:
        rig = rigs.resized(rig, *options.size_px)
    if options.engine == "workbench":
        _must_suit_workbench(rig)
    shutters = rigs.shutters(rig, options.frames)
    if not options.truth:
        instants_s = []
    elif options.instants_s:
        instants_s = truth.given_instants_s(rig, shutters, options.instants_s)
    else:
        instants_s = truth.instants_s(rig, shutters, options.instants)
    video_times_s = (
        truth.video_times_s(rig, shutters, options.truth_video) if options.truth else []
    )
    if video_times_s and not rig.views:
        raise BadInputError(
            f"--truth-video: rig {rig.name} has no views to film it from"
        )
    return Plan(
        options=options,
        rig_content=rig_content,
        rig=rig,
        shutters=shutters,
        instants_s=instants_s,
        video_times_s=video_times_s,
        jobs=[
            *_tracks_jobs(rig, options),
            *_frame_jobs(rig, shutters, options.samples),
            *_truth_jobs(rig, shutters, instants_s, options.truth_samples),
            *_video_jobs(rig, shutters, video_times_s, options.truth_samples),
        ],
        fingerprint=_fingerprint(options, rig),
    )


def frame_file(camera_id: str, index: int) -> str:
    """The path of a camera's frame, relative to the capture's folder."""
    return f"{camera_id}/{index:04d}.png"


def truth_files(instant: int, view_id: str) -> dict[str, str]:
    """The paths of one view's ground truth at an instant (given by its index), relative to the folder `truth`."""
    stem = f"views/t{instant}-{view_id}"
    return {
        "image": f"{stem}.png",
        "depth": f"{stem}.depth.npy",
        "motion": f"{stem}.motion.npy",
    }


@dataclass(frozen=True)
class _Shot:
    """What an image shows: a view of the rig at a world time, with this many samples per pixel."""

    view: rigs.RigView
    world_time_s: float
    samples: int


def _frame_jobs(rig: Rig, shutters: list[Shutter], samples: int) -> list[Job]:
    return [
        _job(
            f"{camera.id} frame {k}",
            _Shot(camera, time_s, samples),
            _seed(rig, "frame", camera, k),
            (frame_file(camera.id, k),),
        )
        for camera, shutter in zip(rig.cameras, shutters, strict=True)
        for k, time_s in enumerate(shutter.world_times_s)
    ]


def _tracks_jobs(rig: Rig, options: Options) -> list[Job]:
    """The job for the point tracks: one for all points and cameras, as they share the scene's evaluation; or none."""
    if not options.truth or options.tracks == 0:
        return []
    camera = rig.reference_camera
    seed = _seed(rig, "tracks", camera, 0)
    return [_job("point tracks", _Shot(camera, 0.0, 1), seed, (TRACKS_FILE,))]


def _truth_jobs(
    rig: Rig, shutters: list[Shutter], instants_s: list[float], samples: int
) -> list[Job]:
    zero_s = truth.reference_zero_s(rig, shutters)
    images, geometry = [], []
    for k, time_s in enumerate(instants_s):
        for view in (*rig.cameras, *rig.views):
            files = {
                name: f"truth/{file}" for name, file in truth_files(k, view.id).items()
            }
            what = f"truth {k} {view.id}"
            world_s = time_s + zero_s
            images.append(
                _job(
                    what,
                    _Shot(view, world_s, samples),
                    _seed(rig, "truth", view, k),
                    (files["image"],),
                )
            )
            geometry.append(
                _job(
                    f"{what} depth",
                    _Shot(view, world_s, 1),
                    _seed(rig, "geometry", view, k),
                    (files["depth"], files["motion"]),
                )
            )
    return (
        geometry + images
    )  # in this order, Cycles rebuilds the scene for other render passes only once


def _video_jobs(
    rig: Rig, shutters: list[Shutter], times_s: list[float], samples: int
) -> list[Job]:
    zero_s = truth.reference_zero_s(rig, shutters)
    return [
        _job(
            f"truth video frame {k}",
            _Shot(rig.views[0], time_s + zero_s, samples),
            _seed(rig, "video", rig.views[0], k),
            (f"truth/video/{k:04d}.png",),
        )
        for k, time_s in enumerate(times_s)
    ]


def _job(what: str, shot: _Shot, seed: int, files: tuple[str, ...]) -> Job:
    return Job(
        what=what,
        view_id=shot.view.id,
        width_px=shot.view.width_px,
        height_px=shot.view.height_px,
        world_time_s=shot.world_time_s,
        samples=shot.samples,
        seed=seed,
        files=files,
    )


def _seed(rig: Rig, purpose: str, view: rigs.RigView, index: int) -> int:
    """A random seed that differs for each image; it has 31 bits, as Cycles requires."""
    digest = hashlib.sha256(f"{rig.seed}/{purpose}/{view.id}/{index}".encode()).digest()
    return int.from_bytes(digest[:4], "little") & 0x7FFFFFFF


def _fingerprint(options: Options, rig: Rig) -> str:
    here = Path(__file__).resolve().parent
    if options.scene_name is not None:
        files = scenes.sources(options.scene_name)
    else:
        assert options.blend_file is not None
        if not options.blend_file.is_file():
            raise BadInputError(f"--blend {options.blend_file}: no such file")
        files = [options.blend_file]
    digest = hashlib.sha256()
    wanted = (
        options.frames,
        options.samples,
        options.truth,
        options.instants,
        options.truth_video,
        options.engine,
        options.tracks,
        options.instants_s,
    )
    digest.update(f"{options.title} {wanted} {rig!r}".encode())
    for file in (*files, *(here / name for name in PIXEL_SOURCES)):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def claim(plan: Plan, capture: Path) -> None:
    """Assign the folder `capture` to this plan by writing the plan's fingerprint into it.

    Raises `BadInputError` if the folder holds files of another plan or other files, so that filming never overwrites
    them.
    """
    plan_file = capture / HIDDEN_FOLDER / PLAN_FILE
    if capture.exists() and not capture.is_dir():
        raise BadInputError(f"{capture} is a file, not a folder for a capture")
    if plan_file.is_file():
        if plan_file.read_text(encoding="utf-8").strip() != plan.fingerprint:
            raise BadInputError(
                f"{capture} holds a recording of another rig, scene or options, or of another version "
                "of stlfr; choose another folder or delete it"
            )
        return
    if _has_files(capture):
        raise BadInputError(
            f"{capture} holds files that stlfr did not write; choose another folder"
        )
    plan_file.parent.mkdir(parents=True, exist_ok=True)
    partial = plan_file.with_suffix(".partial")
    partial.write_text(plan.fingerprint + "\n", encoding="utf-8")
    partial.replace(plan_file)


def release(capture: Path) -> None:
    """Delete the plan's fingerprint if nothing was filmed into the folder, so that it can be used for another plan."""
    if not _has_files(capture):
        (capture / HIDDEN_FOLDER / PLAN_FILE).unlink(missing_ok=True)


def _has_files(capture: Path) -> bool:
    """Whether the folder holds anything besides the hidden folder `.film`."""
    return capture.is_dir() and any(
        entry.name != HIDDEN_FOLDER for entry in capture.iterdir()
    )


def is_whole_npy(path: Path, width_px: int, height_px: int) -> bool:
    """Whether a file is a complete float32 .npy array of shape (`height_px`, `width_px`).

    Only its header and its length are checked.
    """
    try:
        with path.open("rb") as stream:
            start = stream.read(128)
            length = stream.seek(0, 2)
    except OSError:
        return False
    header = f"'descr': '<f4', 'fortran_order': False, 'shape': ({height_px}, {width_px})".encode()
    return (
        start.startswith(b"\x93NUMPY")
        and header in start
        and length == 128 + 4 * width_px * height_px
    )
