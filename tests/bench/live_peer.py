"""Runs OpenCV for comparison in the benchmark of live views: measures warping and blending, or optical flow.

The argument is a JSON file. For warping, it has the cameras and their images, the views and their depths, and the
number of cameras from which a pixel is blended. Lenses count as pinholes. The median time of a view in milliseconds is
printed, without the computation of the maps for `cv2.remap`. For optical flow, the file has every camera's frames. Then
the time in seconds of DIS flow, preset medium, in both directions between all consecutive frames is printed, without
decoding.
"""

import json
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

Array = np.ndarray[Any, np.dtype[np.float32]]


def center(camera: dict[str, Any]) -> Any:
    """The camera's centre in world coordinates."""
    rows = np.array(camera["rows"])
    return -rows[:, :3].T @ rows[:, 3]


def maps(
    view: dict[str, Any], depths: Array, camera: dict[str, Any]
) -> tuple[Array, Array]:
    """The maps for `cv2.remap`: x and y in a camera's image of each pixel of the view; pixel centres are integers."""
    width, height = view["size"]
    fx, fy, cx, cy = view["intrinsics"]
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    points = (
        np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], -1)
        * depths[..., None]
    )
    rows, own = np.array(camera["rows"]), np.array(view["rows"])
    world = (points - own[:, 3]) @ own[:, :3]
    seen = world @ rows[:, :3].T + rows[:, 3]
    fx, fy, cx, cy = camera["intrinsics"]
    z = seen[..., 2]
    at = [fx * seen[..., 0] / z + cx - 0.5, fy * seen[..., 1] / z + cy - 0.5]
    first, second = (np.nan_to_num(a, nan=-1.0).astype(np.float32) for a in at)
    return first, second


def flow_s(cameras: list[list[str]]) -> float:
    """Seconds that DIS flow takes in both directions between all consecutive frames of each camera."""
    opencv: Any = cv2
    dis = opencv.DISOpticalFlow_create(opencv.DISOPTICAL_FLOW_PRESET_MEDIUM)
    seconds = 0.0
    for frames in cameras:
        images = [opencv.imread(frame, cv2.IMREAD_GRAYSCALE) for frame in frames]
        start = time.perf_counter()
        for earlier, later in pairwise(images):
            dis.calc(earlier, later, None)
            dis.calc(later, earlier, None)
        seconds += time.perf_counter() - start
    return seconds


def main() -> None:
    """Blend every view twice, of which the second time is measured, and print the median time; or print flow's time."""
    request = json.loads(Path(sys.argv[1]).read_text())
    if "frames" in request:
        print(flow_s(request["frames"]))
        return
    opencv: Any = cv2
    images = [opencv.imread(c["image"], cv2.IMREAD_COLOR) for c in request["cameras"]]
    times = []
    for view in request["views"]:
        width, height = view["camera"]["size"]
        depths = np.fromfile(view["depths"], np.float32).reshape(height, width)
        place = center(view["camera"])
        cameras = [c["camera"] for c in request["cameras"]]
        distances = [np.linalg.norm(center(c) - place) for c in cameras]
        near = np.argsort(distances)[: request["blended"]]
        warps = [maps(view["camera"], depths, cameras[k]) for k in near]
        weights = [
            np.full((height, width, 3), 1.0 / len(near), np.float32) for _ in near
        ]
        for _ in range(2):
            start = time.perf_counter()
            total: Any = None
            for k, warp, weight in zip(near, warps, weights, strict=True):
                warped = opencv.remap(images[k], *warp, cv2.INTER_CUBIC)
                part = opencv.multiply(warped, weight, dtype=cv2.CV_32F)
                total = part if total is None else opencv.add(total, part)
            opencv.convertScaleAbs(total)
            spent = time.perf_counter() - start
        times.append(1000.0 * spent)
    print(np.median(times))


main()
