"""Helpers of `extension_steps`: the extension's modules, a scene, pictures, and a fake of Blender's `UILayout`."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy

MODULE = "bl_ext.user_default.stlfr"


def part(name: str) -> Any:
    """A module of the installed extension."""
    return importlib.import_module(f"{MODULE}.{name}")


def enable() -> bool:
    """Enable the extension as Blender's preferences do. Returns whether it is enabled then."""
    addon_utils = importlib.import_module("addon_utils")
    return addon_utils.enable(MODULE, default_set=True) is not None


def refused(operator: Any, **properties: Any) -> str:
    """Call an operator that must fail; returns its error message."""
    try:
        operator(**properties)
    except RuntimeError as error:
        return str(error).strip()
    raise AssertionError(f"{operator} isn't refused")


def plain(scene: Any) -> None:
    """Set a scene to save rendered pictures unchanged, as PNG with alpha."""
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    scene.render.dither_intensity = 0.0
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.resolution_percentage = 100


def moving_scene() -> Any:
    """A scene with a textured board that slides sideways, 1.5 m from the camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert enable()
    scene = bpy.context.scene
    scene.render.fps = 24
    bpy.ops.mesh.primitive_plane_add(
        size=3.0, location=(0, 1.5, 0), rotation=(math.pi / 2, 0, 0)
    )
    board = bpy.context.object
    material = bpy.data.materials.new("board")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    texture, light, output = (
        nodes.new(f"ShaderNode{kind}")
        for kind in ("TexVoronoi", "Emission", "OutputMaterial")
    )
    texture.inputs["Scale"].default_value = 18.0
    links.new(texture.outputs["Color"], light.inputs["Color"])
    links.new(light.outputs["Emission"], output.inputs["Surface"])
    board.data.materials.append(material)
    for frame, x in ((1, 0.0), (25, 1.0)):
        board.location.x = x
        board.keyframe_insert("location", index=0, frame=frame)
    scene.camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(scene.camera)
    scene.camera.rotation_euler = (math.pi / 2, 0, 0)
    return scene


def create_rig() -> None:
    """Create a rig of three cameras with small images by the extension's operator."""
    bpy.ops.stlfr.rig_create(
        rig_name="three",
        columns=3,
        width_px=64,
        height_px=48,
        lens_mm=36.0,
        jitter_s=0.0005,
    )


def described(scene: Any) -> list[Any]:
    """Properties of a scene and its file that filming must not change."""
    render = scene.render
    return [
        sorted(o.name for o in bpy.data.objects),
        render.engine,
        render.resolution_x,
        scene.frame_current,
        scene.camera.name,
        bpy.data.filepath,
    ]


def middle_s(capture: str) -> float:
    """A time between two frames of the reference camera, in the middle of the recording."""
    opened = importlib.import_module("stlfr").open(capture)
    times_s = opened.times(opened.reference)
    half = len(times_s) // 2
    return float(0.6 * times_s[half - 1] + 0.4 * times_s[half])


def place(scene: Any, filmed: dict[str, Any]) -> None:
    """Give the scene's camera the pose, lens and image size of a camera of the capture."""
    camera = part("camera")
    pinhole = camera.Pinhole(filmed["width"], filmed["height"], *filmed["params"])
    lens = camera.lens_from_pinhole(pinhole)
    transform = filmed["cam_from_world"]
    pose = camera.RigidTransform(
        tuple(transform["rotation_wxyz"]), tuple(transform["translation"])
    )
    data = scene.camera.data
    data.sensor_fit, data.lens, data.sensor_width = "HORIZONTAL", lens.lens_mm, 36.0
    data.shift_x, data.shift_y = lens.shift_x, lens.shift_y
    scene.render.resolution_x, scene.render.resolution_y = lens.width_px, lens.height_px
    scene.camera.matrix_world = importlib.import_module("mathutils").Matrix(
        camera.blender_matrix(pose).tolist()
    )


def picture(
    scene: Any, work: Path, time_s: float, name: str = "picture"
) -> dict[str, Any]:
    """Render the scene by the engine (as F12 does) at a time of the capture.

    Returns the PNG's path, and the input with which `stlfr render` must give the same picture.
    """
    scene.render.engine = "STLFR"
    if name == "picture":
        plain(scene)
        scene.render.resolution_x, scene.render.resolution_y = 64, 48
        scene.camera.data.lens, scene.camera.location.x = 36.0, 0.01
        scene.stlfr.preset = "none"
        scene.stlfr.proxy, scene.stlfr.use_plane_depth = "plane", True
        scene.stlfr.plane_depth_m = 1.5
    settings, view = scene.stlfr, part("view")
    frame = scene.frame_start + (time_s - settings.time_offset_s) * scene.render.fps
    scene.frame_set(int(frame // 1), subframe=frame % 1)
    scene.render.filepath = str(work / f"{name}.png")
    bpy.ops.render.render(write_still=True)
    request = view.request(scene, scene.camera, Path(settings.capture))
    return {
        "file": scene.render.filepath,
        "wanted_s": time_s,
        "time_s": request.time_s,
        "camera": request.camera,
        "options": request.options,
    }


def must_be_icon(name: str) -> None:
    """Assert that Blender has an icon with this name."""
    icons = bpy.types.UILayout.bl_rna.functions["prop"].parameters["icon"].enum_items
    assert name in icons.keys(), name  # noqa: SIM118 - a collection of Blender's


class Layout:
    """A fake of Blender's `UILayout` for tests without a window, which records all drawn texts.

    It fails if a panel draws a property, an operator or an icon that doesn't exist.
    """

    def __init__(self) -> None:
        self.drawn: list[str] = []
        self.enabled = True
        self.use_property_split = False
        self.use_property_decorate = True
        self.scale_y = 1.0

    def row(self, align: bool = False) -> Layout:
        return self

    column = row

    def split(self, factor: float = 0.0) -> Layout:
        assert 0 <= factor <= 1
        return self

    def label(self, text: str = "", icon: str = "NONE") -> None:
        must_be_icon(icon)
        self.drawn.append(text)

    def prop(self, data: Any, name: str, text: str = "") -> None:
        self.drawn.append(data.bl_rna.properties[name].name)

    def operator(self, name: str, text: str = "", icon: str = "NONE") -> Any:
        kind = getattr(bpy.ops.stlfr, name.removeprefix("stlfr.")).get_rna_type()
        must_be_icon(icon)
        self.drawn.append(text or kind.name)
        return SimpleNamespace()

    def progress(self, factor: float, text: str) -> None:
        assert 0 <= factor <= 1
        self.drawn.append(text)

    def template_list(
        self, kind: str, _: str, data: Any, name: str, index_data: Any, index: str
    ) -> None:
        assert isinstance(getattr(index_data, index), int)
        for item in getattr(data, name):
            line = Layout()
            one = getattr(bpy.types, kind)
            one.draw_item(None, None, line, data, item, None, None, "")
            self.drawn.append(" ".join(line.drawn))


def drawn() -> list[str]:
    """All texts that the extension's panels currently draw, each after its panel's label."""
    scene = bpy.context.scene
    found: list[str] = []
    camera = next(
        (o for o in scene.objects if o.type == "CAMERA" and o.stlfr.role == "CAMERA"),
        None,
    )
    context = SimpleNamespace(
        scene=scene,
        object=camera,
        engine="STLFR",
        preferences=bpy.context.preferences,
        region=SimpleNamespace(width=280),
    )
    for kind in part("panels").CLASSES:
        if not issubclass(kind, bpy.types.Panel):
            continue
        layout = Layout()
        fake = SimpleNamespace(layout=layout)
        if not hasattr(kind, "poll") or kind.poll(context):
            kind.draw(fake, context)
            if hasattr(kind, "draw_header"):
                kind.draw_header(fake, context)
        found += [f"{kind.bl_label}: {text}" for text in layout.drawn]
    return found
