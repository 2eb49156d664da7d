"""Measures how errors of a calibration affect estimated offsets, and whether the standard errors show it.

.venv/bin/python tests/bench/calibration_errors.py CAPTURE... [--seeds 3] [--program target/release/stlfr]

Captures must have ground truth. The calibration is made wrong by normally distributed errors: rotations of 0.1 degree
and translations of 1 mm (root mean square length of the vector), focal lengths by 0.5 %. Rows of the table: the true
calibration; the wrong one taken as exact; the wrong one with its accuracy stated as `calibration_std`; the wrong one
with refined poses; the wrong one with refined poses and focal lengths; and a calibration from the images alone. Values
are those of all cameras except the reference, over all captures and seeds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

TURN_DEG, MOVE_M, FOCAL = 0.1, 0.001, 0.005

Array = np.ndarray[Any, Any]
Outcomes = list[tuple[float, float]]
"""The error and the standard error of each camera's estimated offset, in frame intervals of the reference camera."""


def rotation_of(quaternion: list[float]) -> Array:
    """The rotation matrix (3, 3) of a unit quaternion wxyz."""
    w, x, y, z = quaternion
    v = np.array([x, y, z])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix: Array = (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross
    return matrix


def product(p: Array, q: Array) -> Array:
    """The product of two quaternions wxyz."""
    vector = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], vector])


def make_wrong(camera: dict[str, Any], random: np.random.Generator) -> None:
    """Adds random errors to the pose and the focal lengths of a camera object of capture.json, in place."""
    pose = camera["cam_from_world"]
    centre = -rotation_of(pose["rotation_wxyz"]).T @ np.array(pose["translation"])
    turn = np.radians(TURN_DEG) / np.sqrt(3) * random.normal(size=3)
    half = np.concatenate([[1.0], 0.5 * turn])
    quaternion = product(half / np.linalg.norm(half), np.array(pose["rotation_wxyz"]))
    centre = centre + MOVE_M / np.sqrt(3) * random.normal(size=3)
    pose["rotation_wxyz"] = quaternion.tolist()
    pose["translation"] = (-rotation_of(pose["rotation_wxyz"]) @ centre).tolist()
    count = 1 if camera["model"].startswith(("SIMPLE_", "RADIAL")) else 2
    scale = np.exp(FOCAL * random.normal())
    for k in range(count):
        camera["params"][k] *= scale


def linked(capture: Path, target: Path, description: dict[str, Any]) -> Path:
    """Copy a capture to `target`, with hard links to its frames, and another capture.json. Returns `target`."""
    for camera in description["cameras"]:
        parent = (capture / camera["frames"]).parent
        sequence = "%" in camera["frames"]
        files = parent.iterdir() if sequence else [capture / camera["frames"]]
        for file in files:
            link = target / file.relative_to(capture)
            link.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(file, link)
            except OSError:
                link.write_bytes(file.read_bytes())
    (target / "capture.json").write_text(json.dumps(description))
    return target


class Bench:
    """Runs the program `stlfr` and evaluates its results."""

    def __init__(self, program: str) -> None:
        self.program = program

    def call(self, *arguments: str | Path) -> str | None:
        """The output of a command; None if it fails. The program prints the reason on stderr."""
        command = [self.program, *arguments, "--quiet"]
        ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        return None if ended.returncode else ended.stdout

    def outcomes(self, folder: Path | None, truth: dict[str, Any]) -> Outcomes:
        """The errors of a capture's estimated offsets. Cameras with unknown offsets have no entry."""
        printed = None if folder is None else self.call("offsets", folder, "--json")
        if printed is None or folder is None:
            return []
        found = json.loads(printed)
        true_s = {o["id"]: o["offset_s"] for o in truth["offsets"]}
        cameras = json.loads((folder / "capture.json").read_text())["cameras"]
        clock = next(c["clock"] for c in cameras if c["id"] == found["reference"])
        times = clock.get("times_s")
        frame_s = float(np.median(np.diff(times))) if times else 1 / clock["rate_hz"]
        return [
            ((c["offset_s"] - true_s[c["id"]]) / frame_s, c["std_err_s"] / frame_s)
            for c in found["cameras"]
            if c["id"] != found["reference"] and c["offset_s"] is not None
        ]

    def rows(
        self, capture: Path, seed: int, scratch: Path
    ) -> Iterator[tuple[str, Outcomes]]:
        """Yields the table's rows for a capture and a seed: the kind of calibration, and its offsets' errors."""
        truth = json.loads((capture / "truth/truth.json").read_text())
        right = json.loads((capture / "capture.json").read_text())
        if seed == 0:
            true = linked(capture, scratch / "true", right)
            yield "true", self.outcomes(true, truth)
            calibrated: Path | None = scratch / "calibrated"
            if self.call("calibrate", true, "-o", scratch / "calibrated") is None:
                calibrated = None
            yield "calibrated", self.outcomes(calibrated, truth)
        random = np.random.default_rng(seed)
        wrong = json.loads(json.dumps(right))
        for camera in wrong["cameras"]:
            make_wrong(camera, random)
        exact = linked(capture, scratch / "exact", wrong)
        yield "wrong, taken as exact", self.outcomes(exact, truth)
        for camera in wrong["cameras"]:
            camera["calibration_std"] = {
                "rotation_deg": TURN_DEG / np.sqrt(3),
                "centre_m": MOVE_M / np.sqrt(3),
                "focal_relative": FOCAL,
            }
        stated = linked(capture, scratch / "stated", wrong)
        yield "wrong, accuracy stated", self.outcomes(stated, truth)
        ways: list[tuple[str, list[str]]] = [
            ("refined, poses", []),
            ("refined, focal too", ["--focal"]),
        ]
        for name, options in ways:
            refined = scratch / f"refined{len(options)}"
            printed = self.call("refine", exact, *options, "-o", refined)
            yield name, self.outcomes(None if printed is None else refined, truth)


def main() -> None:
    """Run all combinations of captures and seeds, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--program", default="target/release/stlfr")
    options = parser.parse_args()
    bench, table = Bench(options.program), dict[str, Outcomes]()
    for capture in options.captures:
        for seed in range(options.seeds):
            with tempfile.TemporaryDirectory() as scratch:
                for name, found in bench.rows(capture.resolve(), seed, Path(scratch)):
                    table.setdefault(name, []).extend(found)
                    print(f"{capture.name} {seed} {summary(name, found)}", flush=True)
    print()
    for name, found in table.items():
        print(summary(name, found))


def summary(name: str, outcomes: Outcomes) -> str:
    """A row of the table, from all errors of one kind of calibration."""
    if not outcomes:
        return f"{name:<24} unknown"
    errors, std_errs = np.abs(np.array(outcomes)).T
    z = errors / np.maximum(std_errs, 1e-12)
    return (
        f"{name:<24} median error {np.median(errors):.4f}, worst {errors.max():.4f} frame,"
        f" within 2: {np.sum(z <= 2)} of {len(z)}, median |z| {np.median(z):.2f}"
    )


if __name__ == "__main__":
    main()
