"""Estimates a calibration from the static background of a recording (`calibrate`), or refines one (`refine`)."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .adjustment import Priors, adjusted
from .background import background
from .capture import Array, Camera, CheckError, Pose, pose_of
from .frames import Picture
from .mapping import DATABASE, map_cameras, mapping_options, match
from .residuals import Similarity, alignment, angle_deg, robust_mean_rotation
from .uncertainty import JointCovariance, StandardErrors

GUESSED_FOCAL = 1.2
"""Initial guess of an unknown focal length, as a multiple of the image's longer side. It is COLMAP's default."""

FOCAL_STD = 0.3
DISTORTION_STD = 0.1
"""Standard deviations of the priors on an unknown lens: `FOCAL_STD` as a fraction of the focal length, `DISTORTION_STD`
for each distortion coefficient. If larger, a lens that the images hardly determine becomes absurd; if smaller, a lens
that the images determine is biased towards the initial guess."""

REFINED_FOCAL_STD = 0.01
REFINED_CENTRE_STD = 0.005
"""Standard deviations of the priors on a given lens: `REFINED_FOCAL_STD` as a fraction of the focal length,
`REFINED_CENTRE_STD` of the principal point as a fraction of the image's width. If larger, parameters that the images
don't determine drift; if smaller, errors of the given lens remain."""

TOLD_FOCAL = 0.02
"""Maximum standard error of a focal length, as a fraction of it; above, a note says that the images don't determine it.
If larger, guesses pass for measurements; if smaller, measurements pass for guesses."""

FOCAL_NOTE = (
    "Focal lengths are taken as exact. If they may be off by 0.1 % or more, give --focal:"
    " otherwise poses are bent to make up for them."
)

MIN_POINTS = 30
"""Minimum number of points that each camera must see. If larger, usable images are refused; if smaller, estimated poses
may be arbitrary."""

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Request:
    """What the user gives for the estimation of an unknown calibration."""

    lens: str = "SIMPLE_RADIAL"
    focal_px: float | None = None
    """The exact focal length of all cameras, pixels; None if it is unknown."""
    distance: tuple[str, str, float] | None = None
    """The ids of two cameras and the distance between them in metres, which sets the scale; None if it is unknown."""


def calibrate(
    capture: Any,
    cameras: list[Camera],
    request: Request,
    progress: Progress,
    pycolmap: Any,
) -> dict[str, Any]:
    """Estimates lenses and poses of cameras without a calibration. Returns the result for `stlfr calibrate` as JSON.

    Of `cameras`, only ids and image sizes are read. `capture` is a `stlfr.Capture`. Raises `CheckError` if there are
    fewer than two cameras, or if the images don't determine the calibration.
    """
    if len(cameras) < 2:
        raise CheckError("calibrating needs two cameras or more", 2)
    unknown = [lensless(camera, request, pycolmap) for camera in cameras]
    progress_of = Steps(progress, len(cameras) + 3)
    with tempfile.TemporaryDirectory(prefix="stlfr-calibrate-") as name:
        scratch = Path(name)
        names = match_backgrounds(capture, unknown, scratch, progress_of, pycolmap)
        progress_of("placing the cameras")
        mapped = mapped_cameras(scratch, names, unknown, request, pycolmap)
        progress_of("bundle adjustment")
        focal = None if request.focal_px else FOCAL_STD
        model, errors, covariance = adjusted(
            scratch, mapped, Priors(focal, None, DISTORTION_STD), pycolmap
        )
    found = described(model, names, errors, unknown)
    poses = {c["id"]: pose_of(c, pycolmap) for c in found}
    scale, notes = world_scale(poses, request.distance)
    similarity = upright(poses, scale)
    set_world(found, similarity, pycolmap)
    told = max(c["focal_std_err_fraction"] for c in found)
    if told > TOLD_FOCAL:
        notes.append(
            "The images don't tell the focal lengths: they are near a guess, "
            f"{GUESSED_FOCAL:g} image widths. Depth is stretched where it is wrong. "
            "Give --focal, or film with cameras that are turned towards each other."
        )
    return {
        "cameras": found,
        "points": len(model.points3D),
        "covariance": in_world(covariance, names, similarity),
        "notes": notes,
    }


def refine(
    capture: Any,
    cameras: list[Camera],
    groups: tuple[str, ...],
    progress: Progress,
    pycolmap: Any,
) -> dict[str, Any]:
    """Refines a given calibration: all poses, and the lens parameters of `groups` (`focal`, `centre`).

    Returns the result for `stlfr refine` as JSON, with each camera's change of pose. A similarity aligns the result
    with the given cameras, because images determine neither the world's frame nor its scale.
    """
    if len(cameras) < 2:
        raise CheckError("refining needs two cameras or more", 2)
    progress_of = Steps(progress, len(cameras) + 2)
    widest = max(camera["width"] for camera in cameras)
    priors = Priors(
        REFINED_FOCAL_STD if "focal" in groups else None,
        REFINED_CENTRE_STD * widest if "centre" in groups else None,
    )
    with tempfile.TemporaryDirectory(prefix="stlfr-refine-") as name:
        scratch = Path(name)
        names = match_backgrounds(capture, cameras, scratch, progress_of, pycolmap)
        progress_of("bundle adjustment")
        model, errors, covariance = adjusted(scratch, cameras, priors, pycolmap)
    found = described(model, names, errors, cameras)
    given = {c["id"]: pose_of(c, pycolmap) for c in cameras}
    similarity = alignment(given, {c["id"]: pose_of(c, pycolmap) for c in found})
    set_world(found, similarity, pycolmap)
    for camera in found:
        before, after = given[camera["id"]], pose_of(camera, pycolmap)
        camera["turned_deg"] = angle_deg(before.rotation.T @ after.rotation)
        camera["moved_m"] = float(np.linalg.norm(before.centre_m - after.centre_m))
    notes = [] if "focal" in groups else [FOCAL_NOTE]
    return {
        "cameras": found,
        "points": len(model.points3D),
        "covariance": in_world(covariance, names, similarity),
        "notes": notes,
    }


def in_world(
    covariance: JointCovariance | None, names: dict[str, str], similarity: Similarity
) -> dict[str, Any] | None:
    """The joint covariance of all cameras as in capture.json, after a similarity of the world; None for None.

    `names` has the cameras' ids by image name, in the order of capture.json.
    """
    if covariance is None:
        return None
    return covariance.entry(list(names), similarity.rotation, similarity.scale)


class Steps:
    """Reports progress: each call names the step that starts now, and counts the previous one as done."""

    def __init__(self, progress: Progress, total: int) -> None:
        self.progress, self.done, self.total = progress, 0, total

    def __call__(self, what: str) -> None:
        self.progress(self.done, self.total, what)
        self.done += 1


def match_backgrounds(
    capture: Any,
    cameras: list[Camera],
    scratch: Path,
    progress_of: Steps,
    pycolmap: Any,
) -> dict[str, str]:
    """Matches features of the cameras' static backgrounds, and writes them into a COLMAP database in `scratch`.

    Returns the cameras' ids by image name. Raises `CheckError` if a camera has too few features.
    """
    pictures: dict[str, Picture] = {}
    for camera in cameras:
        progress_of(f"background of {camera['id']}")
        pictures[camera["id"]] = background(capture, camera["id"])
    progress_of("features and matches")
    names: dict[str, str] = match(pictures, cameras, scratch, pycolmap)
    require_features(scratch, names, pycolmap)
    return names


def lensless(camera: Camera, request: Request, pycolmap: Any) -> Camera:
    """A camera object without a pose. Its `expected` lens parameters have the requested focal length, or a guess.

    The field `params` is set only if a focal length is requested; without it, pycolmap guesses the intrinsics.
    """
    size = {name: camera[name] for name in ("id", "width", "height")}
    guess = GUESSED_FOCAL * max(camera["width"], camera["height"])
    lens = pycolmap.Camera.create(
        0, request.lens, request.focal_px or guess, camera["width"], camera["height"]
    )
    expected = [float(p) for p in lens.params]
    given = {"params": expected} if request.focal_px else {}
    return {**size, "model": request.lens, "expected": expected, **given}


def require_features(scratch: Path, names: dict[str, str], pycolmap: Any) -> None:
    """Raises `CheckError` if a camera has fewer than `MIN_POINTS` features in its static background."""
    with pycolmap.Database.open(scratch / DATABASE) as database:
        for image in database.read_all_images():
            count = database.num_keypoints_for_image(image.image_id)
            if count < MIN_POINTS:
                raise CheckError(
                    f"{names[image.name]} shows {count} features on what stands still, and {MIN_POINTS} are"
                    " needed: a textured background or larger images have more",
                    1,
                )


def mapped_cameras(
    scratch: Path,
    names: dict[str, str],
    cameras: list[Camera],
    request: Request,
    pycolmap: Any,
) -> list[Camera]:
    """All cameras with the poses and lenses that incremental mapping finds.

    Mapping first keeps the initial lenses. If it then can't place all cameras and no focal length was requested, it
    runs again and also estimates lenses. Raises `CheckError` if some cameras still have no pose.
    """
    fewest = [camera["id"] for camera in cameras]
    for refined in (False,) if request.focal_px else (False, True):
        options = mapping_options(pycolmap)
        options.ba_refine_focal_length = options.ba_refine_extra_params = refined
        model = map_cameras(scratch, options, pycolmap)
        images = [] if model is None else model.images.values()
        placed = {names[image.name]: image for image in images if image.has_pose}
        missing = [c["id"] for c in cameras if c["id"] not in placed]
        if not missing:
            found = []
            for camera in cameras:
                image = placed[camera["id"]]
                params = [float(p) for p in model.cameras[image.camera_id].params]
                found.append({**camera, "params": params, **pose_entry(image)})
            return found
        fewest = min(fewest, missing, key=len)
    if len(fewest) == len(cameras):
        raise CheckError(
            "no two cameras show enough of the same still things to be placed", 1
        )
    raise CheckError(
        f"no other camera shows enough of the still things that {', '.join(fewest)}"
        f" {'shows' if len(fewest) == 1 else 'show'}",
        1,
    )


def pose_entry(image: Any) -> dict[str, Any]:
    """The pose of a pycolmap image as the field `cam_from_world` of capture.json."""
    cam_from_world = image.cam_from_world()
    x, y, z, w = (float(v) for v in cam_from_world.rotation.quat)
    translation = [float(v) for v in cam_from_world.translation]
    return {
        "cam_from_world": {"rotation_wxyz": [w, x, y, z], "translation": translation}
    }


def described(
    model: Any,
    names: dict[str, str],
    errors: dict[str, StandardErrors],
    cameras: list[Camera],
) -> list[dict[str, Any]]:
    """The reconstructed lenses and poses with their standard errors, as JSON objects in the order of `cameras`.

    Raises `CheckError` if a camera sees fewer than `MIN_POINTS` points.
    """
    images = {names[image.name]: image for image in model.images.values()}
    found = []
    for camera in cameras:
        image = images[camera["id"]]
        of = errors.get(image.name)
        if of is None or of.points < MIN_POINTS:
            count = of.points if of else 0
            raise CheckError(
                f"{camera['id']} shares {count} still points with other cameras, and {MIN_POINTS} are needed",
                1,
            )
        lens = model.cameras[image.camera_id]
        found.append(
            {
                "id": camera["id"],
                "width": camera["width"],
                "height": camera["height"],
                "model": lens.model.name,
                "params": [float(p) for p in lens.params],
                **pose_entry(image),
                "points": of.points,
                "error_px": of.error_px,
                "rotation_std_err_deg": of.rotation_deg,
                "position_std_err_m": of.centre,
                "focal_std_err_fraction": of.focal_fraction,
            }
        )
    return found


def world_scale(
    poses: dict[str, Pose], distance: tuple[str, str, float] | None
) -> tuple[float, list[str]]:
    """The length of the reconstruction's unit in metres, from the known distance between two cameras, and notes.

    Without a distance, the mean distance of neighbouring cameras becomes 1 m, and a note says so.
    """
    centres = {camera_id: pose.centre_m for camera_id, pose in poses.items()}
    if distance is not None:
        first, second, metres = distance
        apart = float(np.linalg.norm(centres[first] - centres[second]))
        if not apart > 0.0:
            raise CheckError(f"{first} and {second} stand at one place", 1)
        return metres / apart, []
    places = np.array(list(centres.values()))
    apart_all = np.linalg.norm(places[:, None] - places[None], axis=2)
    np.fill_diagonal(apart_all, np.inf)
    mean = float(np.mean(apart_all.min(axis=1)))
    if not mean > 0.0:
        raise CheckError("the cameras stand at one place", 1)
    note = (
        "The images don't tell the scale: a metre is the mean distance of neighbouring cameras."
        " Give --distance CAMERA CAMERA METRES for true metres."
    )
    return 1.0 / mean, [note]


def upright(poses: dict[str, Pose], scale: float) -> Similarity:
    """The similarity into a world whose axes are the cameras' mean axes, and whose origin is their mean centre.

    `scale` is the length of the reconstruction's unit in metres.
    """
    rotation = robust_mean_rotation([pose.rotation for pose in poses.values()])
    origin: Array = np.mean([pose.centre_m for pose in poses.values()], axis=0)
    return Similarity(rotation, scale, -scale * rotation @ origin)


def set_world(
    cameras: list[dict[str, Any]], similarity: Similarity, pycolmap: Any
) -> None:
    """Transforms the poses of all cameras, and their positions' standard errors, into another world, in place."""
    for camera in cameras:
        pose = similarity.pose(pose_of(camera, pycolmap))
        x, y, z, w = (float(v) for v in pycolmap.Rotation3d(pose.rotation).quat)
        camera["position_std_err_m"] *= similarity.scale
        camera["cam_from_world"] = {
            "rotation_wxyz": [w, x, y, z],
            "translation": [float(v) for v in pose.translation_m],
        }
