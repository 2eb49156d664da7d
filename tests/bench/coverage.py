"""Prints a table of the fraction of pixels that the cameras see, in frames of the ready-made camera paths.

Run as `.venv/bin/python tests/bench/coverage.py [--program PROGRAM] [--true-clocks] CAPTURE... [-- OPTION...]`. Each
capture is copied, and `stlfr render --path` renders 9 frames of each path, with the options after `--`. With
`--true-clocks` the cameras' times are the true ones, for scenes in which too little moves for the offsets. A row has a
capture, a path, and the fractions of pixels that at least one camera sees: in the worst frame, and in all frames. The
exit code is 1 if the fraction is below 99 % in some frame, or if a path isn't rendered.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from ground_truth import truth_of

ROOT = Path(__file__).resolve().parents[2]
PATHS = ("sweep", "orbit", "bullet-time", "dolly")
FRAMES = ["--duration", "4", "--fps", "2"]
REQUIRED = 0.99


class RefusedError(Exception):
    """The program renders no such path from this capture; the message is the program's."""


def state_true_clocks(capture: Path) -> None:
    """Give all cameras of a capture their true times, so that nothing has to move for the offsets to be known."""
    description = capture / "capture.json"
    content = json.loads(description.read_text())
    times_s = {entry["id"]: entry["times_s"] for entry in truth_of(capture)["shutter"]}
    for camera in content["cameras"]:
        camera["clock"] = {"times_s": times_s[camera["id"]], "shared": True}
    description.write_text(json.dumps(content))


def seen_fraction(file: Path) -> float:
    """The fraction of an image's pixels that aren't transparent; `render` writes alpha only where some are."""
    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert image is not None, file
    has_alpha = image.ndim == 3 and image.shape[2] == 4
    return float((image[..., 3] > 0).mean()) if has_alpha else 1.0


def seen_fractions(
    program: Path, capture: Path, path: str, options: list[str]
) -> list[float]:
    """The fraction of pixels seen by some camera, for each of the rendered frames of a ready-made camera path."""
    with tempfile.TemporaryDirectory() as scratch:
        command = [str(program), "-q", "render", str(capture), "--path", path]
        command += [*FRAMES, *options, "-o", f"{scratch}/%04d.png"]
        ended = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
        if ended.returncode != 0:
            raise RefusedError(ended.stderr.strip())
        return [seen_fraction(file) for file in sorted(Path(scratch).glob("*.png"))]


def main() -> None:
    """Render the paths of all captures, print the table, and exit with 1 if a frame has too low a fraction."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/stlfr")
    parser.add_argument("--true-clocks", action="store_true")
    parser.add_argument("captures", type=Path, nargs="+")
    words = sys.argv[1:]
    end = words.index("--") if "--" in words else len(words)
    arguments, options = parser.parse_args(words[:end]), words[end + 1 :]
    worst = 1.0
    print("| capture | path | worst frame, % | all frames, % |")
    print("|---|---|---|---|")
    for original in arguments.captures:
        with tempfile.TemporaryDirectory() as scratch:
            capture = Path(shutil.copytree(original, Path(scratch) / original.name))
            if arguments.true_clocks:
                state_true_clocks(capture)
            for path in PATHS:
                try:
                    seen = seen_fractions(arguments.program, capture, path, options)
                except RefusedError as why:
                    worst = 0.0
                    print(f"| `{original.name}` | {path} | {why} | |", flush=True)
                    continue
                worst = min(worst, *seen)
                shown = f"{100 * min(seen):.2f} | {100 * np.mean(seen):.2f}"
                print(f"| `{original.name}` | {path} | {shown} |", flush=True)
    sys.exit(0 if worst >= REQUIRED else 1)


if __name__ == "__main__":
    main()
