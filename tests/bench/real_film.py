"""Runs `stlfr import` and `stlfr offsets` on recordings of real camera arrays from public repositories.

.venv/bin/python tests/bench/real_film.py FOLDER [--program target/release/stlfr] [--keep CAPTURES]

FOLDER is a checkout, or a part of one, of one of these repositories; its layout decides which one:
- perfanalytics/pose2sim, Pose2Sim/Demo_SinglePerson: Qualisys' calibration, `videos`
- mprib/caliscope, tests/sessions/SESSION: `camera_array.toml`, and recordings with `timestamps.csv`
- bielaltoe/4_camera_norm_tracker, commit 3048155: `config_camera`, `videos`

`timestamps.csv` has the times at which one computer received the frames. With this file, the true offsets are 0, except
for different delays of transmission.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path


def table(camera: dict[str, object], name: str) -> str:
    """Convert a camera of 4_camera_norm_tracker's JSON files to a table of Pose2Sim's Calib.toml."""
    size = camera["resolution"]
    k = camera["intrinsic"]["doubles"]  # type: ignore[index]
    pose = camera["extrinsic"][0]["tf"]["doubles"]  # type: ignore[index]
    rows = [pose[4 * r : 4 * r + 3] for r in range(3)]
    return (
        f"[{name}]\nsize = [{size['width']}, {size['height']}]\n"  # type: ignore[index]
        f"matrix = [{k[:3]}, {k[3:6]}, {k[6:]}]\n"
        f"distortions = {camera['distortion']['doubles']}\n"  # type: ignore[index]
        f"rotation = {rows}\ntranslation = {[pose[4 * r + 3] for r in range(3)]}\n"
    )


def recordings(folder: Path, scratch: Path) -> list[tuple[str, list[str | Path]]]:
    """The recordings in a folder: their names, and their arguments of `stlfr import`."""
    found: list[tuple[str, list[str | Path]]] = []
    for calibration in [*folder.glob("*.qca.txt"), *folder.glob("*/*.qca.txt")]:
        # Two of the videos are narrower than in the calibration.
        arguments: list[str | Path] = [calibration, "--images", folder / "videos"]
        found.append((folder.name, [*arguments, "--crop"]))
    array = folder / "camera_array.toml"
    if array.exists():
        for times in sorted(folder.glob("*/*/timestamps.csv")):
            name = "-".join((folder.name, *times.parent.relative_to(folder).parts))
            found.append((name, [array, "--images", times.parent]))
    configs = sorted((folder / "config_camera").glob("*.json"))
    if configs:
        tables = [table(json.loads(c.read_text()), f"cam{c.stem}") for c in configs]
        path = scratch / "Calib.toml"
        path.write_text("\n".join(tables))
        found.append((folder.name, [path, "--images", folder / "videos"]))
    return found


def main() -> None:
    """Import every recording of the folder and estimate its offsets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--program", default="target/release/stlfr")
    parser.add_argument("--keep", type=Path, help="where captures stay")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        captures = options.keep or Path(scratch)
        captures.mkdir(parents=True, exist_ok=True)
        for name, arguments in recordings(options.folder, Path(scratch)):
            print(f"== {name}", flush=True)
            capture = captures / name
            if not capture.exists():
                command = [options.program, "import", *arguments, "-o", capture]
                if subprocess.run(command, check=False).returncode:
                    continue
            subprocess.run([options.program, "offsets", capture], check=False)


if __name__ == "__main__":
    main()
