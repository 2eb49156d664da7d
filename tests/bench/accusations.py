"""Measures how often the calibration check reports a camera with a wrong pose, and how often a correct camera.

Run as `.venv/bin/python -I tests/bench/accusations.py CAPTURE [COUNT]`. One camera's pose at a time is made wrong: it
is rotated by 0.2 degrees about each of COUNT random axes (default 25), and moved by 2 mm in each of COUNT random
directions. The images remain unchanged. Prints the residuals of the correct capture, then two lines per camera.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import stlfr

BLENDER = Path(__file__).resolve().parents[2] / "blender"
spec = importlib.util.spec_from_file_location("check", BLENDER / "check.py")
assert spec is not None and spec.loader is not None
spec.loader.exec_module(importlib.util.module_from_spec(spec))  # loads the packages
calibration, frames, mapping, residuals = (
    importlib.import_module(f"stlfr_calibration.{name}")
    for name in ("capture", "frames", "mapping", "residuals")
)

TURN_DEG, MOVE_M = 0.2, 0.002


def perturbed(pose: Any, direction: np.ndarray[Any, Any], kind: str) -> Any:
    """A wrong pose: rotated about a unit vector if `kind` is `turned`, otherwise moved along it."""
    rotation, centre = pose.rotation, pose.centre_m
    if kind == "turned":
        turn = pycolmap.Rotation3d(direction * np.radians(TURN_DEG)).matrix()
        rotation = turn @ rotation
    else:
        centre = centre + MOVE_M * direction
    return calibration.Pose(rotation, -rotation @ centre)


def main() -> int:
    """Print the residuals of the capture, and the table of reported cameras."""
    folder = Path(sys.argv[1]).resolve()
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 25
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    cameras = json.loads((folder / "capture.json").read_text())["cameras"]
    pictures, source = frames.pictures_of_one_instant(
        folder, stlfr.open(str(folder)), cameras, pycolmap
    )
    estimated = mapping.poses_from_pixels(pictures, cameras, pycolmap)
    exported = {c["id"]: calibration.pose_of(c, pycolmap) for c in cameras}
    print(f"{folder.name}, {source}")
    for residual in residuals.residuals(exported, estimated):
        print(
            f"{residual.id:<12} {residual.rotation_deg:.3f} deg {residual.position_mm:.2f} mm"
            f" (standard errors {residual.rotation_std_err_deg:.3f}, {residual.position_std_err_mm:.2f})"
        )
    random = np.random.default_rng(0)
    print(f"{'wrong':<12} {'kind':<8} {'named':>8} {'others named':>14}")
    for camera_id, pose in exported.items():
        for kind in ("turned", "moved"):
            hits, others = 0, 0
            for direction in random.normal(size=(count, 3)):
                wrong = perturbed(pose, direction / np.linalg.norm(direction), kind)
                found = residuals.residuals({**exported, camera_id: wrong}, estimated)
                names = {r.id for r in found if r.is_off}
                hits += camera_id in names
                others += bool(names - {camera_id})
            print(f"{camera_id:<12} {kind:<8} {hits:>4}/{count} {others:>11}/{count}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
