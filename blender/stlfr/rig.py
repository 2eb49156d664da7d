"""Simulated rigs as read from a rig file: cameras, their exposure times, and the virtual views of the ground truth.

The rig's coordinate frame has COLMAP's axes (+x right, +y down, +z forward) at the rig's centre. Lengths are metres,
times are seconds. World time 0 is the scene's start. The time of frame k is the middle of its exposure; with a rolling
shutter, that of its middle row. On the camera's own clock it is c_k, and in world time w_k:

    c_k = k / rate_hz + jitter_k
    w_k = delay_s + c_k + (c_k - c_0) drift_ppm 1e-6

k is the frame's nominal number, which also counts lost frames. A camera with time stamps records c_k as a frame's time.
Without time stamps, the jitter is unknown, and its mean is part of the camera's offset. A clock that several cameras
share shows world time.

The compiled module `stlfr` checks rig files (`stlfr rig --schema rig` prints their schema). This module only reads
checked rigs. It repeats the default values of optional fields; a test compares them with the schema.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from . import native
from .camera import BlenderLens, RigidTransform
from .distortion import Distortion
from .errors import BadInputError
from .native import Content


@dataclass(frozen=True)
class RigView:
    """A pinhole camera on the rig, with Blender's lens parameters, sensor fit `AUTO` and square pixels."""

    id: str
    width_px: int
    height_px: int
    lens_mm: float
    sensor_width_mm: float
    shift_x: float
    shift_y: float
    cam_from_rig: RigidTransform

    @property
    def lens(self) -> BlenderLens:
        """The lens parameters of a Blender camera with this projection."""
        return BlenderLens(
            width_px=self.width_px,
            height_px=self.height_px,
            lens_mm=self.lens_mm,
            sensor_width_mm=self.sensor_width_mm,
            shift_x=self.shift_x,
            shift_y=self.shift_y,
        )


@dataclass(frozen=True)
class RigCamera(RigView):
    """A simulated camera that records frames: a view with lens distortion, a clock, a shutter and a sensor.

    `delay_s` is the world time of the first frame, without jitter. `drift_ppm` is positive if world time passes faster
    than the camera's clock. The exposure (`exposure_s` long) and the readout (`readout_s` from the first row's time to
    the last row's) are centred on the frame's time. `gain` multiplies linear light. `gain_drift_per_s` is the rate of
    change of the gain's logarithm for red, green and blue, from the nominal time of the first frame on. `noise` is a
    standard deviation in display-encoded values from 0 to 1.
    """

    distortion: Distortion
    rate_hz: float
    delay_s: float
    jitter_s: float
    jitter_stamped: bool
    drift_ppm: float
    lost_frames: tuple[int, ...]
    lost_stamped: bool
    clock_shared: bool
    exposure_s: float
    readout_s: float
    gain: float
    gain_drift_per_s: tuple[float, float, float]
    noise: float
    color: str
    bit_depth: int


@dataclass(frozen=True)
class Rig:
    """A camera array. `reference` is the id of the reference camera; times are given on this camera's clock."""

    name: str
    reference: str
    seed: int
    cameras: tuple[RigCamera, ...]
    views: tuple[RigView, ...]

    @property
    def reference_camera(self) -> RigCamera:
        """The reference camera, on whose clock times are given."""
        return next(camera for camera in self.cameras if camera.id == self.reference)


@dataclass(frozen=True)
class Shutter:
    """When one camera's recorded images were exposed, and the true properties of its clock.

    The time of an image is the middle of its exposure.
    """

    id: str
    world_times_s: tuple[float, ...]
    """Times of the images, seconds since the scene's start."""
    clock_times_s: tuple[float, ...]
    """True times of the images on the camera's own clock, with jitter."""
    stated_times_s: tuple[float, ...] | None
    """Times of the images as recorded by the camera; `None` if the camera states only its nominal frame rate."""
    zero_s: float
    """World time at which the camera's clock shows 0. It includes the mean of a jitter that the time stamps lack."""
    rate_ppm: float
    """The clock's drift: time since the first image is longer in world time, by this factor in parts per million."""
    lost_before: tuple[int, ...]
    """The index of the image before which a frame is missing, for each lost frame before the last image."""


def shutter(rig: Rig, camera_index: int, frame_count: int) -> Shutter:
    """The exposure times of one camera: of its first `frame_count` frames, without lost ones.

    The time of a frame doesn't depend on `frame_count`. If the jitter isn't in the camera's time stamps, `zero_s`
    includes the mean difference of true and nominal times, because an estimated offset includes it too.
    """
    camera = rig.cameras[camera_index]
    generator = random.Random(f"{rig.seed}/jitter/{camera_index}")
    jitter_s = [generator.gauss(0.0, camera.jitter_s) for _ in range(frame_count)]
    recorded = [k for k in range(frame_count) if k not in camera.lost_frames]
    zero_s = 0.0 if camera.clock_shared else camera.delay_s
    first_s = camera.delay_s - zero_s
    nominal_s = [first_s + k / camera.rate_hz for k in recorded]
    clock_s = [
        time_s + jitter_s[k] for time_s, k in zip(nominal_s, recorded, strict=True)
    ]
    rate = camera.drift_ppm * 1e-6
    world_s = [zero_s + time_s + (time_s - clock_s[0]) * rate for time_s in clock_s]
    if not camera.jitter_stamped and not camera.clock_shared:
        stretched_s = [t + (t - nominal_s[0]) * rate for t in nominal_s]
        zero_s = sum(map(float.__sub__, world_s, stretched_s)) / len(recorded)
    stated_s: list[float] | None = None
    if camera.lost_stamped:
        if camera.jitter_stamped:
            stated_s = clock_s
        elif camera.lost_frames:
            stated_s = nominal_s
    return Shutter(
        id=camera.id,
        world_times_s=tuple(world_s),
        clock_times_s=tuple(clock_s),
        stated_times_s=None if stated_s is None else tuple(stated_s),
        zero_s=zero_s,
        rate_ppm=camera.drift_ppm,
        lost_before=tuple(
            sum(k < lost for k in recorded)
            for lost in camera.lost_frames
            if lost < recorded[-1]
        ),
    )


def shutters(rig: Rig, frame_count: int) -> list[Shutter]:
    """The exposure times of all cameras, in the rig's order.

    The reference camera takes `frame_count` frames, including lost ones. All other cameras film for the same duration.
    """
    per_frame = [c.rate_hz / rig.reference_camera.rate_hz for c in rig.cameras]
    return [
        shutter(rig, index, max(1, math.ceil(frame_count * rate - 1e-6)))
        for index, rate in enumerate(per_frame)
    ]


def resized(rig: Rig, width_px: int, height_px: int) -> Rig:
    """The same rig with another image size of all cameras and views. Their fields of view remain.

    Raises `BadInputError` if the aspect ratio differs from that of a camera or view.
    """
    for view in (*rig.cameras, *rig.views):
        if view.width_px * height_px != view.height_px * width_px:
            raise BadInputError(
                f"--size {width_px}x{height_px} has another aspect than {view.id} "
                f"of rig {rig.name} ({view.width_px}x{view.height_px})"
            )
    return replace(
        rig,
        cameras=tuple(
            replace(c, width_px=width_px, height_px=height_px) for c in rig.cameras
        ),
        views=tuple(
            replace(v, width_px=width_px, height_px=height_px) for v in rig.views
        ),
    )


def load(path: Path) -> Rig:
    """Read and check a rig file; a `BadInputError` names the file and the field."""
    return from_content(native.read_rig(path))


def from_content(content: Content) -> Rig:
    """The rig from the content of a rig file, which must have been checked."""
    return Rig(
        name=content["name"],
        reference=content["reference"],
        seed=content["seed"],
        cameras=tuple(_camera(entry) for entry in content["cameras"]),
        views=tuple(RigView(**_view(entry)) for entry in content.get("views", [])),
    )


def _camera(entry: Content) -> RigCamera:
    return RigCamera(
        **_view(entry),
        distortion=Distortion(**entry.get("distortion", {})),
        rate_hz=entry["rate_hz"],
        delay_s=entry["delay_s"],
        jitter_s=entry.get("jitter_s", 0.0),
        jitter_stamped=entry.get("jitter_stamped", True),
        drift_ppm=entry.get("drift_ppm", 0.0),
        lost_frames=tuple(entry.get("lost_frames", ())),
        lost_stamped=entry.get("lost_stamped", True),
        clock_shared=entry.get("clock_shared", False),
        exposure_s=entry.get("exposure_s", 0.0),
        readout_s=entry.get("readout_s", 0.0),
        gain=entry.get("gain", 1.0),
        gain_drift_per_s=_per_channel(entry.get("gain_drift_per_s", (0.0, 0.0, 0.0))),
        noise=entry.get("noise", 0.0),
        color=entry.get("color", "rgb"),
        bit_depth=entry.get("bit_depth", 8),
    )


def _per_channel(values: Sequence[float]) -> tuple[float, float, float]:
    red, green, blue = values
    return red, green, blue


def _view(entry: Content) -> dict[str, Any]:
    """The fields of a `RigView`, from a camera's or view's entry in the rig file."""
    return {
        "id": entry["id"],
        "width_px": entry["width"],
        "height_px": entry["height"],
        "lens_mm": entry["lens_mm"],
        "sensor_width_mm": entry["sensor_width_mm"],
        "shift_x": entry.get("shift_x", 0.0),
        "shift_y": entry.get("shift_y", 0.0),
        "cam_from_rig": _transform(entry["cam_from_rig"]),
    }


def _transform(entry: Content) -> RigidTransform:
    """A pose from the rig file. Its quaternion is normalized, because the file may have single precision."""
    w, x, y, z = entry["rotation_wxyz"]
    length = (w * w + x * x + y * y + z * z) ** 0.5
    tx, ty, tz = entry["translation"]
    return RigidTransform(
        (w / length, x / length, y / length, z / length), (tx, ty, tz)
    )
