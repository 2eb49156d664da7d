"""Compares the default options with presets and methods: PSNR against the ground truth, and processor seconds per view.

    .venv/bin/python tests/bench/presets.py [--instants N] CAPTURE...

The rendered views are those of the ground truth whose viewpoint isn't a camera's, such as `between`, at all instants of
the ground truth. Offsets are read from the capture's folder. A row has the mean PSNR over these views, of the moving
part and of the whole image, and the median processor time of a view over all threads; results that views of an instant
share are cached before. The last line of a capture states how far the default is below the best row. Results are cached
in the capture's folder, so run this on a copy of the capture. It needs `stlfr setup`.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import stlfr
from ground_truth import free_views, psnr_db, true_picture

ROWS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("default", "best", {}),
    ("draft", "draft", {}),
    ("balanced", "balanced", {}),
    ("best over the mesh", "best", {"proxy": "mesh"}),
    ("best over depth", "best", {"proxy": "depth"}),
    ("best by scene flow", "best", {"proxy": "scene-flow"}),
)


def main() -> None:
    """Print a table for every capture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    parser.add_argument("--instants", type=int, default=100)
    arguments = parser.parse_args()
    for folder in arguments.captures:
        views = free_views(folder)
        times_s = sorted({view["time_s"] for view in views})[: arguments.instants]
        views = [view for view in views if view["time_s"] in times_s]
        print(f"\n{folder.name}: {len(views)} views\n", flush=True)
        print(
            "| options | moving part, dB | whole, dB | s |\n|---|---|---|---|",
            flush=True,
        )
        moving_db: dict[str, float] = {}
        for name, preset, options in ROWS:
            moving, whole, seconds = measured(folder, views, preset, options)
            print(
                f"| {name} | {moving:.2f} | {whole:.2f} | {seconds:.2f} |", flush=True
            )
            moving_db[name] = moving
        best = max(moving_db, key=lambda name: moving_db[name])
        lost = moving_db[best] - moving_db["default"]
        told = f"{lost:.2f} dB below {best}" if lost > 0 else "the best"
        print(f"\nThe default is {told}.", flush=True)


def measured(
    folder: Path, views: list[dict[str, Any]], preset: str, options: dict[str, Any]
) -> tuple[float, float, float]:
    """Render views with a preset and options.

    Returns the mean PSNR of the moving part, the mean PSNR of the whole image, and the median processor seconds.
    """
    moving, whole, seconds = [], [], []
    capture = stlfr.open(folder)
    for view in views:
        truth, moves = true_picture(folder, view)
        for _ in range(2):  # the first run caches results that views share
            start_s = time.process_time()
            image = capture.render(
                view["time_s"],
                camera=view["camera"],
                preset=preset,
                options=options,
                alpha=False,
            )
            passed_s = time.process_time() - start_s
        seconds.append(passed_s)
        whole.append(psnr_db(image, truth, np.ones_like(moves)))
        moving.append(psnr_db(image, truth, moves))
    return float(np.nanmean(moving)), float(np.mean(whole)), float(np.median(seconds))


if __name__ == "__main__":
    main()
