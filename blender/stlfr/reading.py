"""Reading files that anybody may have written: regular files only, up to a stated size. No `bpy` here.

The compiled module bounds what it reads itself; this is for the few files that Python reads.
"""

from __future__ import annotations

import os
import stat
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

MAX_BYTES = 64 << 20
"""Largest file that is read, as the module's. Larger: a mistake, parsed, takes gigabytes of memory.
Smaller: captures of long recordings are refused."""


def read_text(path: Path) -> str:
    """A file's text; an `OSError` or a `ValueError` says why not. It never waits, as at a pipe."""
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
