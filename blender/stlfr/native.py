"""Functions of the compiled module `stlfr` that filming uses, with this package's errors. Does not import `bpy`.

The compiled module is imported at the first call, because a worker process in Blender's own program lacks it and
doesn't need it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .errors import BadInputError, FailureError

Content = dict[str, Any]
"""The content of a JSON file that holds an object."""


@contextlib.contextmanager
def _own_errors() -> Iterator[None]:
    """Turn errors of the compiled module, and its absence, into `BadInputError` and `FailureError`."""
    try:
        yield
    except ImportError as error:
        raise FailureError(f"the module stlfr can't be loaded ({error})") from None
    except (ValueError, FileNotFoundError) as error:
        raise BadInputError(str(error)) from None


def read_rig(path: Path) -> Content:
    """The content of a rig file, checked. It lacks fields that have their default values.

    Raises `BadInputError` if the rig is invalid; the message names the file and the field.
    """
    with _own_errors():
        import stlfr

        return stlfr.read_rig(path)


def check_rig(content: Content) -> None:
    """Check the content of a rig file. Raises `BadInputError` if it is invalid; the message starts with the field."""
    with _own_errors():
        import stlfr

        stlfr.check_rig(content)


def generate_rig(options: Content) -> Content:
    """The content of the rig file that `stlfr rig` writes for the same options and seed."""
    with _own_errors():
        import stlfr

        return stlfr.generate_rig(options)


def colmap_text(images: list[tuple[str, Content]]) -> dict[str, str]:
    """The contents of COLMAP's text model by file name, for images given by their names and camera objects."""
    with _own_errors():
        import stlfr

        return stlfr.colmap_text(images)
