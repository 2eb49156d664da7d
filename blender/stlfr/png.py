"""PNG files at the level of chunks: whole or not, and free of what isn't the picture. No `bpy` here."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

SIGNATURE = b"\x89PNG\r\n\x1a\n"
START = SIGNATURE + b"\0\0\0\rIHDR"
END = b"\0\0\0\0IEND\xaeB`\x82"


def is_whole(path: Path, width_px: int, height_px: int) -> bool:
    """Whether a file is a PNG of this size with both its ends: cheap, and false for any cut-off file."""
    try:
        with path.open("rb") as stream:
            start = stream.read(24)
            stream.seek(-len(END), 2)
            end = stream.read()
    except OSError:
        return False
    return start == START + struct.pack(">II", width_px, height_px) and end == END


def picture_only(data: bytes) -> bytes:
    """The same picture without Blender's notes in it (render times, resolution): the same pixels, the same bytes."""
    kept, offset = [SIGNATURE], len(SIGNATURE)
    while offset < len(data):
        (length,) = struct.unpack_from(">I", data, offset)
        chunk = data[offset : offset + 12 + length]
        if chunk[4:8] in (b"IHDR", b"IDAT", b"IEND"):
            kept.append(chunk)
        offset += len(chunk)
    return b"".join(kept)
