"""Reads the float channels of an OpenEXR file as Cycles writes it for filming: one part, scanlines, no compression.

Blender's Python can't access the pixels of render passes, and the extension has no OpenEXR module. An uncompressed file
is simple: a header, a table of offsets, and rows of numbers.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from .errors import FailureError

if TYPE_CHECKING:
    from pathlib import Path

MAGIC = 20000630
FLOAT_PIXELS = 2
TILED_DEEP_OR_MULTIPART = 0x1A00


def read_channels(path: Path) -> dict[str, npt.NDArray[np.float32]]:
    """All channels of the file by their full names (such as `ViewLayer.Depth.Z`), each an array (height, width)."""
    data = path.read_bytes()
    magic, version = struct.unpack_from("<ii", data)
    if magic != MAGIC or version & TILED_DEEP_OR_MULTIPART:
        raise FailureError(f"{path}: not a one-part scanline OpenEXR file")
    attributes, offset = _attributes(data)
    if attributes["compression"] != b"\0":
        raise FailureError(f"{path}: a compressed OpenEXR file")
    x_min, y_min, x_max, y_max = struct.unpack("<4i", attributes["dataWindow"])
    width, height = x_max - x_min + 1, y_max - y_min + 1
    names = _channel_names(attributes["channels"], path)
    rows = np.empty((height, len(names), width), dtype=np.float32)
    for row_offset in struct.unpack_from(f"<{height}Q", data, offset):
        y, size = struct.unpack_from("<ii", data, row_offset)
        rows[y - y_min] = np.frombuffer(data, "<f4", size // 4, row_offset + 8).reshape(
            len(names), width
        )
    return {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(names)}


def _attributes(data: bytes) -> tuple[dict[str, bytes], int]:
    """The attributes of the file's header by name, and the position where the table of row offsets starts."""
    attributes, offset = {}, 8
    while data[offset] != 0:
        name, offset = _text(data, offset)
        _, offset = _text(data, offset)
        (size,) = struct.unpack_from("<i", data, offset)
        attributes[name] = data[offset + 4 : offset + 4 + size]
        offset += 4 + size
    return attributes, offset + 1


def _channel_names(channels: bytes, path: Path) -> list[str]:
    """The channel names in the file's order, which is alphabetical. Raises `FailureError` if a channel isn't float."""
    names, offset = [], 0
    while channels[offset] != 0:
        name, offset = _text(channels, offset)
        (pixel_type,) = struct.unpack_from("<i", channels, offset)
        if pixel_type != FLOAT_PIXELS:
            raise FailureError(f"{path}: channel {name} isn't 32-bit float")
        names.append(name)
        offset += 16
    return names


def _text(data: bytes, offset: int) -> tuple[str, int]:
    end = data.index(b"\0", offset)
    return data[offset:end].decode(), end + 1
