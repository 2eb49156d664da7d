"""Compare a capture with its truth, in a process of its own: `python -I compare.py CAPTURE FOLDER OPTIONS`.

FOLDER holds the module `stlfr`; OPTIONS are a render's, as JSON. The comparison lies in the capture then, as
after `stlfr compare`.
"""

from __future__ import annotations

import json
import sys


def main(capture: str, module_folder: str, options: str) -> int:
    """Print progress and the files as JSON lines; an error is one sentence on stderr."""
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
