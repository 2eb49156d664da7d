"""Compares how Blender, pycolmap and the `stlfr` module project points to pixels.

A difference between two of them is the largest distance of their pixels over `POINTS` random points, in front of the
camera and behind it. It is infinite if only one of the two gives some point a pixel.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from .capture import Array, Camera, Pose, lens_of, pose_of, view_of

Projector = Callable[[Camera, Array], Array]
"""A function from a camera object and world points (N, 3) to pixels (N, 2), with NaN for points that have no image."""

SEED = 1

POINTS = 2000
"""Number of random points that are projected for each lens model and camera. If larger, the check takes longer; if
smaller, it may miss a difference in one corner of the image."""

TOLERANCE_PX = 1e-9
"""Maximum difference between pycolmap and stlfr. Both compute the same formula in double precision, with rounding
errors of about 1e-13 px. If larger, a difference in convention could pass; if smaller, rounding errors fail."""

BLENDER_TOLERANCE_PX = 3e-4
"""Maximum difference between Blender and stlfr. Blender's projection matrix has single precision, 24 bits: about
6e-5 px at coordinates up to 1000 px. If larger, a wrongly rounded principal point could pass; if smaller, rounding
errors fail."""


# Against pycolmap


def difference_px(camera: Camera, lens: Any, pose: Pose, project: Projector) -> float:
    """The largest distance between the projections of pycolmap (`lens`, `pose`) and of stlfr (`camera`), pixels.

    `project` is stlfr's projection. The result is infinite if only one of the two gives some point a pixel.
    """
    points_world_m = seen_points(camera, lens, pose)
    points_cam_m = points_world_m @ pose.rotation.T + pose.translation_m
    theirs = np.asarray(lens.img_from_cam(points_cam_m), dtype=np.float64)
    theirs[points_cam_m[:, 2] <= 0] = np.nan
    return largest_px(theirs, project(view_of(camera), points_world_m))


def seen_points(camera: Camera, lens: Any, pose: Pose) -> Array:
    """World points (`POINTS`, 3) on the rays of random pixels, about a tenth of them behind the camera."""
    random = np.random.default_rng(SEED)
    pixels = random.uniform((0, 0), (camera["width"], camera["height"]), (POINTS, 2))
    depth_m = random.uniform(0.2, 20.0, POINTS) * random.choice(
        (-1, 1), POINTS, p=(0.1, 0.9)
    )
    rays = np.column_stack([lens.cam_from_img(pixels), np.ones(POINTS)])
    points: Array = (rays * depth_m[:, None] - pose.translation_m) @ pose.rotation
    return points


def largest_px(theirs: Array, ours: Array) -> float:
    """The largest distance between two projections (N, 2) of the same points; NaN marks points without a pixel.

    Infinite if only one projection has a pixel for some point, or if no point has one.
    """
    absent = np.isnan(theirs).any(axis=1)
    if not np.array_equal(absent, np.isnan(ours).any(axis=1)) or absent.all():
        return float("inf")
    return float(np.linalg.norm((theirs - ours)[~absent], axis=1).max())


# Every model


MODELS: dict[str, list[float]] = {
    "SIMPLE_PINHOLE": [400.0, 321.0, 239.0],
    "PINHOLE": [686.0, 680.0, 321.0, 239.0],
    "SIMPLE_RADIAL": [686.0, 321.0, 239.0, -0.15],
    "RADIAL": [686.0, 321.0, 239.0, -0.21, 0.07],
    "OPENCV": [686.0, 680.0, 321.0, 239.0, -0.21, 0.07, 1e-3, -2e-3],
    "FULL_OPENCV": [
        *(686.0, 680.0, 321.0, 239.0),
        *(0.3, -0.1, 1e-3, -2e-3, 0.02, 0.5, 0.1, -0.01),
    ],
    "SIMPLE_RADIAL_FISHEYE": [400.0, 321.0, 239.0, -0.03],
    "RADIAL_FISHEYE": [400.0, 321.0, 239.0, 0.05, -0.02],
    "OPENCV_FISHEYE": [400.0, 396.0, 321.0, 239.0, 0.02, -0.01, 0.004, -0.001],
    "FOV": [400.0, 400.0, 321.0, 239.0, 0.9],
    "THIN_PRISM_FISHEYE": [
        *(400.0, 400.0, 321.0, 239.0),
        *(0.02, -0.01, 1e-3, -2e-3, 0.004, -0.001, 2e-3, -1e-3),
    ],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        *(400.0, 400.0, 321.0, 239.0, 0.02, -0.01, 0.004, -0.001, 2e-4, -1e-4),
        *(1e-3, -2e-3, 2e-3, -1e-3, 1e-3, 5e-4),
    ],
    "SIMPLE_DIVISION": [686.0, 321.0, 239.0, -0.2],
    "DIVISION": [686.0, 680.0, 321.0, 239.0, 0.1],
    "SIMPLE_FISHEYE": [400.0, 321.0, 239.0],
    "FISHEYE": [400.0, 400.0, 321.0, 239.0],
    "EUCM": [686.0, 680.0, 321.0, 239.0, 0.6, 1.1],
}
"""Parameters of one lens, with realistic distortion, for each lens model that stlfr reads; images of 640x480."""

POSE = {"rotation_wxyz": [0.8, -0.2, 0.4, 0.4], "translation": [0.3, -1.1, 2.0]}


def model_differences_px(project: Projector, pycolmap: Any) -> dict[str, float]:
    """The difference between the projections of pycolmap and stlfr for each lens model of `MODELS`, pixels."""
    found = {}
    for name, params in MODELS.items():
        camera = {"width": 640, "height": 480, "model": name, "params": params}
        camera["cam_from_world"] = POSE
        lens, pose = lens_of(camera, pycolmap), pose_of(camera, pycolmap)
        found[name] = difference_px(camera, lens, pose, project)
    return found


# Against Blender


@dataclass(frozen=True)
class BlenderCamera:
    """The settings of Blender that decide a camera's projection, besides pose, focal length and sensor size.

    `size_px` is the image size at a resolution percentage of 100.
    """

    size_px: tuple[int, int]
    fit: str
    shift: tuple[float, float]
    aspect: tuple[float, float]
    percentage: int

    @property
    def format(self) -> str:
        """The shape of the image: `landscape`, `portrait` or `square`."""
        width, height = self.size_px
        if width == height:
            return "square"
        return "landscape" if width > height else "portrait"


def blender_cameras() -> Iterator[BlenderCamera]:
    """Blender cameras to compare: every image format with every sensor fit, each with several other settings.

    These are the lens shift, the pixel aspect and the resolution percentage.
    """
    for size_px, fit, rest in itertools.product(
        [(640, 480), (480, 640), (500, 500)],
        ["AUTO", "HORIZONTAL", "VERTICAL"],
        [
            ((0.0, 0.0), (1.0, 1.0), 100),
            ((0.11, 0.0), (1.0, 1.0), 50),
            ((0.0, -0.07), (1.0, 1.0), 100),
            ((-0.2, 0.13), (1.0, 1.5), 100),
            ((0.05, 0.3), (2.0, 1.0), 25),
            (
                (0.0, 0.05),
                (1.25, 1.1),
                33,
            ),  # no whole number of pixels: Blender truncates
        ],
    ):
        yield BlenderCamera(size_px, fit, *rest)


@dataclass(frozen=True)
class BlenderDifference:
    """The differences between projections of one Blender camera, in pixels."""

    camera: BlenderCamera
    blender_px: float
    """The largest distance between the pixels of Blender and of stlfr."""
    pycolmap_px: float
    """The largest distance between the pixels of pycolmap and of stlfr."""


def blender_differences_px(
    project: Projector, pycolmap: Any, conversion: Any
) -> list[BlenderDifference]:
    """The differences for each of `blender_cameras`. `conversion` is the Blender extension's module `described`.

    Makes a temporary scene in the running Blender, and removes it.
    """
    import bpy

    scene = bpy.data.scenes.new("check")
    data = bpy.data.cameras.new("check")
    camera = bpy.data.objects.new("check", data)
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.location, camera.rotation_euler = (0.3, -2.0, 0.4), (1.45, 0.1, 0.05)
    data.lens, data.sensor_width, data.sensor_height = 41.0, 33.0, 21.0
    found = []
    for wanted in blender_cameras():
        render = scene.render
        render.resolution_x, render.resolution_y = wanted.size_px
        render.resolution_percentage = wanted.percentage
        render.pixel_aspect_x, render.pixel_aspect_y = wanted.aspect
        data.sensor_fit = wanted.fit
        data.shift_x, data.shift_y = wanted.shift
        scene.view_layers[0].update()
        ours = conversion.describe_object(camera, scene)
        lens, pose = lens_of(ours, pycolmap), pose_of(ours, pycolmap)
        points = seen_points(ours, lens, pose)
        theirs = blender_pixels(camera, scene, points, ours["width"], ours["height"])
        found.append(
            BlenderDifference(
                wanted,
                largest_px(theirs, project(ours, points)),
                difference_px(ours, lens, pose, project),
            )
        )
    bpy.data.objects.remove(camera)
    bpy.data.cameras.remove(data)
    bpy.data.scenes.remove(scene)
    return found


def blender_pixels(
    camera: Any, scene: Any, points_world_m: Array, width_px: int, height_px: int
) -> Array:
    """Pixels (N, 2) of world points by Blender's own projection matrix; NaN for points behind the camera.

    The matrix has Blender's single precision; it is applied in double precision.
    """
    import bpy

    render = scene.render
    clip_from_camera = np.array(
        camera.calc_matrix_camera(
            bpy.context.evaluated_depsgraph_get(),
            x=width_px,
            y=height_px,
            scale_x=render.pixel_aspect_x,
            scale_y=render.pixel_aspect_y,
        ),
        dtype=np.float64,
    )
    world_from_camera = np.array(camera.matrix_world, dtype=np.float64)
    homogeneous = np.column_stack([points_world_m, np.ones(len(points_world_m))])
    camera_from_world = np.linalg.inv(world_from_camera)
    x, y, _z, w = (homogeneous @ (clip_from_camera @ camera_from_world).T).T
    pixels: Array = np.column_stack(
        [(0.5 + 0.5 * x / w) * width_px, (0.5 - 0.5 * y / w) * height_px]
    )
    pixels[w <= 0] = np.nan
    return pixels
