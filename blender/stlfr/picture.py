"""Run the command `stlfr render` as a child process: `python -I picture.py FOLDER ARGUMENT…`.

FOLDER contains the module `stlfr`. The arguments are those of the command, which writes the file.
"""

from __future__ import annotations

import sys
from pathlib import Path


def main(module_folder: str, *arguments: str) -> int:
    """Run `stlfr render` with these arguments, and return its exit code. Progress is printed as JSON lines."""
    sys.path.insert(0, module_folder)
    from stlfr._native import run_command

    return run_command(Path("stlfr"), ["render", *arguments], lines=True)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
