"""Paths as Blender's users write them."""

from __future__ import annotations

from pathlib import Path

import bpy

from .errors import BadInputError


def absolute(path: str) -> Path:
    """A path, `//` being the folder of the .blend."""
    if path.startswith("//") and not bpy.data.filepath:
        raise BadInputError(
            f"{path} lies beside the .blend, which isn't saved yet: save it, or name a whole path"
        )
    return Path(bpy.path.abspath(path)).resolve()
