"""The command `stlfr` of an installed wheel: runs the command line that is part of the compiled module."""

import sys
from pathlib import Path

from ._native import run_command


def main() -> None:
    """Run the command line with the arguments of this process, and exit with its exit code."""
    sys.exit(run_command(Path(sys.argv[0]).absolute(), sys.argv[1:]))
