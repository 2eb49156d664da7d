"""Simulates recordings by phones in Blender, and measures what each part of stlfr's camera model contributes.

    .venv/bin/python tests/bench/phones.py film CAPTURE [--scene NAME] [--size WxH] [--readout S]
    .venv/bin/python tests/bench/phones.py score CAPTURE [--program P] [--crf N] [--pictures DIR] [--readout S]

`film` makes a rig and films with it. Eight cameras, alternately at 25 and 29.97 Hz, start up to 3 s apart. They have
lens distortion, noise, different and drifting gains, and rolling shutters with a readout time of 15 ms. With rolling
shutters, each frame is rendered in 15 bands; `--readout 0` disables them and is much faster. The reference's gain
doesn't drift.

`score` compresses each camera's frames with H.264, rotates its pose by 0.1 degree and moves it by 1 mm (root mean
square), and imports the result. Rows: the whole model; poses not refined; readout time unknown; equal gains; and a
calibration from the images alone. Columns: errors of offsets in frame intervals of the reference; the number of errors
within two standard errors; and the mean PSNR of views from new viewpoints, three times: of the true cameras; of the
true cameras aligned to the calibrated ones by a similarity, since no calibration knows the position of the whole rig;
and of the true cameras for the traditional light field of nearest frames.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from calibration_errors import make_wrong, rotation_of
from ground_truth import free_views, psnr_db, read_view, true_picture, truth_of

ROOT = Path(__file__).resolve().parents[2]
RATES_HZ = (25.0, 29.97)
STARTS_S = (0.0, 1.73, 0.41, 0.0, 2.97, 1.02, 0.66, 2.31)
READOUT_S = 0.015
GAINS = (1.0, 1.15, 0.9, 1.0, 1.05, 0.95, 1.1, 0.85)
GAIN_DRIFTS = (0.04, -0.05, 0.06, 0.0, 0.03, -0.06, 0.05, -0.04)
"""For each camera, the rate of change of the gain's logarithm, 1/s."""
FRAMES = 125
LAST_START_S = max(STARTS_S)

Array = np.ndarray[Any, Any]
Similarity = tuple[float, Array, Array]
"""Scale, rotation, translation."""


def film(program: str, capture: Path, scene: str, size: str, readout_s: float) -> None:
    """Write the rig file, add drifts of the gains to it, and film the capture."""
    rig = capture.with_name(f"{capture.name}-rig.json")
    listed = {
        "--size": [size],
        "--rate": RATES_HZ,
        "--delays": STARTS_S,
        "--gain": GAINS,
        "--readout": [readout_s],
        "--noise": [0.01],
    }
    command = [program, "rig", "line", "--count", "8", "--jitter", "0", "--quiet"]
    for name, values in listed.items():
        command += [name, ",".join(map(str, values))]
    command += ["--distortion=-0.12,0.03,0.0008,-0.0005", "-o", str(rig)]
    subprocess.run(command, check=True)
    content = json.loads(rig.read_text())
    for camera, drift in zip(content["cameras"], GAIN_DRIFTS, strict=True):
        camera["gain_drift_per_s"] = [drift, 0.8 * drift, 1.2 * drift]
    rig.write_text(json.dumps(content, indent=2))
    instants = [LAST_START_S + 0.37, LAST_START_S + 0.81]
    command = [program, "capture", str(rig), "--scene", scene, "-o", str(capture)]
    command += ["--engine", "workbench", "--frames", str(FRAMES)]
    command += ["--instants-s", ",".join(map(str, instants))]
    subprocess.run(command, check=True)


def compress(capture: Path, camera: dict[str, Any], crf: int, video: Path) -> float:
    """Encode a camera's frames as an H.264 video. Returns the bits per pixel."""
    times = camera["clock"].get("times_s")
    rate = camera["clock"].get("rate_hz") or 1 / float(np.median(np.diff(times)))
    exact = "30000/1001" if abs(rate - 29.97) < 0.01 else f"{rate:.6g}"
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-framerate", exact]
    command += ["-i", str(capture / camera["frames"]), "-c:v", "libx264"]
    command += ["-crf", str(crf), "-pix_fmt", "yuv420p", str(video)]
    subprocess.run(command, check=True)
    folder = (capture / camera["frames"]).parent
    pixels = camera["width"] * camera["height"] * len(list(folder.iterdir()))
    return 8 * video.stat().st_size / pixels


class Made:
    """The imported, degraded captures, and the ground truth of the original capture."""

    def __init__(
        self, program: str, capture: Path, scratch: Path, pictures: Path
    ) -> None:
        self.program, self.capture = program, capture
        self.scratch, self.pictures = scratch, pictures
        self.truth = truth_of(capture)
        self.true_s = {s["id"]: s["times_s"] for s in self.truth["shutter"]}

    def call(self, *arguments: str | Path) -> str:
        """Run a command of the program `stlfr`; returns its output."""
        command = [self.program, *map(str, arguments), "--quiet"]
        ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        return ended.stdout

    def zero_s(self, camera: dict[str, Any]) -> float:
        """The true time at which the clock of an imported camera shows 0."""
        clock = camera["clock"]
        first_s = clock["times_s"][0] if clock.get("times_s") else clock["first_s"]
        return float(self.true_s[camera["id"]][0] - first_s)

    def row(self, name: str, folder: Path, *options: str) -> None:
        """Estimate a capture's offsets, render the ground truth's free viewpoints, and print a row of the table."""
        described = json.loads((folder / "capture.json").read_text())
        cameras = {camera["id"]: camera for camera in described["cameras"]}
        options = tuple(option for option in options if option)
        found = json.loads(self.call("offsets", folder, "--json", *options))
        reference = cameras[found["reference"]]
        start_s = self.zero_s(reference)
        frame_s = float(np.median(np.diff(self.true_s[reference["id"]])))
        errors, inside = [], 0
        for camera in found["cameras"]:
            if camera["id"] == found["reference"] or camera["offset_s"] is None:
                continue
            true_s = self.zero_s(cameras[camera["id"]]) - start_s
            errors.append(abs(camera["offset_s"] - true_s) / frame_s)
            inside += abs(camera["offset_s"] - true_s) <= 2 * camera["std_err_s"]
        world, aligned = self.similarities(folder)
        views = [
            self.views(name, (folder, start_s, world), options),
            self.views(f"{name}, aligned", (folder, start_s, aligned), options),
            self.views(
                f"{name}, nearest", (folder, start_s, world), (*options, *NEAREST)
            ),
        ]
        print(
            f"| {name} | {np.median(errors):.4f}, {max(errors):.4f} | {inside} of {len(errors)}"
            f" | {' | '.join(views)} |",
            flush=True,
        )

    def views(
        self,
        name: str,
        where: tuple[Path, float, Similarity],
        options: tuple[str, ...],
    ) -> str:
        """Render the ground truth's free viewpoints from a capture, with `options` of `stlfr render`.

        `where` holds the capture's folder, the true time at which its clock shows 0, and the similarity from the true
        world to the capture's world. Returns the mean PSNR of the moving part and of all pixels, as text.
        """
        folder, start_s, to_folder = where
        moving, whole = [], []
        for view in free_views(self.capture):
            file = self.scratch / "view.json"
            file.write_text(json.dumps(moved(view["camera"], to_folder)))
            out = self.pictures / f"{view['id']}-{name.replace(' ', '-')}.png"
            time_s = str(view["time_s"] - start_s)
            command = ["render", folder, "--camera", file, f"--time={time_s}"]
            self.call(*command, *options, "-o", out)
            true, moves = true_picture(self.capture, view)
            image = read_view(out)
            moving.append(psnr_db(image, true, moves))
            whole.append(psnr_db(image, true, np.ones_like(moves)))
        return f"{np.mean(moving):.1f} / {np.mean(whole):.1f}"

    def similarities(self, folder: Path) -> tuple[Similarity, Similarity]:
        """Two similarities from the true world to a capture's: as the capture states it, and fitted to its cameras.

        A metric calibration states the identity. A calibration without scale states nothing: both are the fitted one.
        """
        true, found = (
            {c["id"]: c["cam_from_world"] for c in json.loads(file.read_text())["cameras"]}
            for file in (self.capture / "capture.json", folder / "capture.json")
        )  # fmt: skip
        a = np.array([centre(true[name]) for name in found])
        b = np.array([centre(pose) for pose in found.values()])
        spread = [np.linalg.norm(points - points.mean(axis=0)) for points in (a, b)]
        scale = float(spread[1] / spread[0])
        # Cameras in a line leave the rotation about this line undetermined, so the cameras' rotations are aligned.
        sum_of = sum(
            rotation_of(found[name]["rotation_wxyz"]).T
            @ rotation_of(true[name]["rotation_wxyz"])
            for name in found
        )
        u, _, v = np.linalg.svd(sum_of)
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
        shift = b.mean(axis=0) - scale * rotation @ a.mean(axis=0)
        aligned = (scale, rotation, shift)
        is_metric = abs(scale - 1) < 0.02
        return (1.0, np.eye(3), np.zeros(3)) if is_metric else aligned, aligned


NEAREST = ("--sync", "nearest", "--proxy", "mesh", "--blend", "lumigraph")
"""Options of `stlfr render` for a traditional light field of nearest frames."""


def centre(pose: dict[str, Any]) -> Array:
    """A camera's centre in world coordinates, from its `cam_from_world`."""
    found: Array = -rotation_of(pose["rotation_wxyz"]).T @ np.array(pose["translation"])
    return found


def moved(camera: dict[str, Any], similarity: Similarity) -> dict[str, Any]:
    """A camera object after a similarity of the world."""
    scale, rotation, translation = similarity
    pose = camera["cam_from_world"]
    turn = rotation_of(pose["rotation_wxyz"]) @ rotation.T
    place = scale * rotation @ centre(pose) + translation
    return {
        **camera,
        "cam_from_world": {
            "rotation_wxyz": quaternion_of(turn),
            "translation": (-turn @ place).tolist(),
        },
    }


def quaternion_of(turn: Array) -> list[float]:
    """A rotation matrix as a unit quaternion wxyz, computed from the quaternion's largest component."""
    xx, yy, zz = np.diag(turn)
    squares = np.array([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz])  # fmt: skip
    products = np.array(
        [
            [0, turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]],
            [0, 0, turn[0, 1] + turn[1, 0], turn[0, 2] + turn[2, 0]],
            [0, 0, 0, turn[1, 2] + turn[2, 1]],
            [0, 0, 0, 0],
        ]
    )  # fmt: skip
    four = products + products.T + np.diag(squares)
    column = four[:, int(np.argmax(squares))]
    found: list[float] = (column / math.sqrt(float(column @ column))).tolist()
    return found


def score(
    program: str, capture: Path, crf: int, pictures: Path, readout_s: float
) -> None:
    """Degrade the capture's recordings and calibration, import them in several ways, and print the table."""
    pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        made = Made(program, capture, scratch, pictures)
        described = json.loads((capture / "capture.json").read_text())
        videos, random = scratch / "videos", np.random.default_rng(1)
        videos.mkdir()
        bits = []
        for camera in described["cameras"]:
            video = videos / f"{camera['id']}.mp4"
            bits.append(compress(capture, camera, crf, video))
            focal = camera["params"][:2]
            make_wrong(camera, random)
            camera["params"][:2] = focal
        calibration = scratch / "capture.json"
        calibration.write_text(json.dumps(described))
        print(f"H.264 at {np.mean(bits):.3f} bits a pixel\n")
        print("| | offset error, frames: median, worst | within 2 std. errors | moving part / whole, dB | aligned | nearest frames, mesh |\n|---|---|---|---|---|---|", flush=True)  # fmt: skip
        readout = ("--readout", str(readout_s)) if readout_s else ()
        given = ("import", calibration, "--images", videos)
        folders = {
            name: scratch / name for name in ("with", "without", "refined", "instant")
        }
        made.call(*given, *readout, "-o", folders["with"])
        made.call("refine", folders["with"], "-o", folders["refined"])
        made.row("all of it", folders["refined"])
        made.row("poses not refined", folders["with"])
        if readout:
            made.call(*given, "-o", folders["without"])
            made.call("refine", folders["without"], "-o", folders["instant"])
            made.row("readout unknown", folders["instant"])
        made.row("equal gains", folders["refined"], "--set", "registration.gains=equal")
        lens = ("--lens", "OPENCV", "--focal", f"{np.mean(focal):.2f}")
        made.call("calibrate", videos, *lens, *readout, "-o", scratch / "calibrated")
        made.row("no calibration", scratch / "calibrated")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("command", choices=["film", "score"])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--scene", default="magazine")
    parser.add_argument("--size", default="320x240")
    parser.add_argument("--program", default=str(ROOT / "target/release/stlfr"))
    parser.add_argument("--crf", type=int, default=23)
    parser.add_argument("--readout", type=float, default=READOUT_S)
    parser.add_argument("--pictures", type=Path, default=ROOT / ".captures/phones")
    a = parser.parse_args()
    if a.command == "film":
        film(a.program, a.capture, a.scene, a.size, a.readout)
    else:
        score(a.program, a.capture, a.crf, a.pictures, a.readout)


if __name__ == "__main__":
    main()
