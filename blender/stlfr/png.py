"""PNG files at the level of chunks: check completeness, remove metadata, and encode images. Does not import `bpy`."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

SIGNATURE = b"\x89PNG\r\n\x1a\n"
START = SIGNATURE + b"\0\0\0\rIHDR"
END = b"\0\0\0\0IEND\xaeB`\x82"


def is_whole(path: Path, width_px: int, height_px: int) -> bool:
    """Whether a file is a complete PNG of this size. Only its first and last bytes are read."""
    try:
        with path.open("rb") as stream:
            start = stream.read(24)
            stream.seek(-len(END), 2)
            end = stream.read()
    except OSError:
        return False
    return start == START + struct.pack(">II", width_px, height_px) and end == END


def picture_only(data: bytes) -> bytes:
    """Remove Blender's metadata (such as render times) from a PNG file, so that equal pixels give equal bytes."""
    chunks, offset = [SIGNATURE], len(SIGNATURE)
    while offset < len(data):
        (length,) = struct.unpack_from(">I", data, offset)
        chunk = data[offset : offset + 12 + length]
        if chunk[4:8] in (b"IHDR", b"IDAT", b"IEND"):
            chunks.append(chunk)
        offset += len(chunk)
    return b"".join(chunks)


def encoded(
    pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16],
) -> bytes:
    """Encode an image as PNG, with 8 or 16 bits as its type has. Its shape is (H, W) for grey or (H, W, 3) for RGB."""
    height_px, width_px = pixels.shape[:2]
    depth, color = 8 * pixels.itemsize, 0 if pixels.ndim == 2 else 2
    rows = np.frombuffer(pixels.astype(pixels.dtype.newbyteorder(">")).tobytes(), "u1")
    rows = rows.reshape(height_px, -1)
    up = rows.copy()  # filter 2: the difference from the row above
    up[1:] -= rows[:-1]
    lines = np.concatenate([np.full((height_px, 1), 2, "u1"), up], axis=1)
    header = struct.pack(">IIBBBBB", width_px, height_px, depth, color, 0, 0, 0)
    return b"".join(
        [
            SIGNATURE,
            _chunk(b"IHDR", header),
            _chunk(b"IDAT", zlib.compress(lines.tobytes())),
            _chunk(b"IEND", b""),
        ]
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return (
        struct.pack(">I", len(data))
        + kind
        + data
        + struct.pack(">I", zlib.crc32(kind + data))
    )
