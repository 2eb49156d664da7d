"""Run `stlfr render` in a process of its own: `python -I picture.py FOLDER ARGUMENT…`.

FOLDER holds the module `stlfr`. The arguments are those of the command, so that a file has its bytes.
"""

from __future__ import annotations

import sys
from pathlib import Path


def main(module_folder: str, *arguments: str) -> int:
    """Print progress as JSON lines; an error is one sentence on stderr."""
    sys.path.insert(0, module_folder)
    from stlfr._native import run_command

    return run_command(Path("stlfr"), ["render", *arguments], lines=True)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
