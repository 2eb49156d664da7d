"""Evaluates the light field at the viewpoint of a held-out camera.

    .venv/bin/python tests/bench/left_out.py rig RIG CAMERA OUT
    .venv/bin/python tests/bench/left_out.py arc RIG DEGREES OUT
    .venv/bin/python tests/bench/left_out.py cut CAPTURE CAMERA OUT
    .venv/bin/python tests/bench/left_out.py expose CAPTURE OUT [--std STD] [--seed SEED]
    .venv/bin/python tests/bench/left_out.py score PROGRAM OUT PICTURES [--instants N] [--together] [--true-clocks]
        [--way NAME ...]
    .venv/bin/python tests/bench/left_out.py real PROGRAM CAPTURE CAMERA PICTURES [--way NAME ...]

`rig` writes the rig file OUT, in which CAMERA doesn't film. CAMERA is its only new viewpoint, with true depth.

`arc` writes the rig file OUT, in which the cameras of RIG stand on a circle, DEGREES apart, and look at its centre. The
centre is 1.8 m before the rig's origin, as in `stlfr rig arc`, but the arc may be longer.

`cut` writes the capture OUT, which lacks CAMERA. The ground truth images of CAMERA become ground truth of new
viewpoints, named `left-out`; other such viewpoints are removed. The clocks are the true ones. Files are linked, not
copied.

`expose` writes the capture OUT, whose cameras are exposed differently. The linear light of each channel of each camera
but the reference is multiplied by a random gain. A gain has a part common to the camera's channels, and a part of its
own. Their logarithms have the standard deviations STD and STD / 5. The gains are printed.

`score` renders each of these views with PROGRAM by each combination of methods (`--way`), in a new process with an
empty cache. It prints the PSNR of all pixels and of the moving part, processor seconds and peak memory. It writes the
pictures and their ground truth into PICTURES. With `--together`, one process renders the views of all N instants, which
must be evenly spaced; processor seconds are those of a view. With `--true-clocks`, offsets are not estimated.

`real` does the same for a capture without ground truth, such as an imported one: it leaves CAMERA out, and compares views
at the time of its middle frame with this frame. The times of all frames are taken as those of one clock. PSNR is over the
pixels that the view covers, after each channel of the view is multiplied by the gain that fits best.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from calibration_errors import rotation_of
from ground_truth import free_views, psnr_db, read_view, true_picture, truth_of
from light import encoded, linear

WAYS = {
    "nearest frames, plane": ["--sync", "nearest", "--proxy", "plane"],
    "nearest frames, mesh": ["--sync", "nearest", "--proxy", "mesh"],
    "nearest frames, depth": ["--sync", "nearest", "--proxy", "depth"],
    "refined, plane": ["--sync", "refined", "--proxy", "plane"],
    "refined, mesh": ["--sync", "refined", "--proxy", "mesh"],
    "refined, depth": ["--sync", "refined", "--proxy", "depth"],
    "all-cameras, depth": ["--sync", "all-cameras", "--proxy", "depth"],
    "scene flow": ["--proxy", "scene-flow"],
    "default": [],
}
"""The compared combinations of methods by name, as options of `stlfr render`."""
ARC_RADIUS_M = 1.8
"""Radius of the circle of `arc`, as in `stlfr rig arc`."""


def write_rig(rig: Path, camera: str, out: Path) -> None:
    """Write the rig in which the camera is the only view."""
    content = json.loads(rig.read_text())
    [ours] = [c for c in content["cameras"] if c["id"] == camera]
    content["cameras"].remove(ours)
    if content.get("reference") == camera:
        content["reference"] = content["cameras"][0]["id"]
    of_camera = ("rate_hz", "delay_s", "jitter_s")
    view = {name: value for name, value in ours.items() if name not in of_camera}
    content["views"] = [{**view, "id": "left-out"}]
    out.write_text(json.dumps(content, indent=2))


def write_arc(rig: Path, degrees: float, out: Path) -> None:
    """Write the rig with its cameras on a circle, `degrees` apart. They look at the circle's centre."""
    content = json.loads(rig.read_text())
    cameras = content["cameras"]
    for k, camera in enumerate(cameras):
        turn = math.radians(degrees) * (k - (len(cameras) - 1) / 2)
        quaternion = [math.cos(turn / 2), 0.0, math.sin(turn / 2), 0.0]
        centre = ARC_RADIUS_M * np.array([math.sin(turn), 0.0, 1.0 - math.cos(turn)])
        camera["cam_from_rig"] = {
            "rotation_wxyz": quaternion,
            "translation": (-rotation_of(quaternion) @ centre).tolist(),
        }
    out.write_text(json.dumps(content, indent=2))


def cut(capture: Path, camera: str, out: Path) -> None:
    """Write a copy of the capture without the camera into `out`, with this camera's ground truth as new viewpoints."""
    skipped = shutil.ignore_patterns(".stlfr", "colmap", "offsets*", "review", camera)
    shutil.copytree(capture, out, copy_function=os.link, ignore=skipped)
    whole = json.loads((capture / "capture.json").read_text())
    truth = json.loads((capture / "truth" / "truth.json").read_text())
    whole["cameras"] = [c for c in whole["cameras"] if c["id"] != camera]
    set_true_clocks(whole, truth)
    if whole["reference"] == camera:
        whole["reference"] = whole["cameras"][0]["id"]
    ours = [view for view in truth["views"] if view["like"] == camera]
    kept = [view for view in truth["views"] if view["like"] not in (None, camera)]
    for view in ours:
        view["like"], view["id"] = None, view["id"].replace(camera, "left-out")
    truth["views"] = sorted(kept + ours, key=lambda view: view["time_s"])
    for part in ("shutter", "offsets"):
        truth[part] = [entry for entry in truth[part] if entry["id"] != camera]
    for path, content in (("capture.json", whole), ("truth/truth.json", truth)):
        temporary = out / f"{path}.new"
        temporary.write_text(json.dumps(content, indent=2))
        temporary.replace(out / path)  # not through the link, into the original


def set_true_clocks(content: dict[str, Any], truth: dict[str, Any]) -> None:
    """Replace the clocks of all cameras of a capture.json by the true ones."""
    times_s = {entry["id"]: entry["times_s"] for entry in truth["shutter"]}
    for filmed in content["cameras"]:
        filmed["clock"] = {"times_s": times_s[filmed["id"]], "shared": True}


def with_true_clocks(capture: Path, folder: Path) -> Path:
    """Write a copy of a capture with the true clocks into a folder; returns the copy's path."""
    content = json.loads((capture / "capture.json").read_text())
    set_true_clocks(content, truth_of(capture))
    return with_content(capture, content, folder / capture.name)


def with_content(capture: Path, content: dict[str, Any], copy: Path) -> Path:
    """Write a copy of a capture with another capture.json, without any results; returns the copy's path."""
    skipped = shutil.ignore_patterns(".stlfr", "offsets*", "review", "capture.json")
    shutil.copytree(capture, copy, copy_function=os.link, ignore=skipped)
    (copy / "capture.json").write_text(json.dumps(content))
    return copy


def expose(capture: Path, out: Path, std: float, seed: int) -> None:
    """Write a copy of the capture into `out`, whose cameras have random gains."""
    skipped = shutil.ignore_patterns(".stlfr", "colmap", "offsets*", "review")
    shutil.copytree(capture, out, copy_function=os.link, ignore=skipped)
    content = json.loads((capture / "capture.json").read_text())
    random = np.random.default_rng(seed)
    for camera in content["cameras"]:
        logs = std * random.standard_normal() + 0.2 * std * random.standard_normal(3)
        if camera["id"] == content["reference"]:
            continue
        gains = np.exp(logs)
        print(camera["id"], *(f"{gain:.3f}" for gain in gains))
        files = sorted((capture / camera["id"]).glob("*.png"))
        if not files:
            raise SystemExit(f"{capture / camera['id']}: there are no PNG frames")
        for file in files:
            image = cv2.imread(str(file), cv2.IMREAD_COLOR)[..., ::-1] / 255.0
            exposed = np.round(255.0 * encoded(gains * linear(image))).astype(np.uint8)
            temporary = out / camera["id"] / f"new-{file.name}"
            if not cv2.imwrite(str(temporary), exposed[..., ::-1]):
                raise OSError(f"{temporary}: cannot be written")
            temporary.replace(out / camera["id"] / file.name)


def run(command: list[str]) -> tuple[int, float, int]:
    """Run a command; returns its exit status, processor seconds and peak memory in MiB."""
    child = os.posix_spawn(command[0], command, os.environ)
    _, status, usage = os.wait4(child, 0)
    seconds = usage.ru_utime + usage.ru_stime
    return os.waitstatus_to_exitcode(status), seconds, usage.ru_maxrss // 1024


def slug(way: str) -> str:
    """The name of a combination of methods in file names."""
    return way.replace(", ", "-").replace(" ", "-")


def render(
    program: Path, capture: Path, view: list[str], way: str, out: Path
) -> tuple[float, int] | None:
    """Render from an empty cache; returns processor seconds and peak memory in MiB. Failures are printed. `view` holds
    the options that state viewpoint and time.
    """
    shutil.rmtree(capture / ".stlfr", ignore_errors=True)
    command = [str(program), "--quiet", "render", str(capture)]
    code, seconds, mib = run([*command, *view, *WAYS[way], "-o", str(out)])
    if code:
        print(f"  {way:24} exit {code}")
        return None
    return seconds, mib


def score_view(
    capture: Path, view: dict[str, Any], picture: Path
) -> tuple[float, float]:
    """PSNR of a rendered view in dB: of all pixels, and of the moving part."""
    true, moving = true_picture(capture, view)
    image = read_view(picture)
    return psnr_db(image, true, np.ones_like(moving)), psnr_db(image, true, moving)


def score(
    program: Path, capture: Path, pictures: Path, instants: int, ways: list[str]
) -> None:
    """Render the held-out camera's views by each of `ways`, and print a line of results for each."""
    for view in free_views(capture)[:instants]:
        name = view["id"]
        camera = pictures / f"{name}.json"
        camera.write_text(json.dumps(view["camera"]))
        shutil.copy(capture / "truth" / view["image"], pictures / f"{name}-truth.png")
        moving = true_picture(capture, view)[1]
        print(f"{name} at {view['time_s']:.4f} s, {100 * moving.mean():.1f} % moves")
        for way in ways:
            out = pictures / f"{name}-{slug(way)}.png"
            where = ["--camera", str(camera), "--time", str(view["time_s"])]
            cost = render(program, capture, where, way, out)
            if cost is None:
                continue
            whole, part = score_view(capture, view, out)
            seconds, mib = cost
            print(
                f"  {way:24} {whole:6.2f} {part:6.2f} dB {seconds:7.1f} s {mib:5} MiB"
            )
            sys.stdout.flush()


def score_together(
    program: Path, capture: Path, pictures: Path, instants: int, ways: list[str]
) -> None:
    """Render the held-out camera's views of all instants in one process by each of `ways`, and print the results."""
    views = free_views(capture)[:instants]
    if not views:
        raise SystemExit(f"{capture}: there is no ground truth of a new viewpoint")
    times_s = [view["time_s"] for view in views]
    if not np.allclose(
        times_s, np.linspace(times_s[0], times_s[-1], len(views)), atol=1e-5
    ):
        raise SystemExit(
            f"{capture}: the ground truth isn't evenly spaced in time: {times_s}"
        )
    camera = pictures / "left-out.json"
    camera.write_text(json.dumps(views[0]["camera"]))
    when = f"{times_s[0]}:{times_s[-1]}:{len(views)}"
    where = ["--camera", str(camera), "--times", when]
    for way in ways:
        folder = pictures / slug(way)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        cost = render(program, capture, where, way, folder / "%04d.png")
        if cost is None:
            continue
        rendered = sorted(folder.glob("*.png"))
        scores = [
            score_view(capture, *pair) for pair in zip(views, rendered, strict=True)
        ]
        for time_s, (whole, part) in zip(times_s, scores, strict=True):
            print(f"  {way:24} at {time_s:.4f} s {whole:6.2f} {part:6.2f} dB")
        whole, part = np.mean(scores, axis=0)
        a_view = cost[0] / len(views)
        print(f"  {way:24} mean {whole:6.2f} {part:6.2f} dB {a_view:7.1f} s a view")
        sys.stdout.flush()


def frame_times_s(capture: Path, camera: dict[str, Any]) -> list[float]:
    """The times of all frames of a camera, from its clock."""
    clock = camera["clock"]
    if "times_s" in clock:
        return list(clock["times_s"])
    frames = capture / camera["frames"]
    if frames.is_file():
        count = int(cv2.VideoCapture(str(frames)).get(cv2.CAP_PROP_FRAME_COUNT))
    else:
        count = len(list(frames.parent.glob("*")))
    return [clock["first_s"] + n / clock["rate_hz"] for n in range(count)]


def read_frame(
    capture: Path, camera: dict[str, Any], number: int
) -> npt.NDArray[np.uint8]:
    """A frame of a camera of a capture, (H, W, 3) in RGB."""
    frames = capture / camera["frames"]
    if frames.is_file():
        video = cv2.VideoCapture(str(frames))
        for _ in range(number + 1):
            is_read, image = video.read()
            if not is_read:
                raise SystemExit(f"{frames}: there is no frame {number}")
    else:
        read = cv2.imread(
            str(sorted(frames.parent.glob("*"))[number]), cv2.IMREAD_COLOR
        )
        if read is None:
            raise SystemExit(f"{frames}: there is no frame {number}")
        image = read
    return np.asarray(image[..., ::-1], np.uint8)


def score_real(
    program: Path, capture: Path, name: str, pictures: Path, ways: list[str]
) -> None:
    """Render the view of a camera that is left out of a real capture by each of `ways`, and print the results."""
    pictures.mkdir(parents=True, exist_ok=True)
    content = json.loads((capture / "capture.json").read_text())
    [ours] = [c for c in content["cameras"] if c["id"] == name]
    times_s = frame_times_s(capture, ours)
    middle = len(times_s) // 2
    true, time_s = read_frame(capture, ours, middle), times_s[middle]
    cv2.imwrite(str(pictures / "true.png"), true[..., ::-1])
    lens = ("width", "height", "model", "params", "cam_from_world")
    camera = pictures / "camera.json"
    camera.write_text(json.dumps({key: ours[key] for key in lens}))
    content["cameras"] = [c for c in content["cameras"] if c["id"] != name]
    for other in content["cameras"]:
        other["clock"]["shared"] = True
    content["reference"] = content["cameras"][0]["id"]
    with tempfile.TemporaryDirectory(dir=pictures) as folder:
        cut = with_content(capture, content, Path(folder) / "capture")
        for way in ways:
            out = pictures / f"{slug(way)}.png"
            where = ["--camera", str(camera), "--time", str(time_s)]
            cost = render(program, cut, where, way, out)
            if cost is None:
                continue
            seconds, mib = cost
            image = np.asarray(cv2.imread(str(out), cv2.IMREAD_UNCHANGED), np.float64)
            is_seen = (
                image[..., 3] > 0
                if image.shape[2] == 4
                else np.ones(true.shape[:2], bool)
            )
            image = image[..., 2::-1]
            squares = np.maximum((image[is_seen] ** 2).sum(axis=0), 1e-9)
            gains = (image[is_seen] * true[is_seen]).sum(axis=0) / squares
            db = psnr_db(image * gains, true, is_seen)
            print(
                f"{way:24} {db:6.2f} dB over {100 * is_seen.mean():.0f} %"
                f" {seconds:7.1f} s {mib:5} MiB; gains {np.round(gains, 2)}"
            )
            sys.stdout.flush()


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    leaving = commands.add_parser("rig")
    leaving.add_argument("rig", type=Path)
    leaving.add_argument("camera")
    leaving.add_argument("out", type=Path)
    bending = commands.add_parser("arc")
    bending.add_argument("rig", type=Path)
    bending.add_argument("degrees", type=float)
    bending.add_argument("out", type=Path)
    cutting = commands.add_parser("cut")
    cutting.add_argument("capture", type=Path)
    cutting.add_argument("camera")
    cutting.add_argument("out", type=Path)
    exposing = commands.add_parser("expose")
    exposing.add_argument("capture", type=Path)
    exposing.add_argument("out", type=Path)
    exposing.add_argument("--std", type=float, default=0.25)
    exposing.add_argument("--seed", type=int, default=1)
    scoring = commands.add_parser("score")
    scoring.add_argument("program", type=Path)
    scoring.add_argument("capture", type=Path)
    scoring.add_argument("pictures", type=Path)
    scoring.add_argument("--instants", type=int, default=1)
    scoring.add_argument("--together", action="store_true")
    scoring.add_argument("--true-clocks", action="store_true")
    scoring.add_argument("--way", action="append", choices=WAYS)
    real = commands.add_parser("real")
    real.add_argument("program", type=Path)
    real.add_argument("capture", type=Path)
    real.add_argument("camera")
    real.add_argument("pictures", type=Path)
    real.add_argument("--way", action="append", choices=WAYS)
    arguments = parser.parse_args()
    if arguments.command == "rig":
        write_rig(arguments.rig, arguments.camera, arguments.out)
    elif arguments.command == "arc":
        write_arc(arguments.rig, arguments.degrees, arguments.out)
    elif arguments.command == "cut":
        cut(arguments.capture, arguments.camera, arguments.out)
    elif arguments.command == "expose":
        expose(arguments.capture, arguments.out, arguments.std, arguments.seed)
    elif arguments.command == "real":
        a = arguments
        score_real(a.program, a.capture, a.camera, a.pictures, a.way or list(WAYS))
    else:
        a = arguments
        scorer = score_together if a.together else score
        a.pictures.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=a.pictures) as folder:
            if a.true_clocks:
                a.capture = with_true_clocks(a.capture, Path(folder))
            scorer(a.program, a.capture, a.pictures, a.instants, a.way or list(WAYS))


if __name__ == "__main__":
    main()
