"""Renders one image, or the depth and motion of one view, in Blender, with fixed settings for all images.

Images by Cycles: on the CPU, with a fixed number of samples, without denoising, and with the scene's number of bounces.
Motion blur lasts as long as the camera's exposure, and a rolling shutter is rendered in bands of rows (`rolling`). The
view transform is `Standard`, without a look and without dither. Then `sensor` applies lens distortion and the sensor.

Images by Workbench: the same cameras, geometry, textures, lenses and sensors under a fixed studio light. They have no
shadows, reflections, highlights or motion blur, and no noise of few samples.

Depth and motion: by Cycles, with one sample at each pixel's centre, at an instant.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np
import numpy.typing as npt

from . import camera as cameras
from . import exr, png, rolling, scenes, sensor
from .described import Camera, describe
from .plan import Job
from .rig import RigCamera, RigView

NARROWEST_FILTER_PX = 0.01
"""Width of the pixel filter when depth and motion are rendered, so that samples lie at the pixels' centres. If larger,
pixels at edges get the depth of a neighbour; smaller values are below Cycles' limit, and Blender raises them."""

WORKBENCH_BIAS_PX = {
    5: (0.0126, -0.1307),
    8: (-0.1129, -0.1112),
    11: (0.0435, 0.0479),
    16: (0.0418, -0.0373),
    32: (0.0328, -0.1047),
}
"""Displacement of Workbench's images to the right and down, pixels, by number of anti-aliasing samples. Workbench
centres the pattern of samples on one of them, not on their mean. The values were measured on images of discs in Blender
5.0, to 0.002 px. If they were wrong, images would be shifted against their calibration."""

WORKBENCH_LIGHT = "paint.sl"
"""The studio light for Workbench. It is part of Blender; the default light could be one of the user's settings."""

NOTHING_DEPTH_M = 1e9
"""A larger depth means that the pixel shows nothing, as Cycles writes 1e10 for a ray that hits no surface. If larger
than 1e10, the background counts as a surface; if much smaller, distant surfaces count as background."""

WINDOW_MARGIN_PX = 2
"""Rows that are rendered above and below a band of rows and then removed, because Workbench blurs the outermost row."""


WIDE_SUFFIX = ".wide"
"""Suffix of the id of the wide pinhole camera from which a distorted camera's image is resampled. Ids in rigs have no
dots."""


@dataclass(frozen=True)
class Image:
    """An image to render: a view of the rig, the time, the samples per pixel and the seeds.

    `seed` is the seed of the renderer, `sensor_seed` that of the sensor's noise. If `sensor_seed` is None, the image is
    ground truth: without noise, and with a global shutter.
    """

    view_id: str
    world_time_s: float
    samples: int
    seed: int
    sensor_seed: int | None = None


class Studio:
    """A scene to which the rig's cameras and views are added, ready to render."""

    def __init__(
        self,
        scene: Any,
        views: tuple[RigView, ...],
        threads: int,
        engine: str = "cycles",
    ) -> None:
        self.scene = scene
        self.engine = engine
        self.scenes_own_camera = scene.camera
        self.views = {view.id: view for view in views}
        configure(scene, threads)
        if engine == "workbench":
            configure_workbench(scene)
        world_from_rig = scenes.world_from_rig(scene)
        self.camera_objects = {
            view.id: _add_camera(scene, view, world_from_rig) for view in views
        }
        bpy.context.view_layer.update()
        self.wides = {
            view.id: self._add_wide(view)
            for view in views
            if isinstance(view, RigCamera) and not view.distortion.is_none
        }
        bpy.context.view_layer.update()

    def do(self, job: Job, capture: Path, scratch: Path, rate_hz: float) -> None:
        """Render the files of a job into the folder `capture`. `rate_hz` is the reference camera's frame rate."""
        image = Image(
            view_id=job.view_id,
            world_time_s=job.world_time_s,
            samples=job.samples,
            seed=job.seed,
            sensor_seed=job.seed if job.is_frame else None,
        )
        files = [capture / file for file in job.files]
        if job.is_geometry:
            self.render_geometry(image, files[0], files[1], scratch, rate_hz)
        else:
            self.render_image(image, files[0], scratch)

    def strike(self) -> None:
        """Remove the rig's cameras from the scene, and make the scene's original camera active again."""
        self.scene.camera = self.scenes_own_camera
        for camera_object in self.camera_objects.values():
            bpy.data.objects.remove(camera_object)
        self.camera_objects.clear()

    def describe(self, view_id: str) -> Camera:
        """The camera object of a view as in capture.json, computed from the values that Blender returns."""
        view = self.views[view_id]
        pinhole = self._pinhole(view_id, view.width_px, view.height_px)
        transform = cameras.cam_from_world_of(self.camera_objects[view_id])
        distortion = view.distortion if isinstance(view, RigCamera) else None
        return describe(pinhole, transform, distortion)

    def render_image(self, image: Image, target: Path, scratch: Path) -> None:
        """Render an image as the camera records it, and write it to `target` as PNG, atomically."""
        view = self.views[image.view_id]
        camera = view if isinstance(view, RigCamera) else None
        samples = image.samples
        if image.view_id in self.wides:  # as many per pixel of the final image
            samples = max(1, round(samples / sensor.FINENESS**2))
        self._aim(image.view_id, image.world_time_s, samples, image.seed)
        self._expose(camera.exposure_s if camera else 0.0)
        self._use_engine(samples)
        _set_passes(geometry=False)
        is_rolling = camera and camera.readout_s > 0.0 and image.sensor_seed is not None
        if camera and (is_rolling or not sensor.is_plain(camera)):
            light = (
                self._rolling_light(camera, image.world_time_s, scratch)
                if is_rolling
                else self._light(camera, scratch)
            )
            is_frame = image.sensor_seed is not None
            since_s = image.world_time_s - camera.delay_s if is_frame else 0.0
            pixels = sensor.develop(light, camera, image.sensor_seed, since_s)
            partial = _scratch_file(scratch, ".png")
            partial.write_bytes(png.encoded(pixels))
            move_whole(partial, target)
            return
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
        """Write the view's depth and motion as float32 .npy arrays (height, width).

        Depth: metres along the camera's +z at the pixel's centre; +inf if there is no surface.
        Motion: the distance in pixels by which the visible surface point moves in this view during 1/rate_hz. Of the
        motion before and the motion after the instant, the larger one is written. Cycles measures motion over one
        Blender frame; if the scene's frame rate isn't `rate_hz`, it is scaled proportionally.
        """
        self._aim(image.view_id, image.world_time_s, 1, image.seed)
        self.scene.render.engine = "CYCLES"
        self._expose(0.0)
        self.scene.cycles.filter_width = NARROWEST_FILTER_PX
        _set_passes(geometry=True)
        channels = self._render_channels(scratch)
        layer = bpy.context.view_layer.name
        depth_m = channels[f"{layer}.Depth.Z"]
        x0, y0, x1, y1 = (channels[f"{layer}.Vector.{part}"] for part in "XYZW")
        frames = self.scene.render.fps / self.scene.render.fps_base / rate_hz
        nothing = depth_m > NOTHING_DEPTH_M
        depth_m = np.where(nothing, np.float32(np.inf), depth_m)
        # Blender's y axis points up. The second vector points from the next position to this one.
        before = np.where(nothing, 0, frames * np.stack([x0, -y0])).transpose(1, 2, 0)
        after = np.where(nothing, 0, frames * np.stack([-x1, y1])).transpose(1, 2, 0)
        if image.view_id in self.wides:
            wide = self.wides[image.view_id]
            depth_m, moved_px = wide.geometry(depth_m, before, after)
        else:
            moved_px = np.maximum(
                np.linalg.norm(before, axis=2), np.linalg.norm(after, axis=2)
            )
        save_whole(depth_m, depth, scratch)
        save_whole(moved_px.astype(np.float32), motion, scratch)

    def _add_wide(self, view: RigCamera) -> sensor.Wide:
        """Add a pinhole camera with a larger image in the same pose, from which the distorted image is resampled."""
        lens = self._pinhole(view.id, view.width_px, view.height_px)
        wanted = sensor.wide_pinhole(lens, view.distortion)
        wide_id = view.id + WIDE_SUFFIX
        camera_object = self.camera_objects[view.id].copy()
        camera_object.data = camera_object.data.copy()
        self.scene.collection.objects.link(camera_object)
        self.camera_objects[wide_id] = camera_object
        blender_lens = cameras.lens_from_pinhole(wanted, view.sensor_width_mm)
        camera_object.data.sensor_fit = blender_lens.sensor_fit
        camera_object.data.lens = blender_lens.lens_mm
        camera_object.data.shift_x = blender_lens.shift_x
        camera_object.data.shift_y = blender_lens.shift_y
        found = self._pinhole(wide_id, wanted.width_px, wanted.height_px)
        return sensor.Wide(lens, view.distortion, found)

    def _pinhole(
        self, camera_id: str, width_px: int, height_px: int
    ) -> cameras.Pinhole:
        """The pinhole parameters with which Blender renders a camera at this image size."""
        render = self.scene.render
        render.resolution_x, render.resolution_y = width_px, height_px
        camera_object = self.camera_objects[camera_id]
        return cameras.pinhole_from_lens(cameras.lens_of(camera_object, self.scene))

    def _expose(self, exposure_s: float) -> None:
        """Set the exposure time of the next renderings, centred on the current frame; 0 is instantaneous."""
        render = self.scene.render
        render.use_motion_blur = exposure_s > 0.0
        if exposure_s > 0.0:
            render.motion_blur_position = "CENTER"
            render.motion_blur_shutter = exposure_s * render.fps / render.fps_base

    def _light(self, camera: RigCamera, scratch: Path) -> sensor.Light:
        """The scene-linear image (height, width, 3) behind the camera's lens, with its distortion."""
        light = self._rendered_light(scratch)
        return (
            self.wides[camera.id].resample(light) if camera.id in self.wides else light
        )

    def _rolling_light(
        self, camera: RigCamera, world_time_s: float, scratch: Path
    ) -> sensor.Light:
        """The image as of `_light` for a rolling shutter: each band of rows is rendered at its own time."""
        wide = self.wides.get(camera.id)
        rendered = []
        size_px = (camera.width_px, camera.height_px)
        for band in rolling.bands(size_px, camera.readout_s):
            self._set_time(world_time_s + band.offset_s)
            rows = slice(band.first, band.end)
            read = wide.rows_for(rows) if wide else rows
            with self._window(read):
                light = self._rendered_light(scratch)
            light = light[WINDOW_MARGIN_PX:-WINDOW_MARGIN_PX]
            if wide:
                whole = np.zeros(
                    (wide.pinhole.height_px, *light.shape[1:]), dtype=np.float32
                )
                whole[read] = light
                light = wide.resample(whole, rows)
            rendered.append(light)
        return np.concatenate(rendered)

    def _rendered_light(self, scratch: Path) -> sensor.Light:
        """Render the active camera's image, scene-linear (height, width, 3)."""
        channels = self._render_channels(scratch)
        layer = bpy.context.view_layer.name
        return np.stack([channels[f"{layer}.Combined.{c}"] for c in "RGB"], axis=2)

    @contextlib.contextmanager
    def _window(self, rows: slice) -> Iterator[None]:
        """Within this context, Blender renders only these rows of the image, and a margin above and below them.

        The lens is shifted to these rows. Cropping would be slower, because Workbench draws the whole image and then crops.
        """
        scene, lens = self.scene, self.scene.camera.data
        height_px = scene.render.resolution_y
        whole = cameras.pinhole_from_lens(cameras.lens_of(scene.camera, scene))
        part = cameras.lens_from_pinhole(
            whole.rows(rows.start - WINDOW_MARGIN_PX, rows.stop + WINDOW_MARGIN_PX),
            lens.sensor_width,
        )
        kept = lens.sensor_fit, lens.lens, lens.shift_x, lens.shift_y
        lens.sensor_fit, lens.lens = part.sensor_fit, part.lens_mm
        lens.shift_x, lens.shift_y = part.shift_x, part.shift_y
        scene.render.resolution_y = part.height_px
        try:
            yield
        finally:
            lens.sensor_fit, lens.lens, lens.shift_x, lens.shift_y = kept
            scene.render.resolution_y = height_px

    def _render_channels(self, scratch: Path) -> dict[str, sensor.Light]:
        """Render, and return all enabled passes as channels by name."""
        settings = self.scene.render.image_settings
        settings.media_type = "MULTI_LAYER_IMAGE"
        settings.file_format = "OPEN_EXR_MULTILAYER"
        # `exr` can read only uncompressed files with all passes in one part.
        settings.color_depth, settings.exr_codec = "32", "NONE"
        settings.use_exr_interleave = True
        partial = self._render(scratch, ".exr")
        channels = exr.read_channels(partial)
        partial.unlink()
        return channels

    def _is_gray(self, view_id: str) -> bool:
        view = self.views[view_id]
        return isinstance(view, RigCamera) and view.color == "gray"

    def _look_through(self, view_id: str) -> None:
        view, render = self.views[view_id], self.scene.render
        size_px = (view.width_px, view.height_px)
        if view_id in self.wides:
            pinhole = self.wides[view_id].pinhole
            size_px = (pinhole.width_px, pinhole.height_px)
            view_id += WIDE_SUFFIX
        render.resolution_x, render.resolution_y = size_px
        self.scene.camera = self.camera_objects[view_id]

    def _aim(self, view_id: str, world_time_s: float, samples: int, seed: int) -> None:
        self._look_through(view_id)
        self.scene.cycles.samples, self.scene.cycles.seed = samples, seed
        self._set_time(world_time_s)

    def _set_time(self, world_time_s: float) -> None:
        frame, subframe = scenes.frame_at(self.scene, world_time_s)
        self.scene.frame_set(frame, subframe=subframe)

    def _use_engine(self, samples: int) -> None:
        """Choose the engine for images, Workbench or Cycles; depth and motion are always rendered by Cycles."""
        render = self.scene.render
        if self.engine == "workbench":
            render.engine = "BLENDER_WORKBENCH"
            self.scene.display.render_aa = str(workbench_steps(samples))
        else:
            render.engine, self.scene.cycles.filter_width = "CYCLES", 1.5

    def _render(self, scratch: Path, suffix: str) -> Path:
        partial = _scratch_file(scratch, suffix)
        self.scene.render.filepath = str(partial)
        with self._unbiased():
            bpy.ops.render.render(write_still=True, scene=self.scene.name)
        return partial

    @contextlib.contextmanager
    def _unbiased(self) -> Iterator[None]:
        """Within this context, the active camera's lens is shifted to compensate `WORKBENCH_BIAS_PX`."""
        render, lens = self.scene.render, self.scene.camera.data
        if render.engine != "BLENDER_WORKBENCH":
            yield
            return
        right_px, down_px = WORKBENCH_BIAS_PX[int(self.scene.display.render_aa)]
        side_px = render.resolution_x
        if lens.sensor_fit == "AUTO":
            side_px = max(side_px, render.resolution_y)
        shift = lens.shift_x, lens.shift_y
        lens.shift_x += right_px / side_px
        lens.shift_y -= down_px / side_px
        try:
            yield
        finally:
            lens.shift_x, lens.shift_y = shift


def configure(scene: Any, threads: int) -> None:
    """Set all render settings that affect images and are the same for all images."""
    render, cycles, view = scene.render, scene.cycles, scene.view_settings
    render.engine = "CYCLES"
    render.threads_mode, render.threads = "FIXED", threads
    render.resolution_percentage = 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.use_persistent_data = True
    render.use_motion_blur = render.use_border = render.use_multiview = False
    render.use_compositing = render.use_sequencer = False
    render.use_file_extension = render.use_stamp = render.use_freestyle = False
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
    cycles.use_animated_seed = cycles.use_sample_subset = False
    cycles.use_layer_samples = "IGNORE"
    cycles.film_exposure = 1.0
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    cycles.use_auto_tile = False
    cycles.time_limit = 0.0
    stand = scene.camera
    for marker in scene.timeline_markers:
        marker.camera = None  # otherwise it would replace the rig's camera
    scene.camera = stand  # removing a marker's camera has changed the active camera


def configure_workbench(scene: Any) -> None:
    """Set Workbench to show textures under a studio light fixed in the world, so that all cameras see equal colours."""
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


def workbench_steps(samples: int) -> int:
    """Workbench's smallest number of anti-aliasing samples that is at least `samples`; 32 is its maximum."""
    return min((n for n in WORKBENCH_BIAS_PX if n >= samples), default=32)


def move_whole(partial: Path, target: Path) -> None:
    """Rename a complete temporary file to `target`, after syncing it to the disk."""
    with partial.open("r+b") as stream:
        os.fsync(stream.fileno())
    target.parent.mkdir(parents=True, exist_ok=True)
    partial.replace(target)


def save_whole(array: npt.NDArray[Any], target: Path, scratch: Path) -> None:
    """Write an array to a .npy file atomically, by a temporary file in `scratch`."""
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
