"""Conversion between a rig file and Blender's camera objects.

The cameras and views are children of the empty object `rig`, whose axes are those of a Blender camera: the rig looks
along its -Z axis, with +Y up. Fields of the rig file without a counterpart in Blender are stored with the objects as
JSON, so that saving the rig loses nothing. A number that still equals the file's number in Blender's single precision
is written as in the file.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

from . import camera as cameras
from . import folder, native, reading, scenes
from .errors import BadInputError
from .native import Content

COLLECTION = "stlfr rig"

EMPTY_SIZE_M, CAMERA_SIZE_M = 0.4, 0.12
"""Sizes at which the rig and its cameras are drawn. If larger, cameras 6 cm apart hide each other; if smaller, the rig
is hard to find in a scene of ten metres."""

FORMAT, VERSION = "stlfr-rig", 1
"""The fields `format` and `version` of a rig file."""

POSE_TOLERANCE = 2e-6
"""Maximum difference of matrices, relative to their size, at which a pose counts as unchanged; Blender has single
precision. If larger, small changes are lost on saving; if smaller, rounding errors count as changes."""

SHOWN = {
    "id",
    "width",
    "height",
    "lens_mm",
    "sensor_width_mm",
    "shift_x",
    "shift_y",
    "cam_from_rig",
    "rate_hz",
    "delay_s",
    "jitter_s",
    "jitter_stamped",
    "color",
}
"""Fields of a camera or view that are properties of its Blender object. All other fields are stored as one JSON
text."""

SHOWN_OF_RIG = {"format", "version", "name", "reference", "seed", "cameras", "views"}


def read(path: Path) -> Content:
    """The content of a rig file, which is checked. Raises `BadInputError` if it is invalid."""
    native.read_rig(path)
    content: Content = json.loads(reading.read_text(path))
    return content


def write(content: Content, path: Path) -> None:
    """Write a rig file after checking its content. Raises `BadInputError` if the content is invalid."""
    try:
        native.check_rig(content)
    except BadInputError as error:
        raise BadInputError(f"{path}: {error}") from None
    folder.write_json(path, content)


def build(scene: Any, content: Content) -> Any:
    """Create the objects of a rig, replacing the scene's previous rig. Returns the empty object `rig`.

    An existing empty `rig` keeps its pose. A new one gets the pose of the scene's camera, or else stands at the 3D
    cursor.
    """
    empty = _empty(scene)
    for old in members(scene):
        data = old.data
        bpy.data.objects.remove(old)
        if data is not None and data.users == 0:
            bpy.data.cameras.remove(data)
    settings = scene.stlfr
    settings.rig_name, settings.rig_seed = content["name"], content["seed"]
    settings.rig_reference = content["reference"]
    settings.rig_more = _more(content, SHOWN_OF_RIG)
    for role, entries in (
        ("CAMERA", content["cameras"]),
        ("VIEW", content.get("views", [])),
    ):
        for order, entry in enumerate(entries):
            _add(empty, role, order, entry)
    return empty


def members(scene: Any, role: str | None = None) -> list[Any]:
    """The cameras and views of the scene's rig, in the rig's order; with `role` (`CAMERA` or `VIEW`), only these."""
    found = [
        o
        for o in scene.objects
        if o.type == "CAMERA"
        and o.stlfr.role in ((role,) if role else ("CAMERA", "VIEW"))
    ]
    return sorted(found, key=lambda o: (o.stlfr.role, o.stlfr.order, o.name))


def all_of(scene: Any) -> list[Any]:
    """The empty object `rig` if it exists, followed by the rig's cameras and views."""
    empty = scene.objects.get(scenes.RIG_OBJECT)
    return ([] if empty is None else [empty]) + members(scene)


def select(view_layer: Any, objects: list[Any]) -> None:
    """Select only these objects, and make the first one active."""
    view_layer.update()  # it may still list removed objects
    for other in view_layer.objects:
        other.select_set(False)
    seen = [o for o in objects if o.name in view_layer.objects]
    for one in seen:
        one.select_set(True)
    if seen:
        view_layer.objects.active = seen[0]


def describe(scene: Any) -> Content:
    """The content of a rig file for the scene's rig, with the current poses and settings of its objects.

    Raises `BadInputError` if the scene has no complete rig.
    """
    shooting = members(scene, "CAMERA")
    for one in members(scene):
        if one.data.type != "PERSP":
            raise BadInputError(
                f"{one.name} of the rig isn't a perspective camera, the only kind that can film"
            )
    if not shooting:
        raise BadInputError(
            f"scene {scene.name} has no rig: create or load one in the sidebar, under STLFR"
        )
    empty = scene.objects.get(scenes.RIG_OBJECT)
    if empty is None:
        raise BadInputError(
            f'scene {scene.name} has cameras of a rig but no object named "{scenes.RIG_OBJECT}" that says where it stands'
        )
    bpy.context.view_layer.update()
    settings = scene.stlfr
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": settings.rig_name,
        "reference": settings.rig_reference,
        "seed": settings.rig_seed,
        **_fields_of(settings.rig_more, "the rig's other fields"),
        "cameras": [_entry(empty, o) for o in shooting],
        "views": [_entry(empty, o) for o in members(scene, "VIEW")],
    }


def _empty(scene: Any) -> Any:
    """The empty object `rig`, the parent of the rig's cameras; created if it doesn't exist.

    Raises `BadInputError` if another object has this name.
    """
    found = scene.objects.get(scenes.RIG_OBJECT)
    if found is not None:
        if found.stlfr.role != "RIG":
            raise BadInputError(
                f'an object of your own is named "{scenes.RIG_OBJECT}", the name that says where the rig stands; '
                "give it another name"
            )
        return found
    if scenes.RIG_OBJECT in bpy.data.objects:
        raise BadInputError(
            f'another scene of this file has the object "{scenes.RIG_OBJECT}": one rig a file'
        )
    empty = bpy.data.objects.new(scenes.RIG_OBJECT, None)
    empty.empty_display_type, empty.empty_display_size = "ARROWS", EMPTY_SIZE_M
    empty.stlfr.role = "RIG"
    collection = bpy.data.collections.new(COLLECTION)
    scene.collection.children.link(collection)
    collection.objects.link(empty)
    bpy.context.view_layer.update()
    if scene.camera is not None:
        location, rotation, _ = scene.camera.matrix_world.decompose()
        empty.matrix_world = mathutils.Matrix.LocRotScale(location, rotation, None)
    else:
        empty.location = scene.cursor.location
        empty.rotation_euler = (np.pi / 2, 0.0, 0.0)  # level, looking along +Y
    return empty


def _add(empty: Any, role: str, order: int, entry: Content) -> Any:
    """Add the object of one camera or view, with all settings of its entry in the rig file."""
    lens = bpy.data.cameras.new(entry["id"])
    lens.sensor_fit = "AUTO"
    lens.lens, lens.sensor_width = entry["lens_mm"], entry["sensor_width_mm"]
    lens.shift_x, lens.shift_y = entry.get("shift_x", 0.0), entry.get("shift_y", 0.0)
    lens.clip_start, lens.display_size = 0.01, CAMERA_SIZE_M
    camera_object = bpy.data.objects.new(entry["id"], lens)
    for collection in empty.users_collection:
        collection.objects.link(camera_object)
    camera_object.parent = empty
    camera_object.rotation_mode = "QUATERNION"
    camera_object.matrix_local = mathutils.Matrix(_local(entry).tolist())
    own = camera_object.stlfr
    own.role, own.order, own.camera_id = role, order, entry["id"]
    own.width_px, own.height_px = entry["width"], entry["height"]
    if role == "CAMERA":
        own.rate_hz, own.delay_s = entry["rate_hz"], entry["delay_s"]
        own.jitter_s = entry.get("jitter_s", 0.0)
        own.jitter_stamped = entry.get("jitter_stamped", True)
        own.color = entry.get("color", "rgb")
    own.more = _more(entry, SHOWN)
    own.entry = json.dumps(entry)
    return camera_object


def _local(entry: Content) -> cameras.Array:
    """The 4x4 matrix of a camera relative to the empty `rig`, both with Blender's camera axes."""
    transform = entry["cam_from_rig"]
    rotation, translation = transform["rotation_wxyz"], transform["translation"]
    cam_from_rig = cameras.RigidTransform(tuple(rotation), tuple(translation))
    axes = np.diag([*np.diag(cameras.COLMAP_FROM_BLENDER_AXES), 1.0])
    matrix: cameras.Array = axes @ np.linalg.inv(cam_from_rig.matrix()) @ axes
    return matrix


def _entry(empty: Any, camera_object: Any) -> Content:
    """The rig file's entry for a camera or view object."""
    own, lens = camera_object.stlfr, camera_object.data
    came: Content = json.loads(own.entry) if own.entry else {}
    entry: Content = {
        "id": own.camera_id or camera_object.name,
        "width": own.width_px,
        "height": own.height_px,
        "lens_mm": _as_it_came(lens.lens, came.get("lens_mm")),
        "sensor_width_mm": _as_it_came(lens.sensor_width, came.get("sensor_width_mm")),
        "cam_from_rig": _pose(empty, camera_object, came.get("cam_from_rig")),
    }
    for name, value in (("shift_x", lens.shift_x), ("shift_y", lens.shift_y)):
        if name in came or value != 0.0:
            entry[name] = _as_it_came(value, came.get(name))
    if own.role == "CAMERA":
        for name in ("rate_hz", "delay_s"):
            entry[name] = _as_it_came(getattr(own, name), came.get(name))
        if "jitter_s" in came or own.jitter_s != 0.0:
            entry["jitter_s"] = _as_it_came(own.jitter_s, came.get("jitter_s"))
        if "jitter_stamped" in came or not own.jitter_stamped:
            entry["jitter_stamped"] = own.jitter_stamped
        if "color" in came or own.color != "rgb":
            entry["color"] = own.color
    return entry | _fields_of(own.more, f"{entry['id']}'s other fields")


def _pose(empty: Any, camera_object: Any, came: Content | None) -> Content:
    """The field `cam_from_rig` of a camera object. If its pose relative to the empty is unchanged, it is `came`."""
    axes = np.diag([*np.diag(cameras.COLMAP_FROM_BLENDER_AXES), 1.0])
    world_from_rig = _rigid(empty) @ axes
    world_from_cam = _rigid(camera_object) @ axes
    if came is not None:
        expected = axes @ _local({"cam_from_rig": came}) @ axes
        found = np.linalg.inv(world_from_rig) @ world_from_cam
        scale = (
            1.0 + np.abs(world_from_rig[:3, 3]).max() + np.abs(expected[:3, 3]).max()
        )
        if np.abs(found - expected).max() < POSE_TOLERANCE * scale:
            return came
    # The camera's `matrix_world`, relative to the rig's COLMAP axes instead of the world's axes.
    beside = np.linalg.inv(world_from_rig) @ _rigid(camera_object)
    return cameras.cam_from_world_of_matrix(beside).to_json()


def _rigid(of: Any) -> cameras.Array:
    """The `matrix_world` (4x4) of an object, without its scale."""
    matrix = np.array(of.matrix_world, dtype=np.float64)
    matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
    return matrix


def shortest(value: float) -> float:
    """The shortest decimal number with the same value in Blender's single precision, as the user typed it."""
    return float(str(np.float32(value)))


def _as_it_came(value: float, came: Any) -> float:
    """The rig file's number `came` if it equals `value` in single precision, else the shortest number for `value`."""
    if isinstance(came, (int, float)) and np.float32(came) == np.float32(value):
        return came
    return shortest(value)


def _more(entry: Content, shown: set[str]) -> str:
    rest = {name: value for name, value in entry.items() if name not in shown}
    return json.dumps(rest) if rest else ""


def _fields_of(text: str, what: str) -> Content:
    try:
        content = json.loads(text) if text.strip() else {}
    except ValueError as error:
        raise BadInputError(f"{what} aren't valid JSON ({error})") from None
    if not isinstance(content, dict):
        raise BadInputError(f'{what} must be a JSON object like {{"noise": 0.01}}')
    return content
