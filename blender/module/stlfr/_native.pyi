"""The compiled module. The package `stlfr` has its interface; the command line is here alone."""

from pathlib import Path

def run_command(program: Path, arguments: list[str], *, lines: bool = False) -> int:
    """Run the command line, and give its exit code; `program` is the path that starts it.

    With `lines`, progress goes to standard output, one JSON object `done`, `total`, `what` a line.
    """
