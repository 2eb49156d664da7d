"""What the compiled module `stlfr` does for filming: rig files, new rigs, COLMAP's text. No `bpy` here.

The module is imported at the first call: a filming process inside Blender's own program has none, and
needs none.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .errors import BadInputError, FailureError

Content = dict[str, Any]
"""What a JSON file holds."""


@contextlib.contextmanager
def _own_errors() -> Iterator[None]:
    """Turn the module's errors, and its absence, into this package's."""
    try:
        yield
    except ImportError as error:
        raise FailureError(f"the module stlfr can't be loaded ({error})") from None
    except (ValueError, FileNotFoundError) as error:
        raise BadInputError(str(error)) from None


def read_rig(path: Path) -> Content:
    """The content of a rig file, checked; a `BadInputError` names the file and the field.

    Fields that have their default values are left out.
    """
    with _own_errors():
        import stlfr

        return stlfr.read_rig(path)


def check_rig(content: Content) -> None:
    """Refuse a rig that can't be filmed with: a `BadInputError` starts with the field."""
    with _own_errors():
        import stlfr

        stlfr.check_rig(content)


def generate_rig(options: Content) -> Content:
    """The rig that `stlfr rig` writes for the same options and seed."""
    with _own_errors():
        import stlfr

        return stlfr.generate_rig(options)


def colmap_text(images: list[tuple[str, Content]]) -> dict[str, str]:
    """The files of COLMAP's text model by their names, from each image's name and camera."""
    with _own_errors():
        import stlfr

        return stlfr.colmap_text(images)
