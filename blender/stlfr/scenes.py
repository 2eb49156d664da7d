"""Open the scene to film, built in or from a .blend file; its rig's pose, and its frames' times."""

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
"""The modules of the scenes folder that all scenes may use; every other module of that folder is a scene."""
IMPORTED = re.compile(r"^from \.(\w+) import", re.MULTILINE)
"""A line of a scene's source that imports another module of the scenes folder."""
PACKAGE = "stlfr_scenes"
"""The package name under which the scenes folder is imported."""

RIG_OBJECT = "rig"
"""Name of the object whose pose is the rig's pose. Without such an object, the active camera's pose is used."""

LEAD = "stlfr_lead_s"
"""Name of a scene's custom property: by how many seconds filming begins before the scene's first frame. The extension
sets it in the copy that is filmed, so that every camera has a frame before the scene's first frame."""


def names() -> list[str]:
    """The names of the built-in scenes, sorted."""
    return sorted(
        file.stem for file in SCENES_FOLDER.glob("*.py") if file.stem not in HELPERS
    )


def sources(name: str) -> list[Path]:
    """The source files of a built-in scene: the helper modules, its own module, and the scenes that it imports.

    Raises `BadInputError` for an unknown name; the message lists the known names.
    """
    if name not in names():
        raise BadInputError(
            f"--scene {name}: no such scene; there are: {', '.join(names())}"
        )
    files = [SCENES_FOLDER / f"{stem}.py" for stem in (*HELPERS, name)]
    for file in files:  # the loop appends to the list
        for stem in IMPORTED.findall(file.read_text(encoding="utf-8")):
            if (imported := SCENES_FOLDER / f"{stem}.py") not in files:
                files.append(imported)
    return files


def load(name: str) -> ModuleType:
    """Import the module of a built-in scene. Its function `build()` builds the scene."""
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
    """Replace Blender's open file by a built-in scene or by a .blend file, and return its scene.

    Only for headless use: unsaved changes are lost. Raises `BadInputError` if the file can't be opened or is
    incomplete.
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
    """Why the open file would not look as its author sees it, such as a missing image; None if nothing is missing."""
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
    """The Blender frame and sub-frame at a world time. World time 0 is the first frame minus the time `LEAD`."""
    seconds = world_time_s - scene.get(LEAD, 0.0)
    frame = scene.frame_start + seconds * scene.render.fps / scene.render.fps_base
    whole = int(frame // 1)
    return whole, frame - whole


def world_from_rig(scene: Any) -> Array:
    """The rig's pose at the scene's first frame: a 4x4 matrix from the rig's COLMAP axes to the world, in metres.

    It is the pose of the object `rig`, or else of the active camera. Either looks along its -Z axis, with +Y up.
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
