"""Checks that the compiled module `stlfr` has the version of this extension. Does not import `bpy`."""

from __future__ import annotations

import tomllib
from pathlib import Path

from .errors import FailureError

MANIFEST = Path(__file__).resolve().parent / "blender_manifest.toml"


def require(manifest: Path = MANIFEST) -> None:
    """Raises `FailureError` if the module `stlfr` is missing, or has another version than the extension's manifest."""
    expected = manifest_version(manifest)
    try:
        import stlfr
    except ImportError as error:
        raise FailureError(
            f"the extension stlfr {expected} can't be enabled: its module stlfr can't be loaded ({error})"
        ) from None
    if stlfr.__version__ != expected:
        raise FailureError(
            f"the extension stlfr {expected} can't be enabled: the module stlfr that is installed has "
            f"version {stlfr.__version__}; remove the extension, restart Blender and install it again"
        )


def manifest_version(manifest: Path) -> str:
    """The extension's version in its manifest."""
    with manifest.open("rb") as stream:
        return str(tomllib.load(stream)["version"])
