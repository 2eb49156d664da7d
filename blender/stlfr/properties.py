"""Custom properties that the extension stores in a .blend file: settings of scenes and of a rig's objects.

Blender stores numbers in single precision: times of a few seconds have a precision of a microsecond.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
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

from . import spans, timing, viewport
from .errors import BadInputError
from .paths import absolute

STAGES = stlfr.methods()

DISPLAYS = stlfr.displays()

AUTO = ("auto", "Automatic", "The cheapest method that the capture requires")

NO_PRESET = ("none", "Custom", "The methods below")

FROM_BLEND = {"PATH_SUPPORTS_BLEND_RELATIVE"}
"""Options of a path property whose value may begin with `//`, which stands for the folder of the .blend file."""


def _methods(stage: str, *more: tuple[str, str, str]) -> dict[str, Any]:
    """The items and the default of an `EnumProperty` for the methods of a stage, as the module `stlfr` lists them.

    `more` are items that precede the methods.
    """
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


def _open_capture(settings: Any, _context: Any) -> None:
    """Called when another capture is chosen: clears the list of offsets, and sets the time offset."""
    settings.offsets.clear()
    with contextlib.suppress(BadInputError):  # the panel says so
        if settings.capture:
            _adopt(settings, absolute(settings.capture))
    viewport.redraw()


def _adopt(settings: Any, folder: Path) -> None:
    """Set the time offset for a newly chosen capture: the one with which it was filmed, if it was filmed in Blender.

    Otherwise, as soon as the capture has been read, the offset at which it begins at the start frame; unless the user
    has chosen another capture or offset by then.
    """
    if timing.adopt_filmed(settings, folder):
        return
    name = settings.id_data.name  # the scene itself may move in memory
    chosen = (settings.capture, settings.time_offset_s)

    def adopt() -> None:
        scene = bpy.data.scenes.get(name)
        if scene is None:
            return
        if (scene.stlfr.capture, scene.stlfr.time_offset_s) == chosen:
            timing.adopt_start(scene.stlfr, folder)

    spans.when_known(folder, adopt)


def _redraw(_settings: Any, _context: Any) -> None:
    """Called when a setting changes: redraws the viewports."""
    viewport.redraw()


class StlfrOffset(bpy.types.PropertyGroup):
    """The estimated temporal offset of one camera: an entry of the panel's list."""

    camera_id: StringProperty(name="Camera", description="Its name in the capture")
    is_known: BoolProperty(
        name="Known", description="Whether the offset could be estimated"
    )
    offset_s: FloatProperty(
        name="Offset",
        description="How much less this camera's clock reads than the reference's",
        precision=6,
        unit="TIME_ABSOLUTE",
    )
    std_err_s: FloatProperty(
        name="Standard Error",
        description="Of the offset",
        precision=6,
        unit="TIME_ABSOLUTE",
    )
    reason: StringProperty(name="Reason", description="Why the offset is unknown")


class StlfrObject(bpy.types.PropertyGroup):
    """Settings of an object that belongs to a rig. Lens, sensor, shift and pose are the Blender camera's own."""

    role: EnumProperty(
        name="Role",
        description="What the object is for the rig",
        items=[
            ("NONE", "None", "Not part of a rig"),
            ("RIG", "Rig", "Says where the rig stands; it looks along its -Z"),
            ("CAMERA", "Camera", "Films, at its own times"),
            ("VIEW", "View", "A place that the truth is rendered from"),
        ],
    )
    order: IntProperty(name="Order", description="Place in the rig's list", min=0)
    camera_id: StringProperty(
        name="Name", description="Names the camera's folder in the capture"
    )
    width_px: IntProperty(
        name="Width",
        description="Of its images",
        default=640,
        min=8,
        max=16384,
        subtype="PIXEL",
    )
    height_px: IntProperty(
        name="Height",
        description="Of its images",
        default=480,
        min=8,
        max=16384,
        subtype="PIXEL",
    )
    rate_hz: FloatProperty(
        name="Frames a Second",
        description="How often the camera takes an image",
        default=30.0,
        min=1e-3,
        max=1e5,
        precision=3,
    )
    delay_s: FloatProperty(
        name="Delay",
        description="How long after the start the middle of the camera's first exposure lies",
        precision=5,
        step=0.1,
        unit="TIME_ABSOLUTE",
    )
    jitter_s: FloatProperty(
        name="Jitter",
        description="Standard deviation of each image's time: how irregularly the camera triggers",
        min=0.0,
        precision=5,
        step=0.1,
        unit="TIME_ABSOLUTE",
    )
    jitter_stamped: BoolProperty(
        name="Writes Its Times",
        description="The camera notes when it took each image, jitter included. Else only its rate is known",
        default=True,
    )
    color: EnumProperty(
        name="Colour",
        description="What the camera records",
        items=[("rgb", "RGB", "In colour"), ("gray", "Grey", "In shades of grey")],
    )
    more: StringProperty(
        name="Other Fields",
        description="What else the rig file says of this camera, as JSON: exposure, noise, lens distortion, lost frames",
    )
    entry: StringProperty(
        name="Entry", description="As the rig file had it", options={"HIDDEN"}
    )


class StlfrScene(bpy.types.PropertyGroup):
    """The extension's settings of a scene: of the light field, its rendering, the rig, filming and offsets."""

    capture: StringProperty(
        name="Capture",
        description="Folder of the capture whose light field is rendered",
        subtype="DIR_PATH",
        options=FROM_BLEND,
        update=_open_capture,
    )
    time_offset_s: FloatProperty(
        name="Time Offset",
        description="The capture's time at the start frame, on the reference camera's clock. After filming, "
        "the light field and Cycles show the same instant",
        precision=5,
        step=0.1,
        unit="TIME_ABSOLUTE",
        update=_redraw,
    )
    start_frame: IntProperty(
        name="Start Frame",
        description="The scene's frame at which the capture's time is the time offset",
        default=1,
        update=_redraw,
    )
    speed: FloatProperty(
        name="Speed",
        description="Seconds of the capture in a second of the scene: below 1 is slow motion, 0 stands still",
        default=1.0,
        precision=3,
        update=_redraw,
    )
    preset: EnumProperty(
        name="Preset",
        description="All methods by one name: speed for accuracy",
        update=_redraw,
        **_methods("preset", NO_PRESET),
    )
    sync: EnumProperty(
        name="Motion",
        description="How each camera's image at the instant is made from its frames before and after",
        update=_redraw,
        **_methods("sync", AUTO),
    )
    proxy: EnumProperty(
        name="Scene Shape",
        description="What stands for the scene's shape when the cameras' images are blended",
        update=_redraw,
        **_methods("proxy", AUTO),
    )
    use_plane_depth: BoolProperty(
        name="Focus by Hand",
        description="Set the plane's depth; else it is fitted to what the cameras see",
        update=_redraw,
    )
    plane_depth_m: FloatProperty(
        name="Plane Depth",
        description="Depth of the plane before the camera: what is in focus",
        default=2.0,
        min=1e-3,
        max=1e6,
        subtype="DISTANCE",
        update=_redraw,
    )
    layout: EnumProperty(
        name="Picture",
        description="How many views a picture has",
        items=[
            ("VIEW", "View", "One view: F12 renders it"),
            (
                "QUILT",
                "Quilt",
                "Views from the left to the right, for a display of Looking Glass",
            ),
            (
                "STEREO",
                "Stereo Pair",
                "Views of the left and the right eye, side by side",
            ),
        ],
    )
    quilt_display: EnumProperty(
        name="Display",
        description="The display that shows the quilt",
        items=[
            (
                display["name"],
                display["name"].replace("-", " ").capitalize(),
                f"{display['columns']} x {display['rows']} views in {display['width']} x {display['height']} pixels",
            )
            for display in DISPLAYS
        ],
    )
    use_cone: BoolProperty(
        name="Set Cone",
        description="Set the angle between the first and the last view; else it is the display's, or as much as the cameras cover",
    )
    cone_deg: FloatProperty(
        name="Cone",
        description="Angle between the first and the last view, in degrees",
        default=10.0,
        min=1.0,
        max=170.0,
        precision=1,
    )
    eye_distance_m: FloatProperty(
        name="Eye Distance",
        description="From the left to the right eye",
        default=0.06,
        min=1e-4,
        max=10.0,
        subtype="DISTANCE",
        precision=4,
    )
    use_convergence: BoolProperty(
        name="Set Convergence",
        description="Set the depth of the plane without parallax; else it is in the middle of the scene's depths",
    )
    convergence_m: FloatProperty(
        name="Convergence",
        description="Depth of the plane without parallax, which appears at the display's surface",
        default=2.0,
        min=1e-3,
        max=1e6,
        subtype="DISTANCE",
    )
    picture_file: StringProperty(
        name="File",
        description="What is written; a quilt's name gets its layout, such as _qs8x6a0.75. An animation is a video "
        "(.mp4, .webm, .gif) or a numbered sequence",
        default="//picture.png",
        subtype="FILE_PATH",
        options=FROM_BLEND,
    )
    use_trail: BoolProperty(
        name="Trails",
        description="Overlay what moved before the instant",
        update=_redraw,
    )
    trail_duration_s: FloatProperty(
        name="Duration",
        description="How far the trails reach back, in the capture's time",
        default=0.1,
        min=0.0,
        max=1e6,
        precision=4,
        unit="TIME_ABSOLUTE",
        update=_redraw,
    )
    trail_instants: IntProperty(
        name="Instants",
        description="Instants that are overlaid; each costs a view",
        default=16,
        min=1,
        max=10_000,
        update=_redraw,
    )
    trail_mode: EnumProperty(
        name="Mode",
        description="How the instants are overlaid",
        update=_redraw,
        **_methods("trail"),
    )

    rig_name: StringProperty(name="Name", description="The rig's", default="rig")
    rig_seed: IntProperty(
        name="Seed", description="Decides the jitter and the noise", min=0
    )
    rig_reference: StringProperty(
        name="Reference", description="The camera whose clock all times are on"
    )
    rig_more: StringProperty(
        name="Other Fields", description="What else the rig file says, as JSON"
    )

    film_folder: StringProperty(
        name="Folder",
        description="The new capture's folder",
        default="//capture",
        subtype="DIR_PATH",
        options=FROM_BLEND,
    )
    film_frames: IntProperty(
        name="Frames",
        description="Images that each camera takes",
        default=9,
        min=1,
        max=100_000,
    )
    film_samples: IntProperty(
        name="Samples",
        description="Samples a pixel: more, and images have less noise and take longer",
        default=16,
        min=1,
        max=100_000,
    )
    film_truth: BoolProperty(
        name="Truth",
        description="Also render what the light field should show, to compare with: by Cycles it takes four times the samples",
        default=True,
    )
    film_instants: IntProperty(
        name="Instants",
        description="At how many instants the truth is rendered",
        default=3,
        min=1,
        max=1000,
    )
    film_all_cores: BoolProperty(
        name="Use All Cores",
        description="One filming process for every core. Each takes the memory that the scene takes",
        default=True,
    )
    film_workers: IntProperty(
        name="Processes",
        description="How many filming processes there are",
        default=1,
        min=1,
        max=1000,
    )

    offsets: CollectionProperty(type=StlfrOffset)
    offset_index: IntProperty(name="Offset", options={"HIDDEN"})


register_classes, unregister_classes = bpy.utils.register_classes_factory(
    (StlfrOffset, StlfrObject, StlfrScene)
)


def register() -> None:
    """Register the property classes, and add the property `stlfr` to scenes and objects."""
    register_classes()
    bpy.types.Scene.stlfr = PointerProperty(type=StlfrScene)
    bpy.types.Object.stlfr = PointerProperty(type=StlfrObject)


def unregister() -> None:
    """Remove the property `stlfr` from scenes and objects, and unregister its classes."""
    del bpy.types.Object.stlfr, bpy.types.Scene.stlfr
    unregister_classes()
