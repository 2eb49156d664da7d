"""Camera poses from images alone, by pycolmap: SIFT features, exhaustive matching, incremental mapping.

The result is deterministic: seeds are fixed, and pycolmap runs on one thread wherever threads would change the order of
summation.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .capture import Camera, EstimatedPose
from .frames import Picture
from .uncertainty import standard_errors

SEED = 1

DATABASE = "database.db"
"""Name of COLMAP's database of features and matches, in a temporary folder."""

MAX_ERROR_PX = 1.0
"""Maximum epipolar and reprojection error of matches, pixels (COLMAP's default is 4). If larger, slightly wrong matches
shift cameras by up to a millimetre at 320x240; if smaller, correct matches in noisy images are dropped too."""


def poses_from_pixels(
    pictures: dict[str, Picture], cameras: list[Camera], pycolmap: Any
) -> dict[str, EstimatedPose]:
    """Camera poses by structure from motion with given intrinsics, by camera id, in a world frame and scale of its own.

    Cameras that can't be placed are missing. The result is empty if there are too few points for standard errors.
    """
    with tempfile.TemporaryDirectory(prefix="stlfr-check-") as scratch_name:
        scratch = Path(scratch_name)
        names = match(pictures, cameras, scratch, pycolmap)
        model = map_cameras(scratch, mapping_options(pycolmap), pycolmap)
    if model is None:
        return {}
    matrices = {
        image.name: image.cam_from_world().matrix()
        for image in model.images.values()
        if image.has_pose
    }
    errors = standard_errors(model)
    return {
        names[name]: EstimatedPose(
            matrices[name][:, :3],
            matrices[name][:, 3],
            found.rotation_deg,
            found.centre,
            found.points,
        )
        for name, found in errors.items()
    }


def match(
    pictures: dict[str, Picture], cameras: list[Camera], scratch: Path, pycolmap: Any
) -> dict[str, str]:
    """Extracts and matches features of all pictures, into `scratch`/database.db. Returns camera ids by image name.

    pycolmap guesses the intrinsics of a camera without `params`.
    """
    (scratch / "images").mkdir()
    (scratch / "masks").mkdir()
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    names = {f"{k:04d}.png": camera["id"] for k, camera in enumerate(cameras)}
    for name, camera in zip(names, cameras, strict=True):
        picture = pictures[camera["id"]]
        pycolmap.Bitmap.from_array(picture.pixels).write(scratch / "images" / name)
        reader = pycolmap.ImageReaderOptions()
        if picture.still is not None:
            mask = np.where(picture.still, 255, 0).astype(np.uint8)
            path = scratch / "masks" / f"{name}.png"  # COLMAP's naming
            pycolmap.Bitmap.from_array(mask).write(path)
            reader.mask_path = scratch / "masks"
        reader.camera_model = camera["model"]
        if "params" in camera:
            reader.camera_params = ",".join(repr(float(p)) for p in camera["params"])
        pycolmap.extract_features(
            scratch / DATABASE,
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
        scratch / DATABASE,
        matching_options=matching,
        verification_options=verification,
        device=pycolmap.Device.cpu,
    )
    return names


def map_cameras(scratch: Path, options: Any, pycolmap: Any) -> Any:
    """Runs incremental mapping on the matches that `match` wrote into the folder `scratch`.

    Returns the reconstruction with the most cameras, or None if no two cameras can be placed.
    """
    models = pycolmap.incremental_mapping(
        scratch / DATABASE, scratch / "images", scratch, options
    )
    return max(models.values(), key=lambda m: m.num_reg_images(), default=None)


def mapping_options(pycolmap: Any) -> Any:
    """Options of incremental mapping: fixed intrinsics, and minimum triangulation angles for cameras close together."""
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
