"""Peers of temporal interpolation for the `picture` benchmark: OpenCV's DIS flow and ffmpeg's minterpolate.

    .venv/bin/python -I tests/bench/picture_peer.py REQUEST.json

The request is a list of jobs: `frames`, four image files of one camera, of which the instant lies between the
second and the third; `fraction`, the instant's place between those two; `out`, the prefix of the results. Written
are `out-dis.png` and `out-minterpolate.png`, RGB. Both peers take motion as even between the two frames.

Known limits: DIS sees grey images of 8 bits; minterpolate works in 8 bits and moves blocks by whole pixels. The
instant that ffmpeg is asked for is right to a thousandth of the interval.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import imageio_ffmpeg
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]

opencv: Any = cv2  # its stubs know neither None nor the presets

CONSISTENT_PX = 1.0
"""Scale of the forward-backward error at which a match is believed. Larger: occluded things are ghosted; smaller:
what both frames show is taken from one."""
DOUBT = 0.1
"""Weight of a frame in which a pixel is not visible. Larger: ghosts; smaller: where neither frame is believed, the
choice between them is arbitrary."""
PHOTO_SCALE = 0.05
"""Scale of the difference of matched values, of 1, at which a flow yields to another that leads to the same place.
Larger: surfaces mix; smaller: highlights decide."""
HOLE_WEIGHT = 1e-3
"""Sum of weights under which no flow leads to a pixel. Larger: holes grow; smaller: flows that are not believed fill
them."""
MAX_DENOMINATOR = 1_000_000
"""Of the rate that ffmpeg is asked for. Smaller: the instant is missed."""


def main() -> None:
    """Do all jobs."""
    dis = opencv.DISOpticalFlow_create(opencv.DISOPTICAL_FLOW_PRESET_MEDIUM)
    for job in json.loads(Path(sys.argv[1]).read_text()):
        frames = [read(f) for f in job["frames"]]
        write(
            job["out"] + "-dis.png", by_flow(dis, frames[1], frames[2], job["fraction"])
        )
        write(job["out"] + "-minterpolate.png", by_ffmpeg(frames, job["fraction"]))


def read(path: str) -> Array:
    """An image, red first, 0..=1."""
    image = opencv.imread(path, opencv.IMREAD_UNCHANGED)
    if image.ndim == 2:
        image = opencv.cvtColor(image, opencv.COLOR_GRAY2BGR)
    return (image[:, :, ::-1] / np.float32(np.iinfo(image.dtype).max)).astype(
        np.float32
    )


def write(path: str, image: Array) -> None:
    """Write 16 bits a channel."""
    levels = np.clip(image[:, :, ::-1] * 65535 + 0.5, 0, 65535).astype(np.uint16)
    if not opencv.imwrite(path, levels):
        raise OSError(path)


def gray(image: Array) -> npt.NDArray[np.uint8]:
    """What DIS takes."""
    return opencv.cvtColor((image * 255 + 0.5).astype(np.uint8), opencv.COLOR_RGB2GRAY)


def grid(like: Array) -> Array:
    """Every pixel's own place."""
    height, width = like.shape[:2]
    return np.dstack(np.meshgrid(np.arange(width), np.arange(height))).astype(
        np.float32
    )


def sample(field: Array, at: Array, method: int = cv2.INTER_LINEAR) -> Array:
    """Values of an image or a flow at places."""
    return opencv.remap(field, at, None, method, borderMode=opencv.BORDER_REPLICATE)


def consistency(there: Array, back: Array) -> Array:
    """1 where the flow back undoes the flow there, towards 0 where it doesn't."""
    error = there + sample(back, grid(there) + there)
    return np.exp(-(error**2).sum(axis=2) / CONSISTENT_PX**2)


def splat(to: Array, values: Array, weights: Array) -> npt.NDArray[np.float64]:
    """Sums of weighted values, several a pixel, carried to places and shared bilinearly among four pixels."""
    height, width = weights.shape
    low = np.floor(to).astype(np.int64)
    part = to - low
    sums = np.zeros((height * width, values.shape[2]))
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        x, y = low[..., 0] + dx, low[..., 1] + dy
        share = np.abs(1 - dx - part[..., 0]) * np.abs(1 - dy - part[..., 1]) * weights
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        at = (y * width + x)[inside]
        for n in range(values.shape[2]):
            weighted = (share * values[..., n])[inside]
            sums[:, n] += np.bincount(at, weighted, height * width)
    return sums.reshape(height, width, -1)


def filled(flow: Array, known: npt.NDArray[np.bool_]) -> Array:
    """The flow with its holes filled from around them, coarse to fine."""
    if known.all() or not known.any() or min(known.shape) < 2:
        return flow
    weight = known.astype(np.float32)
    size = ((known.shape[1] + 1) // 2, (known.shape[0] + 1) // 2)
    low = opencv.resize(weight, size, interpolation=opencv.INTER_AREA)
    coarse = opencv.resize(
        flow * weight[..., None], size, interpolation=opencv.INTER_AREA
    )
    coarse = filled(coarse / np.maximum(low, 1e-6)[..., None], low > 0)
    coarse = opencv.resize(coarse, known.shape[::-1], interpolation=opencv.INTER_LINEAR)
    return np.where(known[..., None], flow, coarse)


def intermediate(
    images: list[Array], flows: list[Array], seen: list[Array], t: float
) -> Array:
    """The flow from the first to the second frame, at the pixels of the instant between them."""
    sums = np.zeros((*images[0].shape[:2], 3))
    for k, (flow, share) in enumerate(zip(flows, (t, 1 - t), strict=True)):
        matched = sample(images[1 - k], grid(flow) + flow)
        difference = np.abs(matched - images[k]).mean(axis=2)
        weights = (1 - share) * (seen[k] + DOUBT) * np.exp(-difference / PHOTO_SCALE)
        forward = flow if k == 0 else -flow
        ones = np.ones_like(forward[..., :1])
        values = np.concatenate([forward, ones], axis=2)
        sums += splat(grid(flow) + share * flow, values, weights)
    flow = sums[..., :2] / np.maximum(sums[..., 2:], 1e-9)
    return filled(flow.astype(np.float32), sums[..., 2] > HOLE_WEIGHT)


def by_flow(dis: Any, first: Array, second: Array, t: float) -> Array:
    """Both frames warped by the flow at the instant, each where it is visible."""
    grays = [gray(first), gray(second)]
    flows = [dis.calc(grays[0], grays[1], None), dis.calc(grays[1], grays[0], None)]
    seen = [consistency(flows[0], flows[1]), consistency(flows[1], flows[0])]
    flow = intermediate([first, second], flows, seen, t)
    at = [grid(flow) - t * flow, grid(flow) + (1 - t) * flow]
    # What has no match in the other frame is not visible there.
    weights = [
        (1 - t) * (sample(seen[1], at[1]) + DOUBT),
        t * (sample(seen[0], at[0]) + DOUBT),
    ]
    warped = [
        sample(image, p, cv2.INTER_CUBIC)
        for image, p in zip((first, second), at, strict=True)
    ]
    mixed = sum(w[..., None] * image for w, image in zip(weights, warped, strict=True))
    return mixed / (weights[0] + weights[1])[..., None]


def by_ffmpeg(frames: list[Array], t: float) -> Array:
    """ffmpeg's motion-compensated interpolation, at a rate whose third picture is at the instant."""
    height, width = frames[0].shape[:2]
    # One frame a second, the first twice: the filter begins with the interval after the second frame.
    clip = [frames[0], *frames, frames[-1], frames[-1]]
    raw = b"".join((f * 255 + 0.5).astype(np.uint8).tobytes() for f in clip)
    rate = Fraction(2 / (2 + t)).limit_denominator(MAX_DENOMINATOR)
    options = "mi_mode=mci:mc_mode=aobmc:me_mode=bidir:vsbmc=1:scd=none"
    filters = f"format=yuvj444p,minterpolate=fps={rate.numerator}/{rate.denominator}:{options}"
    with tempfile.TemporaryDirectory() as folder:
        command = [
            imageio_ffmpeg.get_ffmpeg_exe(),
            "-hide_banner",
            "-loglevel",
            "error",
        ]
        command += [
            "-f",
            "rawvideo",
            "-pixel_format",
            "rgb24",
            "-video_size",
            f"{width}x{height}",
        ]
        command += [
            "-framerate",
            "1",
            "-i",
            "pipe:0",
            "-vf",
            filters,
            "-fps_mode",
            "passthrough",
        ]
        command += [
            "-enc_time_base",
            "filter",
            "-pix_fmt",
            "rgb24",
            "-frame_pts",
            "1",
            f"{folder}/%d.png",
        ]
        subprocess.run(command, input=raw, check=True)
        return read(f"{folder}/2.png")


if __name__ == "__main__":
    main()
