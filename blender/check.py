"""Check a capture's calibration against pycolmap, an implementation that isn't ours.

Run as `python -I blender/check.py CAPTURE`. Two questions:

- Model: do pycolmap and the `stlfr` module project the same points to the same pixels?
- Pixels: where does pycolmap place the cameras from the images alone (SIFT, exhaustive matching,
  incremental mapping, intrinsics as given), and how far is that from the capture's poses?

Stdout carries one JSON object, stderr a table; exit code 0 if both agree, 1 if not, 2 for bad input.
The same capture gives the same numbers each time: seeds are fixed and pycolmap runs on one thread
wherever threads would change the order of its sums.
"""

from __future__ import annotations

import argparse
import importlib
import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Projector = Callable[[str, Array], Array]
"""Camera id and world points (N, 3) to pixels (N, 2), NaN where not in front of the camera."""

SEED = 1
MODEL_POINTS = 2000

MODEL_TOLERANCE_PX = 1e-9
"""Both compute the same formula in double precision; rounding is some 1e-13 px at these image sizes.
Larger, and a difference in convention at the far end of the image could hide; smaller, and it is noise."""

MAX_ERROR_PX = 1.0
"""Matches further off are dropped (COLMAP's own limit is 4). Larger, and slightly wrong matches pull
cameras by up to a millimetre at 320x240; smaller, and right matches go too where images are noisy."""

ROTATION_TOLERANCE_DEG = 0.05
POSITION_TOLERANCE_MM = 1.0
"""A camera further off than either is named. Over three instants of `magazine` at 320x240, truth images,
right cameras came out within 0.014 deg and 0.4 mm; a camera turned by 0.2 deg or moved by 2 mm must
stand out from that. Larger, and such a camera passes; smaller, and right ones fail on poorer images."""

REFERENCE_WIDTH_PX = 320
"""Smaller images resolve positions less finely, in proportion (1.1 mm at 160x120): below this width
the tolerances grow with the size of a pixel."""

MOVING_LEVELS = 10.0
"""A pixel counts as moving where the frames before and after differ by this much (of 255), averaged over
`MOVING_WINDOW_PX`. Larger, and slow things stay in; smaller, and noise takes out what stands still."""

MOVING_WINDOW_PX = 5
MOVING_MARGIN_PX = 15
"""How far around moving pixels features are ignored: they look that far."""


class CheckError(Exception):
    """Ends the check with one sentence."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


@dataclass(frozen=True)
class Pose:
    """cam_from_world."""

    rotation: Array
    translation_m: Array

    @property
    def centre_m(self) -> Array:
        """Where the camera stands in the world."""
        centre: Array = -self.rotation.T @ self.translation_m
        return centre


@dataclass(frozen=True)
class Residual:
    """How far one camera's exported pose is from where the pixels put it."""

    id: str
    rotation_deg: float
    position_mm: float

    def exceeds(
        self, rotation_tolerance_deg: float, position_tolerance_mm: float
    ) -> bool:
        """Whether it is off by more than either."""
        return (
            self.rotation_deg > rotation_tolerance_deg
            or self.position_mm > position_tolerance_mm
        )


# Reading the capture


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object, or one sentence."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CheckError(f"{path}: no such file", 2) from None
    except (OSError, ValueError) as error:
        raise CheckError(f"{path}: can't be read ({error})", 2) from None
    if not isinstance(content, dict):
        raise CheckError(f"{path}: must hold a JSON object", 2)
    return content


def pose_of(camera: dict[str, Any], pycolmap: Any) -> Pose:
    """A camera entry's pose."""
    w, x, y, z = camera["cam_from_world"]["rotation_wxyz"]
    quaternion = np.array([x, y, z, w]) / np.linalg.norm([w, x, y, z])
    rotation = pycolmap.Rotation3d(quaternion).matrix()
    return Pose(
        rotation, np.array(camera["cam_from_world"]["translation"], dtype=np.float64)
    )


def colmap_camera(camera: dict[str, Any], pycolmap: Any) -> Any:
    """A camera entry's intrinsics as pycolmap's camera."""
    return pycolmap.Camera(
        model=camera["model"],
        width=camera["width"],
        height=camera["height"],
        params=camera["params"],
    )


# Model


def model_difference_px(
    folder: Path, cameras: list[dict[str, Any]], project: Projector, pycolmap: Any
) -> float:
    """The largest distance between pycolmap's and our projection of random points, over all cameras.

    Infinite where only one of the two sees a point. pycolmap reads the capture's COLMAP model where
    it has one, so that both exports are checked against each other; else capture.json's numbers.
    """
    exported = exported_cameras(folder, cameras, pycolmap)
    random = np.random.default_rng(SEED)
    worst_px = 0.0
    for camera in cameras:
        lens, pose = exported[camera["id"]]
        pixels = random.uniform(
            (0, 0), (camera["width"], camera["height"]), (MODEL_POINTS, 2)
        )
        depth_m = random.uniform(0.2, 20.0, MODEL_POINTS) * random.choice(
            (-1, 1), MODEL_POINTS, p=(0.1, 0.9)
        )
        rays = np.column_stack([lens.cam_from_img(pixels), np.ones(MODEL_POINTS)])
        points_world_m = (rays * depth_m[:, None] - pose.translation_m) @ pose.rotation
        points_cam_m = points_world_m @ pose.rotation.T + pose.translation_m
        theirs = lens.img_from_cam(points_cam_m)
        theirs[points_cam_m[:, 2] <= 0] = np.nan
        ours = project(camera["id"], points_world_m)
        if not np.array_equal(np.isnan(theirs), np.isnan(ours)):
            return float("inf")
        worst_px = max(
            worst_px, float(np.nanmax(np.linalg.norm(theirs - ours, axis=1)))
        )
    return worst_px


def exported_cameras(
    folder: Path, cameras: list[dict[str, Any]], pycolmap: Any
) -> dict[str, tuple[Any, Pose]]:
    """Every camera's intrinsics and pose as pycolmap reads them."""
    if not (folder / "colmap").is_dir():
        return {
            c["id"]: (colmap_camera(c, pycolmap), pose_of(c, pycolmap)) for c in cameras
        }
    try:
        model = pycolmap.Reconstruction(folder / "colmap")
    except (ValueError, RuntimeError) as error:
        raise CheckError(
            f"{folder / 'colmap'}: pycolmap can't read it ({error})", 2
        ) from None
    found = {}
    for image in model.images.values():
        matrix = image.cam_from_world().matrix()
        found[image.name.split("/")[0]] = (
            model.cameras[image.camera_id],
            Pose(matrix[:, :3], matrix[:, 3]),
        )
    for camera in cameras:
        if camera["id"] not in found:
            raise CheckError(
                f"{folder / 'colmap' / 'images.txt'}: has no image of {camera['id']}", 2
            )
    return found


# Pixels


@dataclass(frozen=True)
class Picture:
    """One camera's image, with what may have moved masked where it wasn't taken with the others."""

    path: Path
    still: npt.NDArray[np.bool_] | None = None


def pictures_of_one_instant(
    folder: Path, cameras: list[dict[str, Any]], pycolmap: Any
) -> tuple[dict[str, Picture], str]:
    """One image per camera of the same scene, and where they come from.

    Truth at one instant where there is any. Else each camera's middle frame: those aren't
    synchronized, so what moves is masked, and only what stands still is matched.
    """
    ids = [camera["id"] for camera in cameras]
    if (folder / "truth" / "truth.json").is_file():
        truth = read_json(folder / "truth" / "truth.json")
        instants: dict[float, dict[str, Picture]] = {}
        for view in truth["views"]:
            if view["like"] is not None:
                picture = Picture(folder / "truth" / view["image"])
                instants.setdefault(view["time_s"], {})[view["like"]] = picture
        for time_s, pictures in sorted(instants.items()):
            if all(camera_id in pictures for camera_id in ids):
                return pictures, f"truth at {time_s:.4f} s"
    pictures = {
        camera["id"]: middle_frame(folder, camera, pycolmap) for camera in cameras
    }
    return pictures, "each camera's middle frame, what moves masked"


def middle_frame(folder: Path, camera: dict[str, Any], pycolmap: Any) -> Picture:
    """The middle image of a camera's sequence, and what stood still from the one before to the one after."""
    pattern: str = camera["frames"]
    if "%" not in pattern:
        raise CheckError(
            f"{folder / 'capture.json'}: the check needs image files, and {camera['id']} has a video",
            2,
        )
    count = 0
    while (folder / (pattern % count)).is_file():
        count += 1
    if count == 0:
        raise CheckError(f"{folder / (pattern % 0)}: no such image", 2)
    middle = (count - 1) // 2
    if count < 3:
        return Picture(folder / (pattern % middle))
    before, after = (
        read_grey(folder / (pattern % k), pycolmap) for k in (middle - 1, middle + 1)
    )
    moving = box_mean(np.abs(after - before), MOVING_WINDOW_PX) > MOVING_LEVELS
    still = box_mean(moving.astype(np.float64), 2 * MOVING_MARGIN_PX + 1) < 1e-9
    return Picture(folder / (pattern % middle), still)


def read_grey(path: Path, pycolmap: Any) -> Array:
    """An image's grey levels, 0 to 255."""
    bitmap = pycolmap.Bitmap.read(path, as_rgb=False)
    if bitmap is None:
        raise CheckError(f"{path}: can't be read as an image", 2)
    return np.asarray(bitmap.to_array(), dtype=np.float64)


def box_mean(image: Array, window_px: int) -> Array:
    """The mean over a square window (odd size) around every pixel, the image's border repeated."""
    half = window_px // 2
    for axis in (0, 1):
        padding = [(half + 1, half) if a == axis else (0, 0) for a in (0, 1)]
        sums = np.cumsum(np.pad(image, padding, mode="edge"), axis=axis)
        image = (
            np.take(sums, range(window_px, sums.shape[axis]), axis)
            - np.take(sums, range(sums.shape[axis] - window_px), axis)
        ) / window_px
    return image


def poses_from_pixels(
    pictures: dict[str, Picture], cameras: list[dict[str, Any]], pycolmap: Any
) -> dict[str, Pose]:
    """Structure from motion with the intrinsics given; world and scale are its own. Cameras it can't place are missing."""
    with tempfile.TemporaryDirectory(prefix="stlfr-check-") as scratch_name:
        scratch = Path(scratch_name)
        (scratch / "images").mkdir()
        (scratch / "masks").mkdir()
        database = scratch / "database.db"
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.use_gpu = False
        for camera in cameras:
            picture = pictures[camera["id"]]
            name = camera["id"] + picture.path.suffix
            shutil.copyfile(picture.path, scratch / "images" / name)
            reader = pycolmap.ImageReaderOptions()
            if picture.still is not None:
                mask = pycolmap.Bitmap.from_array(
                    np.where(picture.still, 255, 0).astype(np.uint8)
                )
                mask.write(scratch / "masks" / f"{name}.png")  # COLMAP's naming
                reader.mask_path = scratch / "masks"
            reader.camera_model = camera["model"]
            reader.camera_params = ",".join(repr(float(p)) for p in camera["params"])
            pycolmap.extract_features(
                database,
                scratch / "images",
                image_names=[name],
                camera_mode=pycolmap.CameraMode.PER_IMAGE,
                reader_options=reader,
                extraction_options=extraction,
                device=pycolmap.Device.cpu,
            )
        matching = pycolmap.FeatureMatchingOptions()
        matching.use_gpu, matching.num_threads = False, 1
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = SEED
        verification.ransac.max_error = MAX_ERROR_PX
        pycolmap.match_exhaustive(
            database,
            matching_options=matching,
            verification_options=verification,
            device=pycolmap.Device.cpu,
        )
        models = pycolmap.incremental_mapping(
            database, scratch / "images", scratch, mapping_options(pycolmap)
        )
    if not models:
        return {}
    model = max(models.values(), key=lambda m: m.num_reg_images())
    poses = {}
    for image in model.images.values():
        if image.has_pose:
            matrix = image.cam_from_world().matrix()
            poses[Path(image.name).stem] = Pose(matrix[:, :3], matrix[:, 3])
    return poses


def mapping_options(pycolmap: Any) -> Any:
    """Incremental mapping for a tightly packed rig: small angles are all there are."""
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_principal_point = False
    options.ba_refine_extra_params = False
    options.num_threads, options.random_seed = 1, SEED
    options.mapper.num_threads, options.mapper.random_seed = 1, SEED
    options.mapper.init_min_tri_angle = 4.0
    options.mapper.filter_min_tri_angle = 0.5
    options.mapper.filter_max_reproj_error = MAX_ERROR_PX
    options.mapper.init_max_error = MAX_ERROR_PX
    options.triangulation.min_angle = 0.5
    options.triangulation.random_seed = SEED
    options.min_model_size = 2
    options.multiple_models = False
    options.extract_colors = False
    return options


def residuals(exported: dict[str, Pose], estimated: dict[str, Pose]) -> list[Residual]:
    """Each camera's residual after the similarity that brings the estimate onto the exported poses.

    Positions alone don't fix a similarity for a rig in a line (it may turn about the line), so the
    rotation comes from the cameras' rotations, scale and translation from their positions. The fit
    minimizes distances, not their squares, so that one displaced camera doesn't drag the others.
    """
    ids = [camera_id for camera_id in exported if camera_id in estimated]
    relative = [exported[i].rotation.T @ estimated[i].rotation for i in ids]
    rotation = robust_mean_rotation(relative)
    turned = np.array([rotation @ estimated[i].centre_m for i in ids])
    centres = np.array([exported[i].centre_m for i in ids])
    weights = np.ones(len(ids))
    for _ in range(100):
        weights /= weights.sum()
        mean_turned, mean_centre = weights @ turned, weights @ centres
        spread = weights @ np.sum((turned - mean_turned) ** 2, axis=1)
        agreement = weights @ np.sum(
            (turned - mean_turned) * (centres - mean_centre), axis=1
        )
        scale = agreement / spread if spread > 0 else 1.0
        distances_m = np.linalg.norm(
            scale * (turned - mean_turned) + mean_centre - centres, axis=1
        )
        weights = 1.0 / np.maximum(distances_m, 1e-5)
    return [
        Residual(
            camera_id,
            angle_deg(rotation.T @ relative[k]),
            1000.0 * float(distances_m[k]),
        )
        for k, camera_id in enumerate(ids)
    ]


def robust_mean_rotation(rotations: list[Array]) -> Array:
    """The rotation with the least sum of distances (not squared) to the given ones."""
    weights = np.ones(len(rotations))
    mean = rotations[0]
    for _ in range(100):
        u, _singular, vt = np.linalg.svd(
            np.tensordot(weights, np.array(rotations), axes=1)
        )
        mean = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        distances = np.array([np.linalg.norm(mean - r) for r in rotations])
        weights = 1.0 / np.maximum(distances, 1e-6)
    return mean


def angle_deg(rotation: Array) -> float:
    """How far a rotation turns; accurate for tiny angles."""
    return float(
        np.degrees(
            2 * np.arcsin(min(1.0, np.linalg.norm(rotation - np.eye(3)) / np.sqrt(8)))
        )
    )


# The check


def check(folder: Path, project: Projector, pycolmap: Any) -> dict[str, Any]:
    """Both questions; the result as it is printed."""
    cameras: list[dict[str, Any]] = read_json(folder / "capture.json")["cameras"]
    model_max_px = model_difference_px(folder, cameras, project, pycolmap)
    coarseness = max(1.0, REFERENCE_WIDTH_PX / min(c["width"] for c in cameras))
    tolerances = (
        coarseness * ROTATION_TOLERANCE_DEG,
        coarseness * POSITION_TOLERANCE_MM,
    )
    result: dict[str, Any] = {
        "model_max_px": model_max_px if np.isfinite(model_max_px) else None,
        "model_tolerance_px": MODEL_TOLERANCE_PX,
        "rotation_tolerance_deg": tolerances[0],
        "position_tolerance_mm": tolerances[1],
        "image_source": None,
        "cameras": [
            {"id": c["id"], "rotation_deg": None, "position_mm": None} for c in cameras
        ],
    }
    problems = []
    if not model_max_px <= MODEL_TOLERANCE_PX:
        problems.append(
            f"pycolmap and stlfr project points up to {model_max_px:.3g} px apart"
        )
    if len(cameras) > 1:
        pictures, result["image_source"] = pictures_of_one_instant(
            folder, cameras, pycolmap
        )
        estimated = poses_from_pixels(pictures, cameras, pycolmap)
        exported = {c["id"]: pose_of(c, pycolmap) for c in cameras}
        missing = [c["id"] for c in cameras if c["id"] not in estimated]
        found = residuals(exported, estimated) if len(estimated) > 1 else []
        by_id = {r.id: r for r in found}
        for entry in result["cameras"]:
            if entry["id"] in by_id:
                entry["rotation_deg"] = by_id[entry["id"]].rotation_deg
                entry["position_mm"] = by_id[entry["id"]].position_mm
        if missing:
            problems.append(
                f"pycolmap could not place {', '.join(missing)} from the images"
            )
        off = [r.id for r in found if r.exceeds(*tolerances)]
        if off:
            problems.append(
                f"the images put {', '.join(off)} elsewhere than the capture does"
            )
    result["ok"] = not problems
    result["reason"] = "; ".join(problems) or None
    return result


def table(result: dict[str, Any]) -> str:
    """For people."""
    lines = [f"{'camera':<12} {'rotation':>10} {'position':>10}"]
    for camera in result["cameras"]:
        if camera["rotation_deg"] is None:
            lines.append(f"{camera['id']:<12} {'-':>10} {'-':>10}")
        else:
            rotation, position = (
                f"{camera['rotation_deg']:.3f} deg",
                f"{camera['position_mm']:.2f} mm",
            )
            lines.append(f"{camera['id']:<12} {rotation:>10} {position:>10}")
    lines.append(
        f"{'tolerance':<12} {result['rotation_tolerance_deg']:>6.3f} deg"
        f" {result['position_tolerance_mm']:>7.2f} mm"
        f"   images: {result['image_source'] or 'none'}"
    )
    difference = result["model_max_px"]
    shown = (
        "only one sees some points" if difference is None else f"{difference:.1e} px"
    )
    lines.append(
        f"model against pycolmap: {shown} (tolerance {MODEL_TOLERANCE_PX:.0e} px)"
    )
    return "\n".join(lines)


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one sentence, without the usage."""

    def error(self, message: str) -> NoReturn:
        raise CheckError(message, 2)


def run(arguments: list[str]) -> int:
    """The command."""
    parser = Parser(
        prog="check.py", description="Check a capture's calibration against pycolmap."
    )
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help="capture folder")
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write the result to a file too"
    )
    options = parser.parse_args(arguments)
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    try:
        stlfr = importlib.import_module("stlfr")
    except ImportError as error:
        raise CheckError(
            f"the stlfr module isn't in this Python environment ({error})", 1
        ) from None
    folder = options.capture.resolve()
    if not folder.is_dir():
        raise CheckError(f"{options.capture}: no such folder", 2)
    try:
        project: Projector = stlfr.open(str(folder)).project
    except (ValueError, OSError) as error:
        raise CheckError(str(error), 2) from None
    result = check(folder, project, pycolmap)
    print(table(result), file=sys.stderr)
    text = json.dumps(result, indent=1)
    print(text)
    if options.json:
        options.json.write_text(text + "\n", encoding="utf-8")
    if not result["ok"]:
        print(f"calibration check failed: {result['reason']}", file=sys.stderr)
    return 0 if result["ok"] else 1


def main() -> int:
    """Run, and say what went wrong in one sentence."""
    try:
        return run(sys.argv[1:])
    except CheckError as error:
        print(error, file=sys.stderr)
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
