"""Other methods of temporal interpolation for the `picture` benchmark: OpenCV's DIS flow and ffmpeg's minterpolate.

    .venv/bin/python -I tests/bench/picture_peer.py REQUEST.json

The request is a list of jobs. A job has `frames`, four consecutive image files of one camera. The instant to
interpolate lies between the second and the third frame; `fraction` is its position between them, from 0 to 1. `out` is
the prefix of the two results, `OUT-dis.png` and `OUT-minterpolate.png`, in RGB. Both methods assume constant velocity
between the two frames.

Known limits: DIS uses grey images of 8 bits. minterpolate works in 8 bits and moves blocks by whole pixels. The instant
that ffmpeg interpolates has an error of up to a thousandth of the frame interval.
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
"""Scale of the forward-backward error at which the weight of a match falls. If larger, occluded surfaces give ghosts;
if smaller, pixels that both frames show are taken from one frame."""
DOUBT = 0.1
"""Weight of a frame in which a pixel is not visible. If larger, there are ghosts; if smaller, the choice of a frame is
arbitrary where neither frame has a consistent match."""
PHOTO_SCALE = 0.05
"""Scale of the difference of matched pixel values (0 to 1) at which the weight of a splatted flow falls. It matters
where several flow vectors lead to one pixel. If larger, surfaces are mixed; if smaller, highlights have too much
influence."""
HOLE_WEIGHT = 1e-3
"""Sum of splatted weights below which a pixel counts as a hole. If larger, holes grow; if smaller, inconsistent flow
fills them."""
MAX_DENOMINATOR = 1_000_000
"""Maximum denominator of the frame rate that is passed to ffmpeg. If smaller, the interpolated instant is
inaccurate."""


def main() -> None:
    """Do all jobs of the request file."""
    dis = opencv.DISOpticalFlow_create(opencv.DISOPTICAL_FLOW_PRESET_MEDIUM)
    for job in json.loads(Path(sys.argv[1]).read_text()):
        frames = [read(f) for f in job["frames"]]
        write(
            job["out"] + "-dis.png", by_flow(dis, frames[1], frames[2], job["fraction"])
        )
        write(job["out"] + "-minterpolate.png", by_ffmpeg(frames, job["fraction"]))


def read(path: str) -> Array:
    """Read an image as RGB with values from 0 to 1."""
    image = opencv.imread(path, opencv.IMREAD_UNCHANGED)
    if image.ndim == 2:
        image = opencv.cvtColor(image, opencv.COLOR_GRAY2BGR)
    return (image[:, :, ::-1] / np.float32(np.iinfo(image.dtype).max)).astype(
        np.float32
    )


def write(path: str, image: Array) -> None:
    """Write an RGB image with 16 bits per channel."""
    levels = np.clip(image[:, :, ::-1] * 65535 + 0.5, 0, 65535).astype(np.uint16)
    if not opencv.imwrite(path, levels):
        raise OSError(path)


def gray(image: Array) -> npt.NDArray[np.uint8]:
    """The image as 8-bit grey, the input of DIS."""
    return opencv.cvtColor((image * 255 + 0.5).astype(np.uint8), opencv.COLOR_RGB2GRAY)


def grid(like: Array) -> Array:
    """The position (x, y) of every pixel, (H, W, 2); the top-left pixel is at 0."""
    height, width = like.shape[:2]
    return np.dstack(np.meshgrid(np.arange(width), np.arange(height))).astype(
        np.float32
    )


def sample(field: Array, at: Array, method: int = cv2.INTER_LINEAR) -> Array:
    """Values of an image or a flow field at the positions `at` (H, W, 2), by interpolation."""
    return opencv.remap(field, at, None, method, borderMode=opencv.BORDER_REPLICATE)


def consistency(there: Array, back: Array) -> Array:
    """The forward-backward consistency of a flow `there`: 1 if the flow `back` is its inverse, else towards 0."""
    error = there + sample(back, grid(there) + there)
    return np.exp(-(error**2).sum(axis=2) / CONSISTENT_PX**2)


def splat(to: Array, values: Array, weights: Array) -> npt.NDArray[np.float64]:
    """Forward splatting: the sums of weighted values (H, W, N) that are moved to positions `to` (H, W, 2).

    Each value is distributed bilinearly among the four pixels around its position.
    """
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
    """The flow with holes (where not `known`) filled by interpolation of their surroundings, from coarse to fine."""
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
    """The flow from the first to the second frame, at the pixels of the interpolated instant, whose fraction is `t`.

    `flows` are the flows from each frame to the other one, `seen` their consistencies.
    """
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
    """Interpolate two frames at the fraction `t`: warp both by DIS flow, and blend them by visibility and time."""
    grays = [gray(first), gray(second)]
    flows = [dis.calc(grays[0], grays[1], None), dis.calc(grays[1], grays[0], None)]
    seen = [consistency(flows[0], flows[1]), consistency(flows[1], flows[0])]
    flow = intermediate([first, second], flows, seen, t)
    at = [grid(flow) - t * flow, grid(flow) + (1 - t) * flow]
    # A pixel of one frame without a consistent match isn't visible in the other frame.
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
    """Interpolate by ffmpeg's minterpolate, with an output frame rate whose third picture is at the fraction `t`."""
    height, width = frames[0].shape[:2]
    # One frame per second. The first frame is repeated, because the filter starts in the interval after the second one.
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
