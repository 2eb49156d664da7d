"""Render one image, or the depth and motion of one view, exactly as every other one. The Blender side.

Image: Cycles on the CPU, a fixed number of samples, no denoising, one bounce, no motion blur,
`Standard` view without a look, no dither. Geometry: one sample at each pixel's centre.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np
import numpy.typing as npt

from . import camera as cameras
from . import exr, png, scenes
from .rig import RigCamera, RigView

NARROWEST_FILTER_PX = 0.01
"""Cycles' lower limit: the sample of a geometry render lies this close to the pixel's centre."""

WORKBENCH_STEPS = (5, 8, 11, 16, 32)
WORKBENCH_LIGHT = "paint.sl"
"""Comes with Blender; the default light would be the user's own."""

NOTHING_DEPTH_M = 1e9
"""Cycles writes 1e10 where a ray meets nothing."""


@dataclass(frozen=True)
class Image:
    """One picture to render: which view of the rig, when, how well, and with which noise."""

    view_id: str
    world_time_s: float
    samples: int
    seed: int


class Studio:
    """A scene with the rig's cameras and views set up in it."""

    def __init__(
        self,
        scene: Any,
        views: tuple[RigView, ...],
        threads: int,
        engine: str = "cycles",
    ) -> None:
        self.scene = scene
        self.engine = engine
        self.views = {view.id: view for view in views}
        configure(scene, threads)
        if engine == "workbench":
            configure_workbench(scene)
        world_from_rig = scenes.world_from_rig(scene)
        self.camera_objects = {
            view.id: _add_camera(scene, view, world_from_rig) for view in views
        }
        bpy.context.view_layer.update()

    def describe(self, view_id: str) -> dict[str, Any]:
        """The view's camera as capture.json spells it, read back from Blender."""
        camera_object = self._look_through(view_id)
        pinhole = cameras.pinhole_from_lens(cameras.lens_of(camera_object, self.scene))
        return {
            "width": pinhole.width_px,
            "height": pinhole.height_px,
            "model": "PINHOLE",
            "params": pinhole.params,
            "cam_from_world": cameras.cam_from_world_of(camera_object).to_json(),
        }

    def render_image(self, image: Image, target: Path, scratch: Path) -> None:
        """Write an 8-bit PNG, RGB or grey as the camera is. It gets its name only when it is whole and on the disk."""
        self._aim(image.view_id, image.world_time_s, image.samples, image.seed)
        self.scene.cycles.filter_width = 1.5
        if self.engine == "workbench":
            self.scene.render.engine = "BLENDER_WORKBENCH"
            self.scene.display.render_aa = workbench_steps(image.samples)
        _set_passes(geometry=False)
        settings = self.scene.render.image_settings
        settings.media_type, settings.file_format = "IMAGE", "PNG"
        settings.color_mode = "BW" if self._is_gray(image.view_id) else "RGB"
        settings.color_depth = "8"
        partial = self._render(scratch, ".png")
        partial.write_bytes(png.picture_only(partial.read_bytes()))
        move_whole(partial, target)

    def render_geometry(
        self, image: Image, depth: Path, motion: Path, scratch: Path, rate_hz: float
    ) -> None:
        """Write the view's depth and motion as float32 .npy arrays, height x width.

        Depth: metres along the camera's +z at the pixel's centre, +inf where there is nothing.
        Motion: the larger of the distances in pixels that the surface point seen there moves in
        this view from 1/rate_hz before and to 1/rate_hz after. Cycles measures over one Blender
        frame; at another frame rate than `rate_hz` that is scaled in proportion.
        """
        self._aim(image.view_id, image.world_time_s, 1, image.seed)
        self.scene.render.engine = "CYCLES"
        self.scene.cycles.filter_width = NARROWEST_FILTER_PX
        _set_passes(geometry=True)
        settings = self.scene.render.image_settings
        settings.media_type = "MULTI_LAYER_IMAGE"
        settings.file_format = "OPEN_EXR_MULTILAYER"
        # As `exr` reads them: all passes in one part, not compressed.
        settings.color_depth, settings.exr_codec = "32", "NONE"
        settings.use_exr_interleave = True
        partial = self._render(scratch, ".exr")
        channels = exr.read_channels(partial)
        partial.unlink()
        layer = bpy.context.view_layer.name
        depth_m = channels[f"{layer}.Depth.Z"]
        vector = [channels[f"{layer}.Vector.{part}"] for part in "XYZW"]
        frames = self.scene.render.fps / self.scene.render.fps_base / rate_hz
        moved_px = frames * np.maximum(
            np.hypot(vector[0], vector[1]), np.hypot(vector[2], vector[3])
        )
        nothing = depth_m > NOTHING_DEPTH_M
        save_whole(np.where(nothing, np.float32(np.inf), depth_m), depth, scratch)
        save_whole(
            np.where(nothing, np.float32(0), moved_px.astype(np.float32)),
            motion,
            scratch,
        )

    def _is_gray(self, view_id: str) -> bool:
        view = self.views[view_id]
        return isinstance(view, RigCamera) and view.color == "gray"

    def _look_through(self, view_id: str) -> Any:
        view, render = self.views[view_id], self.scene.render
        render.resolution_x, render.resolution_y = view.width_px, view.height_px
        self.scene.camera = self.camera_objects[view_id]
        return self.scene.camera

    def _aim(self, view_id: str, world_time_s: float, samples: int, seed: int) -> None:
        self._look_through(view_id)
        self.scene.cycles.samples, self.scene.cycles.seed = samples, seed
        frame, subframe = scenes.frame_at(self.scene, world_time_s)
        self.scene.frame_set(frame, subframe=subframe)

    def _render(self, scratch: Path, suffix: str) -> Path:
        partial = _scratch_file(scratch, suffix)
        self.scene.render.filepath = str(partial)
        bpy.ops.render.render(write_still=True, scene=self.scene.name)
        return partial


def configure(scene: Any, threads: int) -> None:
    """Set everything that a picture depends on and that stays the same from picture to picture."""
    render, cycles, view = scene.render, scene.cycles, scene.view_settings
    render.engine = "CYCLES"
    render.threads_mode, render.threads = "FIXED", threads
    render.resolution_percentage = 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.use_persistent_data = True
    render.use_motion_blur = render.use_border = render.use_multiview = False
    render.use_compositing = render.use_sequencer = False
    render.use_file_extension = False
    render.dither_intensity = 0.0
    render.use_single_layer = True
    render.film_transparent = False
    render.image_settings.color_management = "FOLLOW_SCENE"
    scene.display_settings.display_device = "sRGB"
    view.view_transform, view.look = "Standard", "None"
    view.exposure, view.gamma = 0.0, 1.0
    view.use_curve_mapping = view.use_white_balance = False
    cycles.device = "CPU"
    cycles.use_denoising = cycles.use_adaptive_sampling = False
    cycles.use_animated_seed = False
    cycles.film_exposure = 1.0
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = 1
    cycles.transmission_bounces = 1
    cycles.use_auto_tile = False
    cycles.time_limit = 0.0


def configure_workbench(scene: Any) -> None:
    """Textures under a studio's light that stays with the world, so that a point looks alike from every camera."""
    scene.render.filter_size = 1.5
    shading = scene.display.shading
    shading.light, shading.studio_light = "STUDIO", WORKBENCH_LIGHT
    shading.use_world_space_lighting, shading.studiolight_rotate_z = True, 0.0
    shading.color_type = "TEXTURE"
    shading.background_type = "VIEWPORT"
    shading.background_color = (0.0, 0.0, 0.0)
    shading.show_specular_highlight = False
    shading.show_shadows = shading.show_cavity = shading.show_object_outline = False
    shading.show_backface_culling = shading.show_xray = shading.use_dof = False


def workbench_steps(samples: int) -> str:
    """Workbench's anti-aliasing with at least so many samples a pixel, as far as it goes."""
    return str(next((n for n in WORKBENCH_STEPS if n >= samples), WORKBENCH_STEPS[-1]))


def move_whole(partial: Path, target: Path) -> None:
    """Give a finished scratch file its name, its bytes on the disk first."""
    with partial.open("r+b") as stream:
        os.fsync(stream.fileno())
    target.parent.mkdir(parents=True, exist_ok=True)
    partial.replace(target)


def save_whole(array: npt.NDArray[Any], target: Path, scratch: Path) -> None:
    """Write a .npy file that gets its name only when it is whole."""
    partial = _scratch_file(scratch, ".npy")
    np.save(partial, array)
    move_whole(partial, target)


def _scratch_file(scratch: Path, suffix: str) -> Path:
    handle, name = tempfile.mkstemp(suffix=suffix, dir=scratch)
    os.close(handle)
    return Path(name)


def _set_passes(geometry: bool) -> None:
    layer = bpy.context.view_layer
    if layer.use_pass_z != geometry or layer.use_pass_vector != geometry:
        layer.use_pass_z = layer.use_pass_vector = geometry


def _add_camera(scene: Any, view: RigView, world_from_rig: cameras.Array) -> Any:
    lens = bpy.data.cameras.new(view.id)
    lens.sensor_fit = "AUTO"
    lens.lens, lens.sensor_width = view.lens_mm, view.sensor_width_mm
    lens.shift_x, lens.shift_y = view.shift_x, view.shift_y
    lens.clip_start, lens.clip_end = 0.01, 1e4
    camera_object = bpy.data.objects.new(view.id, lens)
    scene.collection.objects.link(camera_object)
    world_from_cam = world_from_rig @ np.linalg.inv(view.cam_from_rig.matrix())
    world_from_cam[:3, :3] = world_from_cam[:3, :3] @ cameras.COLMAP_FROM_BLENDER_AXES
    camera_object.rotation_mode = "QUATERNION"
    camera_object.matrix_world = mathutils.Matrix(world_from_cam.tolist())
    return camera_object
