"""Lay out the result of `stlfr compare` in Blender's video sequencer: reads review.json, writes review.blend.

Run as `python -I blender/review.py REVIEW/review.json`. Each reel of review.json (the video, the new views, the filming
cameras) becomes a scene, laid out by `stlfr/reels.py`. An error is one sentence on stderr, with exit code 2 for bad
input and 1 for a failure.
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
own_packages: Any = importlib.import_module("own_packages")
sys.path.pop(0)
own_packages.load_extension()
errors = importlib.import_module("stlfr_extension.errors")
reels = importlib.import_module("stlfr_extension.reels")


def build(layout_file: Path) -> Path:
    """Write review.blend beside `layout_file`, which is review.json. Returns the path of review.blend."""
    reels.read_reels(layout_file)
    bpy.ops.wm.read_homefile(app_template="Video_Editing", use_factory_startup=True)
    others = list(bpy.data.scenes)
    first = reels.add_all(layout_file)[0]
    for window in bpy.context.window_manager.windows:
        window.scene = first
    for workspace in bpy.data.workspaces:
        workspace.sequencer_scene = first
    for scene in others:
        bpy.data.scenes.remove(scene)
    target = layout_file.resolve().parent / "review.blend"
    # The temporary name contains the process id, because another process may write the same file.
    partial = target.with_name(f".{target.name}.{os.getpid()}.partial.blend")
    bpy.context.preferences.filepaths.save_version = 0
    try:
        bpy.ops.wm.save_as_mainfile(
            filepath=str(partial), compress=True, relative_remap=False
        )
        bpy.ops.file.make_paths_relative()
        bpy.ops.wm.save_as_mainfile(
            filepath=str(partial), compress=True, relative_remap=False
        )
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
    return target


def main() -> int:
    """Run the command; print an error as one sentence on stderr. Returns the exit code."""
    if len(sys.argv) != 2:
        print("review.py takes one argument, REVIEW/review.json", file=sys.stderr)
        return 2
    try:
        build(Path(sys.argv[1]))
    except (errors.BadInputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    except RuntimeError as error:
        print(f"review.blend: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
