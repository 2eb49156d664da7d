"""Check a capture's calibration against pycolmap and Blender, which are independent implementations.

Run as `python -I blender/check.py CAPTURE`. The package `calibration` makes two checks:

- Model: do Blender, pycolmap and the `stlfr` module project the same points to the same pixels?
- Images: how far are the capture's poses from those that pycolmap reconstructs from the images (SIFT, exhaustive
  matching, incremental mapping, intrinsics as given)?

Stdout carries one JSON object. Stderr carries a table, with the verdict in its last line: the calibration is right, it
is off, the images don't suffice for a verdict, or the program itself is inconsistent. Exit code 0 if the calibration is
right, 1 if not, 2 for bad input. The result is deterministic.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from pathlib import Path
from typing import Any, NoReturn

HERE = Path(__file__).resolve()

sys.path.insert(0, str(HERE.parent))
own_packages: Any = importlib.import_module("own_packages")
sys.path.pop(0)
own_packages.load_extension()
own_packages.load_calibration()
CheckError: Any = importlib.import_module("stlfr_calibration.capture").CheckError


class Parser(argparse.ArgumentParser):
    """A parser that raises `CheckError` for wrong arguments, instead of printing the usage and exiting."""

    def error(self, message: str) -> NoReturn:
        raise CheckError(message, 2)


def run(arguments: list[str]) -> int:
    """Run the check, print its result, and return the exit code: 0 if the calibration is right, otherwise 1."""
    parser = Parser(
        prog="check.py", description="Check a capture's calibration against pycolmap."
    )
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help="capture folder")
    options = parser.parse_args(arguments)
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    try:
        stlfr = importlib.import_module("stlfr")
    except ImportError as error:
        raise CheckError(
            f"the stlfr module isn't in this Python environment ({error})", 1
        ) from None
    folder = options.capture.resolve()
    if not folder.is_dir():
        raise CheckError(f"{options.capture}: no such folder", 2)
    report = importlib.import_module("stlfr_calibration.report")
    conversion = importlib.import_module("stlfr_extension.described")
    try:
        capture = stlfr.open(str(folder))
        result = report.check(folder, capture, stlfr.project, pycolmap, conversion)
    except (ValueError, OSError) as error:
        raise CheckError(str(error), 2) from None
    print(report.table(result), file=sys.stderr)
    print(json.dumps(result, indent=1))
    return 0 if result["ok"] else 1


def main() -> int:
    """Run the command; print an error as one sentence on stderr. Returns the exit code."""
    try:
        return run(sys.argv[1:])
    except CheckError as error:
        print(error, file=sys.stderr)
        return int(error.exit_code)


if __name__ == "__main__":
    sys.exit(main())
