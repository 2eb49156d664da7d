"""Prints a table of the fraction of pixels that the cameras see, in frames of the ready-made camera paths.

Run as `.venv/bin/python -I tests/bench/coverage.py [--program PROGRAM] CAPTURE... [-- OPTION...]`. Each capture is
copied, and `stlfr render --path` renders 9 frames of each path, with the options after `--`. A row has a capture, a
path, and the fractions of pixels that at least one camera sees: in the worst frame, and in all frames. The exit code is
1 if the fraction is below 99 % in some frame.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PATHS = ("sweep", "orbit", "bullet-time", "dolly")
FRAMES = ["--duration", "4", "--fps", "2"]
REQUIRED = 0.99


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
        subprocess.run(command, check=True)
        return [seen_fraction(file) for file in sorted(Path(scratch).glob("*.png"))]


def main() -> None:
    """Render the paths of all captures, print the table, and exit with 1 if a frame has too low a fraction."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/stlfr")
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
            for path in PATHS:
                seen = seen_fractions(arguments.program, capture, path, options)
                worst = min(worst, *seen)
                shown = f"{100 * min(seen):.2f} | {100 * np.mean(seen):.2f}"
                print(f"| `{original.name}` | {path} | {shown} |", flush=True)
    sys.exit(0 if worst >= REQUIRED else 1)


if __name__ == "__main__":
    main()
