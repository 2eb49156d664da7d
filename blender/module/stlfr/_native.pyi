"""The compiled module. The package `stlfr` exports all of it except `run_command`."""

from pathlib import Path

def run_command(program: Path, arguments: list[str]) -> int:
    """Run a command line, and return its exit code. `program` is the path of the program `stlfr`."""
