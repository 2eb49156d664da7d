"""What import and offsets say of real arrays, whose recordings are in public repositories and not in this one.

.venv/bin/python tests/bench/real_film.py FOLDER [--program target/release/stlfr] [--keep CAPTURES]

FOLDER is a checkout, or a part of one, of any of these; the layout tells which:
- perfanalytics/pose2sim, Pose2Sim/Demo_SinglePerson: Qualisys' calibration, `videos`
- mprib/caliscope, tests/sessions/SESSION: `camera_array.toml`, and recordings with `timestamps.csv`
- bielaltoe/4_camera_norm_tracker, commit 3048155: `config_camera`, `videos`

Receive times are of one clock. Where there are some, true offsets are 0, but for what reception adds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path


def table(camera: dict[str, object], name: str) -> str:
    """A camera of the third repository's JSON files as a table of Calib.toml."""
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
    """Names of recordings in a folder, with the arguments of their import."""
    found: list[tuple[str, list[str | Path]]] = []
    for calibration in [*folder.glob("*.qca.txt"), *folder.glob("*/*.qca.txt")]:
        # Two of its videos are narrower than the calibration says.
        arguments: list[str | Path] = [calibration, "--images", folder / "videos"]
        found.append((folder.name, [*arguments, "--crop"]))
    array = folder / "camera_array.toml"
    if array.exists():
        for times in sorted(folder.glob("*/*/timestamps.csv")):
            name = "-".join(times.parent.relative_to(folder).parts)
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
