"""Runs the calibration check on films by all rigs of the folder `rigs`, and prints the results as a table.

Run as `.venv/bin/python -I tests/bench/residuals.py FOLDER [WIDTHxHEIGHT [RIG...]]`, after `cargo build --release`.
Each rig (by default, all rigs) films 4 frames of the scene `magazine` and the ground truth of one instant by Workbench,
into its own folder in FOLDER; existing images aren't filmed again. `stlfr check` reconstructs the cameras' poses from
the ground truth images. The residuals and standard errors in a row are the largest of the rig's cameras. The projection
error is the largest distance between pixels of pycolmap and of stlfr for the rig's cameras.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "target/release/stlfr"
SCENE = ["--scene", "magazine", "--engine", "workbench", "--samples", "8"]
FRAMES, INSTANT_S, INSTANTS_S = "4", "0.05", {"lost-frames": "0.04"}
"""Options of filming. The rig `lost-frames` has an earlier instant with ground truth, because the frames that remain of
its 4 frames per camera end before the instant of the other rigs."""


def checked(rig: Path, folder: Path, size: str) -> dict[str, Any]:
    """Film with a rig into `folder`, and return the JSON result of `stlfr check`."""
    film: list[str | Path] = [PROGRAM, "capture", rig, "-o", folder, *SCENE]
    film += ["--frames", FRAMES, "--size", size]
    film += ["--instants-s", INSTANTS_S.get(rig.stem, INSTANT_S)]
    subprocess.run(film, check=True, stdout=subprocess.DEVNULL)
    values = folder.with_suffix(".json")
    check: list[str | Path] = [PROGRAM, "-q", "check", folder, "--json", values]
    ended = subprocess.run(check, check=False, stdout=subprocess.DEVNULL)
    if ended.returncode not in (0, 1) or not values.is_file():
        raise SystemExit(f"{rig.name}: the check ended with status {ended.returncode}")
    found: dict[str, Any] = json.loads(values.read_text())
    return found


def row(name: str, found: dict[str, Any]) -> str:
    """A rig's row of the table."""
    worst = {
        field: max(camera[field] or float("inf") for camera in found["cameras"])
        for field in found["cameras"][0]
        if field != "id"
    }
    return (
        f"| `{name}` | {worst['rotation_deg']:.3f} ± {worst['rotation_std_err_deg']:.3f} "
        f"| {worst['position_mm']:.2f} ± {worst['position_std_err_mm']:.2f} "
        f"| {found['model']['capture_px']:.0e} | {found['reason'] or 'none'} |"
    )


def main() -> None:
    """Film and check with each rig, and print the table."""
    folder, size, *names = Path(sys.argv[1]), *(sys.argv[2:] or ["640x480"])
    rigs = sorted((ROOT / "rigs").glob("*.json"))
    folder.mkdir(parents=True, exist_ok=True)
    print("| rig | rotation, ° | position, mm | projection, px | accused |")
    print("|---|---|---|---|---|")
    for rig in (rig for rig in rigs if not names or rig.stem in names):
        print(row(rig.stem, checked(rig, folder / rig.stem, size)), flush=True)


if __name__ == "__main__":
    main()
