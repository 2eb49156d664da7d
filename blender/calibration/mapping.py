"""Where pycolmap puts the cameras from images alone: SIFT, exhaustive matching, incremental mapping.

The same images give the same poses each time: seeds are fixed and pycolmap runs on one thread
wherever threads would change the order of its sums.
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
"""COLMAP's database in a scratch folder."""

MAX_ERROR_PX = 1.0
"""Matches further off are dropped (COLMAP's own limit is 4). Larger, and slightly wrong matches pull
cameras by up to a millimetre at 320x240; smaller, and right matches go too where images are noisy."""


def poses_from_pixels(
    pictures: dict[str, Picture], cameras: list[Camera], pycolmap: Any
) -> dict[str, EstimatedPose]:
    """Structure from motion with the intrinsics given; world and scale are its own. Cameras it can't place are missing, all of them where there is too little to tell how well."""
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
    """Features of all pictures and their matches, in `scratch`/database.db; gives the camera's id by image name.

    A camera without `params` has unknown intrinsics.
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
    """The reconstruction with the most cameras, of what `match` left in `scratch`; None without any."""
    models = pycolmap.incremental_mapping(
        scratch / DATABASE, scratch / "images", scratch, options
    )
    return max(models.values(), key=lambda m: m.num_reg_images(), default=None)


def mapping_options(pycolmap: Any) -> Any:
    """Options of incremental mapping that accept the small angles of a tightly packed rig."""
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
