"""The extension's panels in the sidebar of the 3D viewport and in the render properties."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from . import engine, filming, jobs, rig_objects, spans, timing, view, words
from .errors import BadInputError
from .long_work import draw_progress
from .paths import absolute

LETTER_PX = 7.0
"""Approximate width of a letter at interface scale 1. If larger, lines are broken too early; if smaller, their ends are
cut off."""


class Sidebar:
    """Base class of the panels in the 3D viewport's sidebar, for the steps from creating a rig to the comparison."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "STLFR"


class STLFR_PT_rig(Sidebar, bpy.types.Panel):
    """Panel to create, load, show and save the rig, and to edit its settings."""

    bl_label = "Rig"

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.stlfr
        row = layout.row(align=True)
        row.operator("stlfr.rig_create", icon="ADD")
        row.operator("stlfr.rig_load", text="Load", icon="FILE_FOLDER")
        cameras = rig_objects.members(context.scene, "CAMERA")
        if not cameras:
            layout.label(text="No rig in this scene", icon="INFO")
            return
        row = layout.row(align=True)
        row.operator("stlfr.rig_show", icon="VIEWZOOM")
        row.operator("stlfr.rig_save", text="Save", icon="FILE_TICK")
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.prop(settings, "rig_name")
        column.prop(settings, "rig_reference")
        column.prop(settings, "rig_seed")
        if settings.rig_more:
            column.prop(settings, "rig_more")
        column.label(text=f"{len(cameras)} cameras; select one to edit it")


class STLFR_PT_rig_camera(Sidebar, bpy.types.Panel):
    """Panel with the settings of the selected rig camera or view."""

    bl_label = "Rig Camera"
    bl_parent_id = "STLFR_PT_rig"

    @classmethod
    def poll(cls, context: Any) -> bool:
        active = context.object
        return active is not None and active.stlfr.role in ("CAMERA", "VIEW")

    def draw(self, context: Any) -> None:
        active = context.object
        own, lens, layout = active.stlfr, active.data, self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(own, "camera_id")
        column = layout.column(align=True)
        column.prop(own, "width_px")
        column.prop(own, "height_px")
        column = layout.column(align=True)
        for name in ("lens", "sensor_width", "shift_x", "shift_y"):
            column.prop(lens, name)
        if own.role == "CAMERA":
            column = layout.column(align=True)
            for name in ("rate_hz", "delay_s", "jitter_s", "jitter_stamped", "color"):
                column.prop(own, name)
        layout.prop(own, "more")


class STLFR_PT_film(Sidebar, bpy.types.Panel):
    """Panel with the options of filming, and the buttons that start and resume it."""

    bl_label = "Film"

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.stlfr
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "film_folder")
        column = layout.column(align=True)
        column.prop(settings, "film_frames")
        column.prop(settings, "film_samples")
        column.prop(settings, "film_all_cores")
        if not settings.film_all_cores:
            column.prop(settings, "film_workers")
        layout.prop(settings, "film_truth")
        if settings.film_truth:
            layout.prop(settings, "film_instants")
        if progress_instead(layout, "Filming"):
            return
        row = layout.row(align=True)
        row.enabled = jobs.running() is None
        row.operator("stlfr.film", icon="RENDER_ANIMATION").resume = False
        if _can_resume(settings):
            row.operator("stlfr.film", text="Resume", icon="PLAY").resume = True


class STLFR_UL_offsets(bpy.types.UIList):
    """List of cameras with their temporal offsets in milliseconds."""

    def draw_item(
        self,
        _context: Any,
        layout: Any,
        _data: Any,
        item: Any,
        _icon: Any,
        _active: Any,
        _name: Any,
    ) -> None:
        parts = layout.split(factor=0.3)
        parts.label(text=item.camera_id)
        parts.label(text=offset_text(item))


class STLFR_PT_offsets(Sidebar, bpy.types.Panel):
    """Panel to choose a capture, and to estimate the temporal offsets of its cameras."""

    bl_label = "Offsets"

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.stlfr
        layout.prop(settings, "capture")
        if not progress_instead(layout, "Estimating offsets"):
            row = layout.row()
            row.enabled = bool(settings.capture) and jobs.running() is None
            row.operator("stlfr.offsets", icon="TIME")
        if not settings.offsets:
            return
        layout.label(text="Milliseconds, ± standard error:")
        layout.template_list(
            "STLFR_UL_offsets", "", settings, "offsets", settings, "offset_index"
        )
        index = settings.offset_index
        if index < len(settings.offsets) and not settings.offsets[index].is_known:
            paragraph(layout, context, settings.offsets[index].reason, "ERROR")


class STLFR_PT_comparison(Sidebar, bpy.types.Panel):
    """Panel to compare results with the ground truth, and to show the comparison."""

    bl_label = "Comparison"

    def draw(self, context: Any) -> None:
        layout, folder = self.layout, capture_of(context.scene)
        if folder is None:
            layout.label(text="Choose a capture first", icon="INFO")
            return
        if not progress_instead(layout, "Comparing"):
            row = layout.row()
            row.enabled = jobs.running() is None
            row.operator("stlfr.compare", icon="PLAY")
        column = layout.column()
        column.enabled = (folder / "review" / "review.json").is_file()
        column.operator("stlfr.open_review", icon="SEQUENCE")
        column.operator("stlfr.open_report", icon="URL")


class STLFR_PT_ended(Sidebar, bpy.types.Panel):
    """Panel with messages about jobs that failed, or that ended after their .blend file had been closed."""

    bl_label = "Ended"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return bool(jobs.ended)

    def draw(self, context: Any) -> None:
        for sentence in jobs.ended:
            paragraph(self.layout, context, sentence, "INFO")
        self.layout.operator("stlfr.dismiss", icon="CHECKMARK")


class RenderTab:
    """Base class of the panels in the render properties; they are shown while the render engine is `STLFR`."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {engine.StlfrEngine.bl_idname}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.engine in cls.COMPAT_ENGINES


class STLFR_PT_light_field(RenderTab, bpy.types.Panel):
    """Panel to choose the capture, and its time at each frame of the scene."""

    bl_label = "Light Field"

    def draw(self, context: Any) -> None:
        layout, scene = self.layout, context.scene
        layout.use_property_split = True
        layout.prop(scene.stlfr, "capture")
        column = layout.column(align=True)
        column.prop(scene.stlfr, "start_frame")
        column.prop(scene.stlfr, "time_offset_s")
        column.prop(scene.stlfr, "speed")
        column = layout.column(align=True)
        column.label(text=f"This frame: {view.capture_time_s(scene):.4f} s")
        folder = capture_of(scene)
        if folder is not None:
            _covered(column, scene, folder)
        frame, sentence = engine.said.get(scene.name, (None, ""))
        if frame == scene.frame_current:
            paragraph(layout, context, sentence, "ERROR")


def _covered(layout: Any, scene: Any, folder: Path) -> None:
    """Draw which frames of the scene the capture covers; while the capture is being read, draw a note instead."""
    if not spans.is_known(folder):
        layout.label(text="The capture is being read", icon="TIME")
        return
    sentence, is_covered = timing.sentence(scene, folder)
    layout.label(text=sentence, icon="NONE" if is_covered else "ERROR")
    layout.operator("stlfr.set_range", icon="PREVIEW_RANGE")


class STLFR_PT_methods(RenderTab, bpy.types.Panel):
    """Panel to choose the rendering methods and their options."""

    bl_label = "Methods"
    bl_parent_id = "STLFR_PT_light_field"

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.stlfr
        layout.use_property_split = True
        layout.prop(settings, "preset")
        methods = layout.column()
        methods.enabled = settings.preset == "none"
        methods.prop(settings, "sync")
        methods.prop(settings, "proxy")
        if settings.proxy == "plane":
            methods.prop(settings, "use_plane_depth")
            row = methods.row()
            row.enabled = settings.use_plane_depth
            row.prop(settings, "plane_depth_m")


class STLFR_PT_trails(RenderTab, bpy.types.Panel):
    """Panel for trails: overlays of several instants in one picture."""

    bl_label = "Trails"
    bl_parent_id = "STLFR_PT_light_field"

    def draw_header(self, context: Any) -> None:
        self.layout.prop(context.scene.stlfr, "use_trail", text="")

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.stlfr
        layout.use_property_split = True
        layout.enabled = settings.use_trail
        for name in ("trail_duration_s", "trail_instants", "trail_mode"):
            layout.prop(settings, name)


class STLFR_PT_picture(RenderTab, bpy.types.Panel):
    """Panel to render quilts for light-field displays, and stereo pairs."""

    bl_label = "Displays"
    bl_parent_id = "STLFR_PT_light_field"

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.stlfr
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "layout")
        if settings.layout == "VIEW":
            layout.label(text="F12 renders the view", icon="INFO")
            return
        if settings.layout == "STEREO":
            layout.prop(settings, "eye_distance_m")
        else:
            layout.prop(settings, "quilt_display")
            _optional(layout, settings, "use_cone", "cone_deg")
        _optional(layout, settings, "use_convergence", "convergence_m")
        layout.prop(settings, "picture_file")
        if progress_instead(layout, "Rendering the picture"):
            return
        row = layout.row(align=True)
        row.enabled = bool(settings.capture) and jobs.running() is None
        row.operator("stlfr.picture", icon="RENDER_STILL").animation = False
        operator = row.operator(
            "stlfr.picture", text="Animation", icon="RENDER_ANIMATION"
        )
        operator.animation = True


def _optional(layout: Any, settings: Any, switch: str, name: str) -> None:
    """Draw a switch, and a setting that is enabled only while the switch is on."""
    layout.prop(settings, switch)
    row = layout.row()
    row.enabled = getattr(settings, switch)
    row.prop(settings, name)


def offset_text(item: Any) -> str:
    """An offset with its standard error in milliseconds as text, such as `+12.345 ± 0.012`; or `unknown`."""
    if not item.is_known:
        return "unknown"
    return f"{1e3 * item.offset_s:+.3f} ± {1e3 * item.std_err_s:.3f}"


def paragraph(layout: Any, context: Any, text: str, icon: str) -> None:
    """Draw a sentence of any length, broken into lines that fit the region's width."""
    scale = context.preferences.system.ui_scale or 1.0  # 0 without a window
    columns = max(12, int(context.region.width / (LETTER_PX * scale)) - 8)
    box = layout.column(align=True)
    box.scale_y = 0.8
    for number, line in enumerate(words.wrapped(text, columns)):
        box.label(text=line, icon="BLANK1" if number else icon)


def progress_instead(layout: Any, title: str) -> bool:
    """Draw the progress of the running job if it has this title, in place of its button. Returns whether it has."""
    job = jobs.running()
    if job is None or job.title != title:
        return False
    draw_progress(layout, job)
    return True


def capture_of(scene: Any) -> Path | None:
    """The folder of the capture that is chosen in the scene; None if none is chosen."""
    try:
        return engine.capture_folder(scene)
    except BadInputError:
        return None


def _can_resume(settings: Any) -> bool:
    try:
        return filming.is_begun(absolute(settings.film_folder))
    except BadInputError:
        return False


CLASSES = (
    STLFR_PT_rig,
    STLFR_PT_rig_camera,
    STLFR_PT_film,
    STLFR_UL_offsets,
    STLFR_PT_offsets,
    STLFR_PT_comparison,
    STLFR_PT_ended,
    STLFR_PT_light_field,
    STLFR_PT_methods,
    STLFR_PT_trails,
    STLFR_PT_picture,
)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
