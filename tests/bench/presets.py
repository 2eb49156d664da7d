"""The default beside presets and methods: decibels and processor seconds of views beside the truth.

    .venv/bin/python -I tests/bench/presets.py CAPTURE...

Rendered are the views of the truth that no camera has, such as `between`, at all instants of the truth. Offsets
are those of the capture's folder. A row has the mean PSNR over the views, of the moving part and of the whole
image, and the median of the processor seconds of a view over all threads, with everything stored that views share.
The last line of a capture is the default's distance from the best row. What is measured is cached in the capture's
folder, so give a copy of it. It needs `stlfr setup`.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import stlfr

ROWS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("default", "best", {}),
    ("draft", "draft", {}),
    ("balanced", "balanced", {}),
    ("best over the mesh", "best", {"proxy": "mesh"}),
    ("best over depth", "best", {"proxy": "depth"}),
    ("best by scene flow", "best", {"proxy": "scene-flow"}),
)
MOVING_PX = 0.5
"""Motion within a frame above which a surface moves, as in `stlfr compare`."""
DILATION_PX = 2
"""Radius by which the moving part is dilated, as in `stlfr compare`."""

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


def main() -> None:
    """Print a table for every capture."""
    for folder in map(Path, sys.argv[1:]):
        views = hidden_views(folder)
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
        print(f"\nThe default is {lost:.2f} dB below {best}.", flush=True)


def hidden_views(folder: Path) -> list[dict[str, Any]]:
    """The views of the truth at places where no camera stands."""
    views: list[dict[str, Any]] = json.loads((folder / "truth/truth.json").read_text())[
        "views"
    ]
    return [view for view in views if view.get("like") is None]


def measured(
    folder: Path, views: list[dict[str, Any]], preset: str, options: dict[str, Any]
) -> tuple[float, float, float]:
    """Mean PSNR of the moving part and of the whole image, and the median of a view's processor seconds."""
    moving, whole, seconds = [], [], []
    capture = stlfr.open(folder)
    for view in views:
        truth = read(folder / "truth" / view["image"])
        for _ in range(2):  # The first run stores what views of this instant share.
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
        motion = np.load(folder / "truth" / view["motion"])
        whole.append(psnr_db(image, truth, np.ones(truth.shape[:2], bool)))
        moving.append(psnr_db(image, truth, moving_part(motion)))
    return float(np.nanmean(moving)), float(np.mean(whole)), float(np.median(seconds))


def read(file: Path) -> Image:
    """An image in colours, red first."""
    return np.asarray(cv2.imread(str(file), cv2.IMREAD_COLOR)[..., ::-1], np.uint8)


def moving_part(motion_px: npt.NDArray[np.float32]) -> Mask:
    """The pixels whose surface moves, dilated."""
    moves = (np.isfinite(motion_px) & (motion_px > MOVING_PX)).astype(np.uint8)
    side = 2 * DILATION_PX + 1
    return cv2.dilate(moves, np.ones((side, side), np.uint8)).astype(np.bool_)


def psnr_db(image: npt.NDArray[Any], truth: Image, mask: Mask) -> float:
    """PSNR over the pixels of a mask; not a number without pixels."""
    if not mask.any():
        return float("nan")
    error = image[mask].astype(np.float64) - truth[mask]
    return float(10 * np.log10(255**2 / np.mean(error**2)))


if __name__ == "__main__":
    main()
