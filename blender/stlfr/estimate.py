"""Estimate a capture's temporal offsets, as a child process: `python -I estimate.py CAPTURE FOLDER`.

FOLDER contains the module `stlfr`. The offsets are saved in the capture's folder, as by `stlfr offsets`.
"""

from __future__ import annotations

import json
import sys


def main(capture: str, module_folder: str) -> int:
    """Estimate the offsets, and print them as one JSON line. An error is one sentence on stderr."""
    sys.path.insert(0, module_folder)
    import stlfr

    try:
        print(json.dumps({"result": stlfr.open(capture).offsets()}))
    except (ValueError, FileNotFoundError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
