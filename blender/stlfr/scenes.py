"""Find a scene, build it or open a .blend, and say where the rig stands and how its time runs."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .camera import COLMAP_FROM_BLENDER_AXES, Array
from .errors import BadInputError

if TYPE_CHECKING:
    from types import ModuleType

SCENES_FOLDER = Path(__file__).resolve().parent.parent / "scenes"
HELPERS = ("__init__", "backdrop", "kit", "paint")
"""What all scenes are built with; the other modules of that folder are the scenes."""
IMPORTED = re.compile(r"^from \.(\w+) import", re.MULTILINE)
"""One scene's use of another's bodies."""
PACKAGE = "stlfr_scenes"
"""The name that the scenes folder is imported under."""

RIG_OBJECT = "rig"
"""The object that says where the rig stands; without one, the scene's active camera does."""

LEAD = "stlfr_lead_s"
"""A scene's property: by how many seconds filming begins before the scene's first frame. The extension sets it in the
copy that is filmed, so that every camera has a frame before the scene's first."""


def names() -> list[str]:
    """The scenes there are."""
    return sorted(
        file.stem for file in SCENES_FOLDER.glob("*.py") if file.stem not in HELPERS
    )


def sources(name: str) -> list[Path]:
    """The files that decide what a scene looks like: the helpers, its own, and those that it imports from.

    The error for an unknown name lists the known ones.
    """
    if name not in names():
        raise BadInputError(
            f"--scene {name}: no such scene; there are: {', '.join(names())}"
        )
    files = [SCENES_FOLDER / f"{stem}.py" for stem in (*HELPERS, name)]
    for file in files:  # grows within
        for stem in IMPORTED.findall(file.read_text(encoding="utf-8")):
            if (imported := SCENES_FOLDER / f"{stem}.py") not in files:
                files.append(imported)
    return files


def load(name: str) -> ModuleType:
    """Import a scene module, which has `build()`."""
    sources(name)
    if PACKAGE not in sys.modules:
        spec = importlib.util.spec_from_file_location(
            PACKAGE,
            SCENES_FOLDER / "__init__.py",
            submodule_search_locations=[str(SCENES_FOLDER)],
        )
        assert spec is not None and spec.loader is not None
        package = importlib.util.module_from_spec(spec)
        sys.modules[PACKAGE] = package
        spec.loader.exec_module(package)
    return importlib.import_module(f"{PACKAGE}.{name}")


def open_scene(scene_name: str | None, blend_file: Path | None) -> Any:
    """Replace Blender's open file by a built scene or a .blend, and give its scene.

    Only for headless use: whatever was open is gone.
    """
    import bpy

    if scene_name is not None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        load(scene_name).build()
        return bpy.context.scene
    try:
        bpy.ops.wm.open_mainfile(
            filepath=str(blend_file), load_ui=False, use_scripts=False
        )
    except RuntimeError as error:
        raise BadInputError(
            f"{blend_file}: Blender can't open it ({' '.join(str(error).split())})"
        ) from None
    scene = bpy.context.scene
    whole = scene.frame_start
    scene.frame_set(whole)
    cuts = [m for m in scene.timeline_markers if m.camera and m.frame <= whole]
    if cuts:
        scene.camera = max(cuts, key=lambda marker: marker.frame).camera
    problem = _what_is_missing(bpy)
    if problem:
        raise BadInputError(f"{blend_file}: {problem}")
    return scene


def _what_is_missing(bpy: Any) -> str | None:
    """What keeps the open file from looking as its author sees it."""
    for library in bpy.data.libraries:
        if not Path(bpy.path.abspath(library.filepath)).is_file():
            return f"the library that it links, {library.filepath}, isn't there"
    for image in bpy.data.images:
        file = Path(bpy.path.abspath(image.filepath, library=image.library))
        wanted = image.source == "FILE" and image.users and not image.packed_file
        if wanted and not file.is_file():
            return (
                f"its image {image.name} isn't at {image.filepath}; mend the path, "
                "or pack the image into the file"
            )
    if bpy.app.autoexec_fail:
        return (
            f"it runs Python ({bpy.app.autoexec_fail_message}), which filming doesn't; "
            "bake such drivers to keyframes"
        )
    return None


def frame_at(scene: Any, world_time_s: float) -> tuple[int, float]:
    """The Blender frame and sub-frame of a world time: 0 s is the scene's first frame, or its `LEAD` before it."""
    seconds = world_time_s - scene.get(LEAD, 0.0)
    frame = scene.frame_start + seconds * scene.render.fps / scene.render.fps_base
    whole = int(frame // 1)
    return whole, frame - whole


def world_from_rig(scene: Any) -> Array:
    """Where the rig stands at the scene's first frame: a 4x4 matrix from the rig's COLMAP axes to the world, in metres.

    The object `rig`, else the active camera, read as a camera: it looks along its -Z, +Y is up.
    """
    import numpy as np

    stand = scene.objects.get(RIG_OBJECT) or scene.camera
    if stand is None:
        raise BadInputError(
            f"scene {scene.name} doesn't say where the rig stands: it has neither an object named "
            f'"{RIG_OBJECT}" nor an active camera'
        )
    scene.frame_set(scene.frame_start)
    matrix = np.array(stand.matrix_world, dtype=np.float64)
    matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
    matrix[:3, :3] = matrix[:3, :3] @ COLMAP_FROM_BLENDER_AXES
    return matrix
