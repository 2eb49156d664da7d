"""The command `stlfr` of an installed wheel: the command line of the compiled module."""

import sys
from pathlib import Path

from ._native import run_command


def main() -> None:
    """Run the process's arguments, and end with the command's exit code."""
    sys.exit(run_command(Path(sys.argv[0]).absolute(), sys.argv[1:]))
