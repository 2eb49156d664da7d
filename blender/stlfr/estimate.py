"""Estimate a capture's offsets, in a process of its own: `python -I estimate.py CAPTURE FOLDER`.

FOLDER holds the module `stlfr`. The offsets are saved in the capture, as `stlfr offsets` does.
"""

from __future__ import annotations

import json
import sys


def main(capture: str, module_folder: str) -> int:
    """Print the offsets as one JSON line; an error is one sentence on stderr."""
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
