"""Estimate or refine the cameras' calibration from the static parts of a recording.

Run as `python -I blender/calibrate.py new CAPTURE [--lens MODEL] [--focal PX] [--between CAMERA --and CAMERA --metres M]`,
or as `python -I blender/calibrate.py refine CAPTURE [--focal] [--principal-point]`. CAPTURE isn't changed. Stdout carries
progress, then one line of JSON: every camera's lens and pose with their standard errors. Exit code 0 for success, 1 if
the images don't determine the calibration, 2 for bad input. The result is deterministic.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
check: Any = importlib.import_module("check")
estimation: Any = importlib.import_module("stlfr_calibration.estimation")
capture_files: Any = importlib.import_module("stlfr_calibration.capture")
sys.path.pop(0)


def parser() -> argparse.ArgumentParser:
    """The parser of the command line: the subcommands `new` and `refine` with their options."""
    found: argparse.ArgumentParser = check.Parser(
        prog="calibrate.py", description="Find or refine a calibration."
    )
    ways = found.add_subparsers(dest="way", required=True)
    new = ways.add_parser("new", help="without a calibration")
    new.add_argument("--lens", default="SIMPLE_RADIAL", help="COLMAP's lens model")
    new.add_argument("--focal", type=float, help="focal length of all cameras, pixels")
    new.add_argument(
        "--between", metavar="CAMERA", help="one of two cameras whose distance is known"
    )
    new.add_argument("--and", metavar="CAMERA", dest="other", help="and the other")
    new.add_argument("--metres", type=float, help="how far they stand apart")
    refine = ways.add_parser("refine", help="a given calibration")
    refine.add_argument("--focal", action="store_true", help="focal lengths too")
    refine.add_argument(
        "--principal-point", action="store_true", help="refine principal points too"
    )
    for way in (new, refine):
        way.add_argument("capture", type=Path, metavar="CAPTURE", help="capture folder")
    return found


def progress(done: int, total: int, what: str) -> None:
    """Print one line of progress as JSON, for the program that started this script: `done` of `total` steps."""
    print(json.dumps({"done": done, "total": total, "what": what}), flush=True)


def request(options: argparse.Namespace, ids: list[str]) -> Any:
    """The request of the subcommand `new`: lens model, focal length and known distance, checked.

    `ids` are the ids of the capture's cameras. Raises `CheckError` if an option is invalid.
    """
    if options.focal is not None and not 0.0 < options.focal < 1e6:
        raise check.CheckError("--focal: must be positive", 2)
    distance = None
    if options.metres is not None:
        distance = options.between, options.other, options.metres
        for camera_id in distance[:2]:
            if camera_id not in ids:
                raise check.CheckError(f"there is no camera '{camera_id}'", 2)
        if options.between == options.other or not 0.0 < options.metres < 1e6:
            raise check.CheckError("--metres: needs two cameras, apart", 2)
    return estimation.Request(options.lens, options.focal, distance)


def run(arguments: list[str]) -> int:
    """Run the command with these arguments, print its result, and return the exit code 0."""
    options = parser().parse_args(arguments)
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    try:
        stlfr = importlib.import_module("stlfr")
    except ImportError as error:
        raise check.CheckError(
            f"the stlfr module isn't in this Python environment ({error})", 1
        ) from None
    folder = options.capture.resolve()
    if not folder.is_dir():
        raise check.CheckError(f"{options.capture}: no such folder", 2)
    try:
        capture = stlfr.open(str(folder))
        cameras = capture_files.read_json(folder / "capture.json")["cameras"]
    except (ValueError, OSError) as error:
        raise check.CheckError(str(error), 2) from None
    if options.way == "new":
        how = request(options, [camera["id"] for camera in cameras])
        result = estimation.calibrate(capture, cameras, how, progress, pycolmap)
    else:
        asked = {"focal": options.focal, "centre": options.principal_point}
        groups = tuple(group for group, is_asked in asked.items() if is_asked)
        result = estimation.refine(capture, cameras, groups, progress, pycolmap)
    print(json.dumps(result))
    return 0


def main() -> int:
    """Run the command; print an error as one sentence on stderr. Returns the exit code."""
    try:
        return run(sys.argv[1:])
    except check.CheckError as error:
        print(error, file=sys.stderr)
        return int(error.exit_code)


if __name__ == "__main__":
    sys.exit(main())
