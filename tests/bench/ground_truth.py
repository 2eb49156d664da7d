"""Shared functions of benchmarks that compare rendered views with the ground truth of a filmed capture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

MOVING_PX = 0.5
"""Minimum motion per frame of a surface that counts as moving, as in `stlfr compare`."""
DILATION_PX = 2
"""Radius by which the moving part is dilated, as in `stlfr compare`."""

Mask = npt.NDArray[np.bool_]


def truth_of(capture: Path) -> dict[str, Any]:
    """The content of a capture's truth.json."""
    file = capture / "truth/truth.json"
    if not file.is_file():
        raise SystemExit(f"{file}: is missing, so there is nothing to compare with")
    content: dict[str, Any] = json.loads(file.read_text())
    return content


def free_views(capture: Path) -> list[dict[str, Any]]:
    """The ground truth views whose viewpoint isn't that of a camera."""
    return [view for view in truth_of(capture)["views"] if view.get("like") is None]


def true_picture(
    capture: Path, view: dict[str, Any]
) -> tuple[npt.NDArray[np.uint8], Mask]:
    """The ground truth picture of a view, (H, W, 3) in RGB, and the mask of its moving part."""
    folder = capture / "truth"
    picture = cv2.imread(str(folder / view["image"]), cv2.IMREAD_COLOR)[..., ::-1]
    return np.asarray(picture, np.uint8), moving_part(np.load(folder / view["motion"]))


def moving_part(motion_px: npt.NDArray[np.float32]) -> Mask:
    """The mask of pixels that show moving surfaces, dilated by `DILATION_PX`."""
    moves = (np.isfinite(motion_px) & (motion_px > MOVING_PX)).astype(np.uint8)
    side = 2 * DILATION_PX + 1
    return cv2.dilate(moves, np.ones((side, side), np.uint8)).astype(np.bool_)


def psnr_db(image: npt.NDArray[Any], truth: npt.NDArray[Any], mask: Mask) -> float:
    """PSNR over the pixels of a mask, for values from 0 to 255; NaN if the mask is empty."""
    if not mask.any():
        return float("nan")
    error = image[mask].astype(np.float64) - truth[mask]
    return float(10 * np.log10(255**2 / np.mean(error**2)))


def read_view(file: Path) -> npt.NDArray[np.uint8]:
    """Read a rendered picture in RGB. Pixels that no camera sees are set to black."""
    image = np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), np.uint8)
    if image.shape[2] == 4:
        image = image[..., :3] * (image[..., 3:] > 0)
    return image[..., 2::-1]
