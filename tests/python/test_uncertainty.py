"""The standard errors of the calibration check, against actual errors of bundle adjustments with known noise."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest
import test_check  # noqa: F401 - loads the packages

pycolmap = pytest.importorskip("pycolmap")
calibration = importlib.import_module("stlfr_calibration.capture")
residuals = importlib.import_module("stlfr_calibration.residuals")
uncertainty = importlib.import_module("stlfr_calibration.uncertainty")

SEEDS, NOISE_PX = 12, 0.5


def poses(model: Any) -> dict[str, Any]:
    """The estimated poses of a reconstruction's images with their standard errors, by image name."""
    errors = uncertainty.standard_errors(model)
    matrices = {i.name: i.cam_from_world().matrix() for i in model.images.values()}
    return {
        name: calibration.EstimatedPose(
            matrix[:, :3],
            matrix[:, 3],
            errors[name].rotation_deg,
            errors[name].centre,
            errors[name].points,
        )
        for name, matrix in matrices.items()
    }


@pytest.fixture(scope="module")
def found() -> list[Any]:
    """The residuals of cameras after bundle adjustment to noisy projections of points in these cameras."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 6, 1, 80
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev = NOISE_PX
    adjusting = pycolmap.BundleAdjustmentOptions()
    adjusting.refine_focal_length = adjusting.refine_extra_params = False
    adjusting.refine_principal_point = False
    adjusting.print_summary = False
    result: list[Any] = []
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    for seed in range(SEEDS):
        pycolmap.set_random_seed(seed)
        model = pycolmap.synthesize_dataset(options)
        right = poses(model)
        pycolmap.synthesize_noise(noise, model)
        pycolmap.bundle_adjustment(model, adjusting)
        result += residuals.residuals(right, poses(model))
    return result


@pytest.mark.parametrize(
    ("of", "by"),
    [
        ("rotation_deg", "rotation_std_err_deg"),
        ("position_mm", "position_std_err_mm"),
    ],
)
def test_standard_errors_are_what_noise_does(found: Any, of: str, by: str) -> None:
    """A vector with the standard deviation s along its worst axis has a root mean square length of s to s sqrt(3)."""
    ratios = np.array([getattr(r, of) / getattr(r, by) for r in found])
    print(f"{of}: {np.sqrt(np.mean(ratios**2)):.2f} standard errors, rms")
    assert 0.9 < np.sqrt(np.mean(ratios**2)) < 1.8
    assert np.mean(ratios > residuals.STANDARD_ERRORS) < 0.01


def test_too_few_points_give_no_standard_errors() -> None:
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 2, 1, 4
    assert uncertainty.standard_errors(pycolmap.synthesize_dataset(options)) == {}
