"""Check a capture's calibration against pycolmap and Blender, implementations that aren't ours.

Run as `python -I blender/check.py CAPTURE`. Two questions, answered by the package `calibration`:

- Model: do Blender, pycolmap and the `stlfr` module project the same points to the same pixels?
- Pixels: where does pycolmap place the cameras from the images alone (SIFT, exhaustive matching,
  incremental mapping, intrinsics as given), and how far is that from the capture's poses?

Stdout carries one JSON object, stderr a table with the verdict as its last line: right, off, that the images can't
tell, or that the program itself is inconsistent. Exit code 0 if it is right, 1 if not, 2 for bad input.
The same capture gives the same numbers each time.
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
    """Says what is wrong in one sentence, without the usage."""

    def error(self, message: str) -> NoReturn:
        raise CheckError(message, 2)


def run(arguments: list[str]) -> int:
    """The command."""
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
    """Run, and say what went wrong in one sentence."""
    try:
        return run(sys.argv[1:])
    except CheckError as error:
        print(error, file=sys.stderr)
        return int(error.exit_code)


if __name__ == "__main__":
    sys.exit(main())
