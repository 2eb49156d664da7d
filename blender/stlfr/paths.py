"""Conversion of Blender's paths, which may be relative to the .blend file."""

from __future__ import annotations

from pathlib import Path

import bpy

from .errors import BadInputError


def absolute(path: str) -> Path:
    """The absolute path of a path in which a leading `//` stands for the folder of the .blend file.

    Raises `BadInputError` if it begins with `//`, and the .blend file isn't saved yet.
    """
    if path.startswith("//") and not bpy.data.filepath:
        raise BadInputError(
            f"{path} lies beside the .blend, which isn't saved yet: save it, or name a whole path"
        )
    return Path(bpy.path.abspath(path)).resolve()
