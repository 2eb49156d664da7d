"""The compiled module `stlfr` has to be the one that this extension brings. No `bpy` here."""

from __future__ import annotations

import tomllib
from pathlib import Path

from .errors import FailureError

MANIFEST = Path(__file__).resolve().parent / "blender_manifest.toml"


def require(manifest: Path = MANIFEST) -> None:
    """Refuse a missing module, or one of another version than the manifest's."""
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
    """The version that a manifest states."""
    with manifest.open("rb") as stream:
        return str(tomllib.load(stream)["version"])
