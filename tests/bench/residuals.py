"""The calibration check of every shipped rig, as a table.

Run as `.venv/bin/python -I tests/bench/residuals.py FOLDER [WIDTHxHEIGHT [RIG...]]`, with `cargo build
--release` done. Each rig (all, if none is named) films 4 frames of `magazine` by Workbench into a folder of its own (what is there already
isn't filmed again), and the truth of one instant, which `stlfr check` places the cameras from. Residuals
and standard errors are the worst of a rig's cameras; the projection is the largest distance between
pycolmap's pixels and stlfr's, of this rig's cameras.
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
"""What `lost-frames` has left of 4 frames a camera ends before the others' instant."""


def checked(rig: Path, folder: Path, size: str) -> dict[str, Any]:
    """What `stlfr check` finds of a rig's film."""
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
    """A rig's line."""
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
    """Film, check, print."""
    folder, size, *names = Path(sys.argv[1]), *(sys.argv[2:] or ["640x480"])
    rigs = sorted((ROOT / "rigs").glob("*.json"))
    folder.mkdir(parents=True, exist_ok=True)
    print("| rig | rotation, ° | position, mm | projection, px | accused |")
    print("|---|---|---|---|---|")
    for rig in (rig for rig in rigs if not names or rig.stem in names):
        print(row(rig.stem, checked(rig, folder / rig.stem, size)), flush=True)


if __name__ == "__main__":
    main()
