"""What the extension keeps in a .blend: settings of a scene, and what makes an object part of a rig.

Blender keeps numbers in single precision: times a few seconds long are good to a microsecond.
"""

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

import stlfr

STAGES = stlfr.methods()


AUTO = ("auto", "Auto", "The cheapest method that the capture requires")

NO_PRESET = ("none", "None", "The methods below")


def _methods(stage: str, *more: tuple[str, str, str]) -> dict[str, Any]:
    """The methods that the module has, for an `EnumProperty`."""
    return {
        "items": [
            *more,
            *(
                (
                    method["name"],
                    method["name"].replace("-", " ").capitalize(),
                    method["help"],
                )
                for method in STAGES[stage]["methods"]
            ),
        ],
        "default": STAGES[stage]["default"],
    }


def _forget_offsets(settings: Any, _context: Any) -> None:
    """Another capture's clocks."""
    settings.offsets.clear()


class StlfrOffset(bpy.types.PropertyGroup):
    """The offset of one camera, as it was estimated."""

    camera_id: StringProperty(name="Camera")
    is_known: BoolProperty(name="Known")
    offset_s: FloatProperty(
        name="Offset",
        description="Seconds that this camera's clock reads less than the reference's",
        precision=6,
    )
    std_err_s: FloatProperty(name="Standard error", precision=6)
    reason: StringProperty(name="Reason", description="Why the offset is unknown")


class StlfrObject(bpy.types.PropertyGroup):
    """What makes an object part of a rig. Lens, sensor, shift and place are the camera object's own."""

    role: EnumProperty(
        name="Role",
        items=[
            ("NONE", "None", "Not part of a rig"),
            ("RIG", "Rig", "Says where the rig stands; it looks along its -Z"),
            ("CAMERA", "Camera", "Films, at its own times"),
            ("VIEW", "View", "A place that the truth is rendered from"),
        ],
    )
    order: IntProperty(name="Order", description="Place in the rig's list", min=0)
    camera_id: StringProperty(name="Id", description="Names its folder in the capture")
    width_px: IntProperty(name="Width", default=640, min=8, max=16384)
    height_px: IntProperty(name="Height", default=480, min=8, max=16384)
    rate_hz: FloatProperty(
        name="Rate",
        description="Frames a second",
        default=30.0,
        min=1e-3,
        max=1e5,
        precision=3,
    )
    delay_s: FloatProperty(
        name="Delay",
        description="Seconds after the scene's start at which the middle of the first exposure lies",
        precision=6,
        step=0.1,
    )
    jitter_s: FloatProperty(
        name="Jitter",
        description="Standard deviation of each frame's time, seconds",
        min=0.0,
        precision=6,
        step=0.1,
    )
    jitter_stamped: BoolProperty(
        name="Stamped",
        description="Whether the camera writes down its frames' true times",
        default=True,
    )
    color: EnumProperty(
        name="Colour",
        items=[("rgb", "RGB", "In colour"), ("gray", "Grey", "In shades of grey")],
    )
    more: StringProperty(
        name="More",
        description="The rig file's other fields of this camera, as JSON",
    )
    entry: StringProperty(
        name="Entry", description="As the rig file had it", options={"HIDDEN"}
    )


class StlfrScene(bpy.types.PropertyGroup):
    """Settings of a scene."""

    capture: StringProperty(
        name="Capture",
        description="Folder of the capture whose light field is rendered",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        update=_forget_offsets,
    )
    time_offset_s: FloatProperty(
        name="Time Offset",
        description="The capture's time at the scene's first frame, seconds on the reference camera's clock. "
        "After filming it is minus the reference camera's delay, so that the light field and Cycles show "
        "the same instant",
        precision=6,
        step=0.1,
    )
    speed: FloatProperty(
        name="Speed",
        description="Seconds of the capture in a second of the scene: below 1 is slow motion, 0 stands still",
        default=1.0,
        precision=3,
    )
    preset: EnumProperty(
        name="Preset",
        description="Named options of all stages: speed for accuracy",
        **{**_methods("preset", NO_PRESET), "default": NO_PRESET[0]},
    )
    sync: EnumProperty(
        name="Sync",
        description="How each camera's image at the instant is made",
        **_methods("sync", AUTO),
    )
    proxy: EnumProperty(
        name="Proxy",
        description="What stands for the scene's shape",
        **_methods("proxy", AUTO),
    )
    use_plane_depth: BoolProperty(
        name="Focus by Hand",
        description="Set the plane's depth; else it is fitted to what the cameras see",
    )
    plane_depth_m: FloatProperty(
        name="Plane Depth",
        description="Depth of the plane before the camera: what is in focus",
        default=2.0,
        min=1e-3,
        max=1e6,
        subtype="DISTANCE",
    )
    use_trail: BoolProperty(
        name="Trails", description="Overlay what moved before the instant"
    )
    trail_duration_s: FloatProperty(
        name="Duration",
        description="How far the trails reach back, seconds of the capture",
        default=0.1,
        min=0.0,
        max=1e6,
        precision=4,
    )
    trail_instants: IntProperty(
        name="Instants",
        description="Instants that are overlaid; each costs a view",
        default=16,
        min=1,
        max=10_000,
    )
    trail_mode: EnumProperty(name="Mode", **_methods("trail"))

    rig_name: StringProperty(name="Name", default="rig")
    rig_seed: IntProperty(
        name="Seed", description="Decides the jitter and the noise", min=0
    )
    rig_reference: StringProperty(
        name="Reference", description="The camera whose clock is everybody's time"
    )
    rig_more: StringProperty(
        name="More", description="The rig file's other fields, as JSON"
    )

    film_folder: StringProperty(
        name="Folder",
        description="The new capture's folder",
        default="//capture",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
    )
    film_frames: IntProperty(
        name="Frames", description="Frames a camera", default=9, min=1, max=100_000
    )
    film_samples: IntProperty(
        name="Samples", description="Samples a pixel", default=16, min=1, max=100_000
    )
    film_truth: BoolProperty(
        name="Truth",
        description="Also render what only a simulator knows, to compare with",
        default=True,
    )
    film_instants: IntProperty(
        name="Instants", description="Instants with truth", default=3, min=1, max=1000
    )
    film_workers: IntProperty(
        name="Processes",
        description="Filming processes; 0: one for every core",
        min=0,
        max=1000,
    )

    offsets: CollectionProperty(type=StlfrOffset)
    offset_index: IntProperty(name="Offset", options={"HIDDEN"})


register_classes, unregister_classes = bpy.utils.register_classes_factory(
    (StlfrOffset, StlfrObject, StlfrScene)
)


def register() -> None:
    """Make it known to Blender."""
    register_classes()
    bpy.types.Scene.stlfr = PointerProperty(type=StlfrScene)
    bpy.types.Object.stlfr = PointerProperty(type=StlfrObject)


def unregister() -> None:
    """Leave nothing behind."""
    del bpy.types.Object.stlfr, bpy.types.Scene.stlfr
    unregister_classes()
