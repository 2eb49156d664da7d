"""The rig file: cameras, when their shutters open, and the virtual views that truth is rendered from.

The rig frame has COLMAP's axes (+x right, +y down, +z forward) at the rig's centre; metres and seconds.
World time 0 is the scene's start. The middle of frame k's exposure is, on the camera's own clock and
in world time,

    c_k = k / rate_hz + jitter_k
    delay_s + c_k + (c_k - c_0) drift_ppm 1e-6

with k the frame's nominal number, lost frames counted. A camera that stamps its frames writes c_k
into its times; where it doesn't, the jitter is hidden and its mean is part of the offset. A clock
that cameras share reads world time.

The format's schema comes from the Rust types (`stlfr rig --schema rig`), whose reader refuses what
this one refuses.
"""

from __future__ import annotations

import itertools
import json
import math
import random
from dataclasses import dataclass, replace
from pathlib import Path

from .camera import BlenderLens, Pinhole, RigidTransform, pinhole_from_lens
from .distortion import Distortion, ideal_border
from .errors import BadInputError
from .json_fields import Fields, read_fields

FORMAT = "stlfr-rig"
VERSION = 1

UNIT_QUATERNION_TOLERANCE = 1e-3
"""How far from 1 a quaternion's length may be: Blender's single precision passes, a typing error doesn't."""

MAX_JITTER_FRAMES = 0.1
"""Largest jitter deviation, in frame periods: above, two frames of one camera could swap."""

MAX_SPREAD = 2.0
"""How much wider than the image a pinhole's must be to hold all that a lens sees."""


@dataclass(frozen=True)
class RigView:
    """A pinhole camera on the rig. Lens as Blender's, sensor fit `AUTO`, square pixels."""

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
        """The lens as Blender's."""
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
    """A real camera: a view with a shutter and a sensor.

    `delay_s` is after the scene's start. `drift_ppm` is positive if the reference's clock goes by
    faster. `exposure_s` lies around the frame's time. `gain` multiplies light before it is encoded
    for display; `noise` is a standard deviation in display-encoded units of 0 to 1.
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
    gain: float
    noise: float
    color: str
    bit_depth: int


@dataclass(frozen=True)
class Rig:
    """A camera array with one reference camera, whose clock all times are on."""

    name: str
    reference: str
    seed: int
    cameras: tuple[RigCamera, ...]
    views: tuple[RigView, ...]

    @property
    def reference_camera(self) -> RigCamera:
        """The camera that keeps the time."""
        return next(camera for camera in self.cameras if camera.id == self.reference)


@dataclass(frozen=True)
class Shutter:
    """When one camera's images were exposed: the middle of each exposure."""

    id: str
    world_times_s: tuple[float, ...]
    """Since the scene's start."""
    clock_times_s: tuple[float, ...]
    """True times on the camera's own clock, jitter included."""
    stated_times_s: tuple[float, ...] | None
    """What the camera says of its times; `None` if it only says its nominal rate."""
    zero_s: float
    """World time at which the camera's clock reads 0, as far as its images can tell."""
    rate_ppm: float
    """How much faster than its clock the reference's goes by, from its first image on."""
    lost_before: tuple[int, ...]
    """The numbers of the images before which a frame is missing, once for each frame."""


def shutter(rig: Rig, camera_index: int, frame_count: int) -> Shutter:
    """The shutter times of those of a camera's first `frame_count` frames that are recorded.

    Frame k's time doesn't depend on `frame_count`. With hidden jitter, `zero_s` holds the mean of
    true minus nominal times, which is what the offset of such a camera means.
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
    """The shutter times of every camera, in the rig's order.

    The reference camera takes `frame_count` frames (less those it loses), the others film as long.
    """
    per_frame = [c.rate_hz / rig.reference_camera.rate_hz for c in rig.cameras]
    return [
        shutter(rig, index, max(1, math.ceil(frame_count * rate - 1e-6)))
        for index, rate in enumerate(per_frame)
    ]


def resized(rig: Rig, width_px: int, height_px: int) -> Rig:
    """The same rig at another resolution of the same aspect; lens and sensor stay, so the field of view does."""
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
    return _rig(read_fields(path, "rig file"))


def _rig(fields: Fields) -> Rig:
    format_name, version = fields.take("format"), fields.take("version")
    if format_name != FORMAT:
        raise fields.error(
            "format", f"must be {json.dumps(FORMAT)}, not {json.dumps(format_name)}"
        )
    if version != VERSION:
        raise fields.error("version", f"must be {VERSION}, not {json.dumps(version)}")
    entries = fields.objects("cameras")
    rig = Rig(
        name=fields.identifier("name"),
        reference=fields.text("reference"),
        seed=fields.whole_number("seed", 0, 2**53),
        cameras=tuple(_camera(entry) for entry in entries),
        views=tuple(_view(entry) for entry in fields.objects("views", default=[])),
    )
    fields.done()
    if not rig.cameras:
        raise fields.error("cameras", "must hold at least one camera")
    ids = [view.id for view in (*rig.cameras, *rig.views)]
    for index, view_id in enumerate(ids):
        if view_id in ids[:index]:
            raise fields.error(
                "cameras and views", f"have two entries with id {json.dumps(view_id)}"
            )
    if rig.reference not in ids[: len(rig.cameras)]:
        raise fields.error(
            "reference", f"names no camera of the rig: {json.dumps(rig.reference)}"
        )
    for entry, camera in zip(entries, rig.cameras, strict=True):
        _check_clock(entry, camera, rig.reference)
    return rig


def _camera(fields: Fields) -> RigCamera:
    view = _take_view(fields)
    rate_hz = fields.number("rate_hz", 1e-3, 1e5)
    camera = RigCamera(
        **vars(view),
        distortion=_distortion(fields),
        rate_hz=rate_hz,
        delay_s=fields.number("delay_s", -1e6, 1e6),
        jitter_s=fields.number(
            "jitter_s", 0.0, MAX_JITTER_FRAMES / rate_hz, default=0.0
        ),
        jitter_stamped=fields.truth_value("jitter_stamped", default=True),
        drift_ppm=fields.number("drift_ppm", -1e5, 1e5, default=0.0),
        lost_frames=fields.whole_numbers("lost_frames", 1, 1_000_000_000),
        lost_stamped=fields.truth_value("lost_stamped", default=True),
        clock_shared=fields.truth_value("clock_shared", default=False),
        exposure_s=fields.number("exposure_s", 0.0, 1.0 / rate_hz, default=0.0),
        gain=fields.number("gain", 0.01, 100.0, default=1.0),
        noise=fields.number("noise", 0.0, 0.5, default=0.0),
        color=fields.text("color", default="rgb"),
        bit_depth=fields.whole_number("bit_depth", 8, 16, default=8),
    )
    if camera.color not in ("rgb", "gray"):
        raise fields.error(
            "color", f'must be "rgb" or "gray", not {json.dumps(camera.color)}'
        )
    if camera.bit_depth not in (8, 16):
        raise fields.error("bit_depth", f"must be 8 or 16, not {camera.bit_depth}")
    if any(b <= a for a, b in itertools.pairwise(camera.lost_frames)):
        raise fields.error("lost_frames", "must ascend")
    _check_distortion(fields, camera)
    fields.done()
    return camera


def _distortion(fields: Fields) -> Distortion:
    entry = Fields(
        fields.take("distortion", {}), fields.file, fields.name("distortion")
    )
    coefficients = {
        name: entry.number(name, -10.0, 10.0, default=0.0)
        for name in ("k1", "k2", "p1", "p2")
    }
    entry.done()
    return Distortion(**coefficients)


def _check_distortion(fields: Fields, camera: RigCamera) -> None:
    if camera.distortion.is_none:
        return
    lens: Pinhole = pinhole_from_lens(camera.lens)
    border, ideal = ideal_border(lens, camera.distortion)
    for (x, y), (ideal_x, _) in zip(border.tolist(), ideal.tolist(), strict=True):
        if math.isnan(ideal_x):
            raise fields.error("distortion", f"has no inverse at pixel ({x:g}, {y:g})")
    width_px, height_px = (ideal.max(axis=0) - ideal.min(axis=0)).tolist()
    if (
        width_px > MAX_SPREAD * camera.width_px
        or height_px > MAX_SPREAD * camera.height_px
    ):
        raise fields.error(
            "distortion",
            f"sees more than a pinhole's image {MAX_SPREAD:g} times as large holds",
        )


def _check_clock(fields: Fields, camera: RigCamera, reference: str) -> None:
    """What can't be true of one clock together."""
    if camera.id == reference or camera.clock_shared:
        known = (
            "the reference camera"
            if camera.id == reference
            else "a camera with a shared clock"
        )
        if camera.drift_ppm != 0.0:
            raise fields.error("drift_ppm", f"must be 0 for {known}")
        if not camera.lost_stamped:
            raise fields.error("lost_stamped", f"must be true for {known}")
    if not camera.lost_stamped and camera.jitter_stamped and camera.jitter_s > 0.0:
        raise fields.error(
            "lost_stamped",
            "must be true where the jitter is stamped: stamps show what is lost",
        )


def _view(fields: Fields) -> RigView:
    view = _take_view(fields)
    fields.done()
    return view


def _take_view(fields: Fields) -> RigView:
    return RigView(
        id=fields.identifier("id"),
        width_px=fields.whole_number("width", 8, 16384),
        height_px=fields.whole_number("height", 8, 16384),
        lens_mm=fields.number("lens_mm", 1.0, 5000.0),
        sensor_width_mm=fields.number("sensor_width_mm", 1.0, 500.0),
        shift_x=fields.number("shift_x", -10.0, 10.0, default=0.0),
        shift_y=fields.number("shift_y", -10.0, 10.0, default=0.0),
        cam_from_rig=_transform(fields),
    )


def _transform(fields: Fields) -> RigidTransform:
    entry = Fields(
        fields.take("cam_from_rig"), fields.file, fields.name("cam_from_rig")
    )
    w, x, y, z = entry.numbers("rotation_wxyz", 4)
    length = (w * w + x * x + y * y + z * z) ** 0.5
    if abs(length - 1.0) > UNIT_QUATERNION_TOLERANCE:
        raise entry.error("rotation_wxyz", f"must have length 1, not {length:.6g}")
    tx, ty, tz = entry.numbers("translation", 3)
    entry.done()
    return RigidTransform(
        (w / length, x / length, y / length, z / length), (tx, ty, tz)
    )
