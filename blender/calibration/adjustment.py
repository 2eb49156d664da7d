"""Bundle adjustment with priors on the lenses: optimizes all cameras, lenses and points together, with a robust loss.

pycolmap's bundle adjustment has no priors. If all cameras look in the same direction, the images hardly determine the
focal length. So this module has its own damped Gauss-Newton steps, with points eliminated. Its priors keep lens
parameters near their given values where the images don't determine them. pycolmap matches and triangulates the points.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .capture import Array, Camera, pose_of
from .linear import Linearization, directions, linearized
from .mapping import DATABASE, MAX_ERROR_PX, mapping_options
from .uncertainty import JointCovariance, StandardErrors, errors_of, inverse

FIRST_ERROR_PX = 8.0
"""Maximum reprojection error of matches before the first adjustment, pixels. If larger, wrong matches bias the cameras;
if smaller, a given calibration with errors of some pixels loses correct matches."""

LOSS_STD_ERRS = 2.0
"""Reprojection error at which the robust loss turns from quadratic to linear, in standard deviations. If larger, wrong
matches bias the cameras; if smaller, correct matches get too little weight."""

MIN_NOISE_PX = 0.02
"""Lower bound of the features' estimated standard deviation, pixels. If larger, accurate features get too little
weight; if smaller, rounding errors pass for precision."""

MAX_STEPS = 50
DONE_PX = 1e-5
"""The adjustment ends when a step reduces the root mean square reprojection error by less than about this, pixels."""


@dataclass(frozen=True)
class Priors:
    """Standard deviations of the priors on lens parameters. None fixes a group of parameters at its given values.

    `focal_fraction` is a fraction of the focal length; `distortion` is that of each distortion coefficient.
    """

    focal_fraction: float | None = None
    centre_px: float | None = None
    distortion: float | None = None

    @property
    def refined(self) -> tuple[str, ...]:
        """The groups of lens parameters that are not fixed, of `focal`, `centre` and `distortion`, in this order."""
        groups = {
            "focal": self.focal_fraction,
            "centre": self.centre_px,
            "distortion": self.distortion,
        }
        return tuple(name for name, std in groups.items() if std is not None)

    def stds(self, lens: Any) -> Array:
        """The prior's standard deviation of each refined parameter of the pycolmap camera `lens`, ordered as `refined`.

        The focal length is one parameter, a factor on `fx` and `fy` together.
        """
        counts = {"focal": 1, "centre": 2, "distortion": len(lens.extra_params_idxs())}
        stds = {
            "focal": self.focal_fraction,
            "centre": self.centre_px,
            "distortion": self.distortion,
        }
        values = [[stds[group]] * counts[group] for group in self.refined]
        return np.array([value for group in values for value in group], dtype=float)


class Adjustment:
    """Maximum a posteriori estimate of cameras, lenses and points; changes pycolmap's reconstruction `model` in place.

    The world's position, rotation and scale are not fixed.
    """

    def __init__(self, model: Any, given: dict[int, Array], priors: Priors) -> None:
        """`given` has the lens parameters at the maximum of the priors, by pycolmap's camera id."""
        self.model, self.given, self.priors = model, given, priors
        self.covariance: JointCovariance | None = None
        """The joint covariance of all cameras; None until `run` has adjusted them."""

    def run(self, pycolmap: Any) -> dict[str, StandardErrors]:
        """Adjusts the model and sets `covariance`. Returns standard errors by image name.

        The result is empty, and the model unchanged, if the points are too few to determine the cameras.
        """
        damping = 1e-6
        linear = linearized(self.model, self.priors.refined)
        if linear.redundancy <= 0:
            return {}
        noise_px = self.noise_px(linear)
        cost = self.cost(linear, noise_px)
        for _ in range(MAX_STEPS):
            before = self.state()
            self.step(linear, noise_px, damping, pycolmap)
            stepped = linearized(self.model, self.priors.refined)
            new_cost = self.cost(stepped, noise_px)
            if not new_cost < cost:
                self.restore(before)
                if damping > 1.0:
                    break
                damping *= 100.0
                continue
            gain_px2 = (cost - new_cost) * noise_px**2 / len(linear.camera)
            linear, damping = stepped, max(1e-9, damping / 10.0)
            noise_px = self.noise_px(linear)
            cost = self.cost(linear, noise_px)
            if gain_px2 < DONE_PX * noise_px:
                break
        # The median ignores the tails of the error distribution; the standard errors must include them.
        spread_px = np.sqrt(np.sum(linear.errors_px**2) / linear.redundancy)
        information, _ = self.normal(linear, max(noise_px, float(spread_px)))
        covariance = inverse(linear, information)
        names = [image.name for image in linear.images]
        self.covariance = JointCovariance(names, linear.refined, covariance)
        return errors_of(linear, covariance)

    @staticmethod
    def noise_px(linear: Linearization) -> float:
        """Robust standard deviation of the reprojection error in one coordinate, from the median absolute error."""
        lost = np.sqrt(2 * len(linear.errors_px) / linear.redundancy)
        median = float(np.median(np.abs(linear.errors_px)))
        return max(MIN_NOISE_PX, 1.4826 * median * float(lost))

    def cost(self, linear: Linearization, noise_px: float) -> float:
        """The negative logarithm of the posterior (robust reprojection errors and lens priors), up to a constant."""
        loss = (LOSS_STD_ERRS * noise_px) ** 2
        squares = np.sum(linear.errors_px**2, axis=1)
        data = float(np.sum(2 * loss * (np.sqrt(1 + squares / loss) - 1)))
        deviations = self.deviations(linear)
        return 0.5 * data / noise_px**2 + 0.5 * float(np.sum(deviations**2))

    def deviations(self, linear: Linearization) -> Array:
        """Differences of the refined lens parameters from the given ones, in standard deviations; a row per image."""
        rows = []
        for image in linear.images:
            lens = self.model.cameras[image.camera_id]
            moves = directions(lens, self.priors.refined)
            change = np.array(lens.params) - self.given[image.camera_id]
            along = [m @ change / (m @ m) if m @ m > 0 else 0.0 for m in moves]
            rows.append(np.array(along) / self.priors.stds(lens))
        return np.array(rows)

    def weights(self, linear: Linearization, noise_px: float) -> Array:
        """The weight of each observation (row of `linear`) under the soft L1 loss, for reweighted least squares."""
        loss = (LOSS_STD_ERRS * noise_px) ** 2
        squares = np.sum(linear.errors_px**2, axis=1)
        return np.asarray(1 / np.sqrt(1 + squares / loss))

    def normal(self, linear: Linearization, noise_px: float) -> tuple[Array, Array]:
        """The information matrix and gradient of all cameras' parameters: points are eliminated, priors are added."""
        information, gradient = linear.reduced(self.weights(linear, noise_px))
        information, gradient = information / noise_px**2, gradient / noise_px**2
        deviations = self.deviations(linear)
        for k, image in enumerate(linear.images):
            stds = self.priors.stds(self.model.cameras[image.camera_id])
            own = np.arange(len(stds)) + linear.size * k + 6
            information[own, own] += 1 / stds**2
            gradient[own] += deviations[k] / stds
        return information, gradient

    def step(
        self, linear: Linearization, noise_px: float, damping: float, pycolmap: Any
    ) -> None:
        """Takes one damped Gauss-Newton (Levenberg-Marquardt) step: changes the model's points, poses and lenses."""
        information, gradient = self.normal(linear, noise_px)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
        scaled = information / np.outer(scale, scale)
        damped = scaled + damping * np.eye(len(scale))
        change = -np.linalg.lstsq(damped, gradient / scale, rcond=1e-14)[0] / scale
        moves = linear.moved_points(self.weights(linear, noise_px), change)
        for point_id, move in zip(linear.point_ids, moves, strict=True):
            self.model.points3D[point_id].xyz += move
        for image, own in zip(
            linear.images, change.reshape(-1, linear.size), strict=True
        ):
            matrix = image.cam_from_world().matrix()
            turn = pycolmap.Rotation3d(-own[:3]).matrix()
            centre = image.projection_center() + own[3:6]
            set_pose(self.model, image, matrix[:, :3] @ turn, centre, pycolmap)
            lens = self.model.cameras[image.camera_id]
            moved = own[6:] @ directions(lens, self.priors.refined)
            lens.params = np.array(lens.params) + moved

    def state(self) -> Any:
        """A copy of all that a step changes: the points' positions, images' poses and lens parameters, by id."""
        model = self.model
        return (
            {i: np.array(point.xyz) for i, point in model.points3D.items()},
            {i: image.cam_from_world() for i, image in model.images.items()},
            {i: np.array(lens.params) for i, lens in model.cameras.items()},
        )

    def restore(self, state: Any) -> None:
        """Sets the model back to a `state` from before a step."""
        points, poses, lenses = state
        for i, xyz in points.items():
            self.model.points3D[i].xyz = xyz
        for i, pose in poses.items():
            self.model.frames[self.model.images[i].frame_id].rig_from_world = pose
        for i, params in lenses.items():
            self.model.cameras[i].params = params


def set_pose(
    model: Any, image: Any, rotation: Array, centre: Array, pycolmap: Any
) -> None:
    """Sets the pose of an image in pycolmap's `model`, by the rotation from world to camera and the camera's centre."""
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)
    model.frames[image.frame_id].rig_from_world = pose


def drop_outliers(model: Any, max_error_px: float) -> None:
    """Deletes observations with larger reprojection errors, and points that fewer than two cameras then see."""
    off = []
    for image in model.images.values():
        for index, point in enumerate(image.points2D):
            if not point.has_point3D():
                continue
            found = image.project_point(model.points3D[point.point3D_id].xyz)
            if found is None or np.linalg.norm(found - point.xy) > max_error_px:
                off.append((image.image_id, index))
    for image_id, index in off:
        # pycolmap deletes a point, with its last observation, when only one would remain.
        if model.images[image_id].points2D[index].has_point3D():
            model.delete_observation(image_id, index)


def placed(scratch: Path, cameras: list[Camera], pycolmap: Any) -> Any:
    """A pycolmap reconstruction without points, with the poses and lenses of `cameras`.

    Its images are those in the database that `match` wrote into the folder `scratch`, in the order of `cameras`.
    """
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(scratch / DATABASE) as database:
        images = sorted(database.read_all_images(), key=lambda image: image.name)
        for image, camera in zip(images, cameras, strict=True):
            lens = database.read_camera(image.camera_id)
            lens.params = camera["params"]
            model.add_camera_with_trivial_rig(lens)
            pose = pose_of(camera, pycolmap)
            cam_from_world = pycolmap.Rigid3d(
                pycolmap.Rotation3d(pose.rotation), pose.translation_m
            )
            bare = pycolmap.Image(
                name=image.name, camera_id=image.camera_id, image_id=image.image_id
            )
            model.add_image_with_trivial_frame(bare, cam_from_world)
    return model


def triangulated(model: Any, scratch: Path, max_error_px: float, pycolmap: Any) -> Any:
    """The reconstruction with points triangulated anew from its poses, up to this reprojection error."""
    options = mapping_options(pycolmap)
    options.mapper.filter_max_reproj_error = max_error_px
    options.triangulation.complete_max_reproj_error = max_error_px
    options.triangulation.merge_max_reproj_error = max_error_px
    return pycolmap.triangulate_points(
        model,
        scratch / DATABASE,
        scratch / "images",
        scratch,
        clear_points=True,
        options=options,
    )


def adjusted(
    scratch: Path,
    cameras: list[Camera],
    priors: Priors,
    pycolmap: Any,
) -> tuple[Any, dict[str, StandardErrors], JointCovariance | None]:
    """The reconstruction after bundle adjustment of the given cameras, standard errors by image name, and covariance.

    The matches are read from the database that `match` wrote into the folder `scratch`. If there are too few points,
    the standard errors are empty and the covariance is None.

    The priors' means are a camera's `expected` lens parameters, by default its `params`.
    """
    model = placed(scratch, cameras, pycolmap)
    names = {image.name: image.camera_id for image in model.images.values()}
    given = {
        lens_id: np.array(camera.get("expected", camera["params"]), dtype=float)
        for (_, lens_id), camera in zip(sorted(names.items()), cameras, strict=True)
    }
    errors: dict[str, StandardErrors] = {}
    for max_error_px in (FIRST_ERROR_PX, 2.0 * MAX_ERROR_PX, MAX_ERROR_PX):
        model = triangulated(model, scratch, max_error_px, pycolmap)
        drop_outliers(model, max_error_px)
        errors = Adjustment(model, given, priors).run(pycolmap)
        if not errors:
            return model, errors, None
    drop_outliers(model, MAX_ERROR_PX)
    last = Adjustment(model, given, priors)
    errors = last.run(pycolmap)
    return model, errors, last.covariance
