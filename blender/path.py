"""Write the animated scene camera of a .blend as a path of `stlfr render`.

Run as `python -I blender/path.py SCENE.blend PATH.json`. The time that a frame shows is that of the render tab under
Light Field; where it was never set, the scene's first second is the capture's. An error is one sentence on stderr, with
exit code 2 for bad input and 1 for a failure.
"""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
own_packages: Any = importlib.import_module("own_packages")
sys.path.pop(0)
own_packages.load_extension()
camera_path = importlib.import_module("stlfr_extension.camera_path")
errors = importlib.import_module("stlfr_extension.errors")
properties = importlib.import_module("stlfr_extension.properties")
scenes = importlib.import_module("stlfr_extension.scenes")


def main() -> int:
    """Run, and say what went wrong in one sentence."""
    if len(sys.argv) != 3:
        print("path.py takes SCENE.blend and PATH.json", file=sys.stderr)
        return 2
    blend = Path(sys.argv[1])
    try:
        # The time of a frame is among the extension's settings.
        properties.register()
        found = camera_path.path(scenes.open_scene(None, blend))
        Path(sys.argv[2]).write_text(json.dumps(found), encoding="utf-8")
    except errors.BadInputError as error:
        sentence = str(error)
        named = sentence if str(blend) in sentence else f"{blend}: {sentence}"
        print(named, file=sys.stderr)
        return 2
    except OSError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
