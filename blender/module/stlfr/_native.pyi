"""The compiled module. The package `stlfr` exports all of it except `run_command`."""

from pathlib import Path

def run_command(program: Path, arguments: list[str], *, lines: bool = False) -> int:
    """Run a command line, and return its exit code. `program` is the path of the program `stlfr`.

    With `lines`, progress goes to standard output, one JSON object `done`, `total`, `what` a line.
    """
