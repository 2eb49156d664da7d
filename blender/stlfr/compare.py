"""Compare a capture with its ground truth, as a child process: `python -I compare.py CAPTURE FOLDER OPTIONS`.

FOLDER contains the module `stlfr`; OPTIONS are render options as JSON. The result is written into the capture's folder,
as by `stlfr compare`.
"""

from __future__ import annotations

import json
import sys


def main(capture: str, module_folder: str, options: str) -> int:
    """Run the comparison; print progress and the written files as JSON lines. An error is one sentence on stderr."""
    sys.path.insert(0, module_folder)
    import stlfr

    try:
        found = stlfr.compare(capture, options=json.loads(options), lines=True)
    except (ValueError, FileNotFoundError) as error:
        print(error, file=sys.stderr)
        return 2
    print(json.dumps({"result": found}))
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
