"""Write the animated camera of a .blend file's scene as a camera path for `stlfr render --path`.

Run as `python -I blender/path.py SCENE.blend PATH.json`. The settings under Light Field in Blender's render tab map a
frame of the scene to a time of the capture. If they were never set, the scene starts at the capture's time 0. An error
is one sentence on stderr, with exit code 2.
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
    """Run the command; print an error as one sentence on stderr. Returns the exit code."""
    if len(sys.argv) != 3:
        print("path.py takes SCENE.blend and PATH.json", file=sys.stderr)
        return 2
    blend = Path(sys.argv[1])
    try:
        # The extension's settings map frames to times.
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
