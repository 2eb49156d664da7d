"""Reads files of untrusted origin: only regular files up to a maximum size. Does not import `bpy`.

The compiled module limits the files that it reads in the same way; this module is for the few files that Python reads.
"""

from __future__ import annotations

import os
import stat
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

MAX_BYTES = 64 << 20
"""Maximum size of a file, equal to that of the compiled module. If larger, parsing a wrong file may take gigabytes of
memory; if smaller, captures of long recordings are refused."""


def read_text(path: Path) -> str:
    """The text of a file. Raises `OSError` or `ValueError` if it can't be read. Never waits, not even for a pipe."""
    flags = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, os.O_RDONLY | flags)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise ValueError("is no regular file")
        if status.st_size > MAX_BYTES:
            raise ValueError(f"is larger than {MAX_BYTES >> 20} MiB")
        with os.fdopen(descriptor, "rb", closefd=False) as stream:
            return stream.read(MAX_BYTES).decode("utf-8")
    finally:
        os.close(descriptor)
