"""Import folders of this project as packages, for the scripts beside this file.

The folder `stlfr` is imported under another name, because the compiled module is called `stlfr` too. To import this
file, a script puts its folder on `sys.path`; it then removes the folder before it imports anything else.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def load(folder: Path, name: str) -> None:
    """Import a folder with an `__init__.py` as a package with this name."""
    spec = importlib.util.spec_from_file_location(
        name, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    assert spec is not None and spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules[name] = package
    spec.loader.exec_module(package)


def load_extension() -> None:
    """Import the Blender extension, the folder stlfr/, as `stlfr_extension`.

    In an installed extension, this file itself lies in that folder.
    """
    folder = HERE / "stlfr"
    load(folder if folder.is_dir() else HERE, "stlfr_extension")


def load_calibration() -> None:
    """Import the folder calibration/ as `stlfr_calibration`."""
    load(HERE / "calibration", "stlfr_calibration")
