"""Calibrations from the static background: `stlfr calibrate` and `stlfr refine`."""

from __future__ import annotations

import importlib
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import test_check  # noqa: F401 - loads the packages

pycolmap = pytest.importorskip("pycolmap")
files = importlib.import_module("stlfr_calibration.capture")
adjustment = importlib.import_module("stlfr_calibration.adjustment")
background = importlib.import_module("stlfr_calibration.background")
estimation = importlib.import_module("stlfr_calibration.estimation")
residuals = importlib.import_module("stlfr_calibration.residuals")

Array = np.ndarray[Any, Any]

SIZE, FOCAL_PX, FRAMES = (240, 180), 260.0, 5
IDS = [f"cam{k}" for k in range(4)]


# Parts


class Passing:
    """A fake capture: a white square passes in front of a static gradient; at the left, a square flickers."""

    def times(self, _camera_id: str) -> Array:
        return np.arange(9) / 30.0

    def frame(self, _camera_id: str, index: int) -> Array:
        image = np.tile(np.linspace(40, 90, 160, dtype=np.uint8), (120, 1))
        image[50:60, 60 + 10 * index : 70 + 10 * index] = 255
        image[80:100, 5:25] = 25 * index
        return image[:, :, None]


def test_the_background_is_what_stands_still() -> None:
    picture = background.background(Passing(), "a")
    right = np.tile(np.linspace(40, 90, 160, dtype=np.uint8), (120, 1))
    assert not picture.still[80:100, 5:25].any()
    assert picture.still[:70].all(), "what passes is gone from the median"
    np.testing.assert_array_equal(picture.pixels[:70, :, 0], right[:70])


def synthetic(seed: int) -> Any:
    """A pycolmap reconstruction of six cameras around random points, with noise of half a pixel."""
    pycolmap.set_random_seed(seed)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 6, 1, 200
    model = pycolmap.synthesize_dataset(options)
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev = 0.5
    pycolmap.synthesize_noise(noise, model)
    return model


def lens_params(model: Any) -> dict[int, Array]:
    return {i: np.array(lens.params) for i, lens in model.cameras.items()}


def test_adjustment_finds_focal_lengths_within_their_standard_errors() -> None:
    ratios: list[float] = []
    for seed in range(4):
        model = synthetic(seed)
        right = lens_params(model)
        for lens in model.cameras.values():
            params = np.array(lens.params)
            params[lens.focal_length_idxs()] *= 1.03
            lens.params = params
        wrong = lens_params(model)
        priors = adjustment.Priors(focal_fraction=0.3)
        errors = adjustment.Adjustment(model, wrong, priors).run(pycolmap)
        for image in model.images.values():
            lens_id = image.camera_id
            off = model.cameras[lens_id].params[0] / right[lens_id][0] - 1
            assert abs(off) < 0.02
            ratios.append(off / errors[image.name].focal_fraction)
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.7


def rotations(model: Any) -> dict[str, Array]:
    return {
        image.name: image.cam_from_world().rotation.matrix()
        for image in model.images.values()
    }


def test_the_joint_covariance_is_what_noise_does() -> None:
    """Checks rotations between cameras, which don't depend on the gauge; also in another world and camera order."""
    squares = []
    for seed in range(4):
        model = synthetic(seed)
        right = rotations(model)
        priors = adjustment.Priors(focal_fraction=0.3)
        adjusting = adjustment.Adjustment(model, lens_params(model), priors)
        adjusting.run(pycolmap)
        found, joint = rotations(model), adjusting.covariance
        names = joint.names[::-1]
        world = pycolmap.Rotation3d(np.array([0.3, -0.5, 0.9])).matrix()
        entry = joint.entry(names, world, 0.1)
        assert entry["lens"] == ["focal"]
        lower = np.zeros((7 * len(names), 7 * len(names)))
        for k, row in enumerate(entry["rows"]):
            assert len(row) == k + 1
            lower[k, : k + 1] = row
        matrix = lower + np.tril(lower, -1).T
        values = np.linalg.eigvalsh(matrix / np.outer(*[np.sqrt(np.diag(matrix))] * 2))
        assert values[0] > -1e-6 and np.sum(values < 1e-6) == 7
        for k in range(1, len(names)):
            a, b = names[0], names[k]
            turned = right[b].T @ found[b] @ found[a].T @ right[a]
            skew: Any = 0.5 * (turned - turned.T)
            turn = world @ np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
            pick = np.zeros((3, len(matrix)))
            pick[:, :3], pick[:, 7 * k : 7 * k + 3] = np.eye(3), -np.eye(3)
            expected = pick @ matrix @ pick.T
            squares.append(turn @ np.linalg.solve(expected, turn) / 3)
    assert 0.5 < np.sqrt(np.mean(squares)) < 1.7


@pytest.mark.parametrize("distortion", [None, 0.1])
def test_focal_lengths_that_are_given_stay(distortion: float | None) -> None:
    """The focal length stays exact, even if distortion is estimated."""
    model = synthetic(1)
    given = lens_params(model)
    priors = adjustment.Priors(distortion=distortion)
    errors = adjustment.Adjustment(model, given, priors).run(pycolmap)
    assert len(errors) == 6
    assert all(e.focal_fraction == 0.0 for e in errors.values())
    for lens_id, params in lens_params(model).items():
        np.testing.assert_array_equal(params[:3], given[lens_id][:3])
        stays = params[3] == given[lens_id][3]
        assert stays == (distortion is None)


def test_a_strong_prior_holds_a_lens() -> None:
    model = synthetic(2)
    given = {i: params * 1.0 for i, params in lens_params(model).items()}
    for params in given.values():
        params[0] *= 1.03
    for lens_id, lens in model.cameras.items():
        lens.params = given[lens_id]
    adjustment.Adjustment(model, given, adjustment.Priors(1e-7)).run(pycolmap)
    for lens_id, params in lens_params(model).items():
        assert params[0] == pytest.approx(given[lens_id][0], rel=1e-4)


def test_without_points_nothing_is_known() -> None:
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 2, 1, 4
    model = pycolmap.synthesize_dataset(options)
    run = adjustment.Adjustment(model, lens_params(model), adjustment.Priors(0.1)).run
    assert run(pycolmap) == {}


def test_outliers_are_dropped_and_nothing_else() -> None:
    pycolmap.set_random_seed(5)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 4, 1, 50
    model = pycolmap.synthesize_dataset(options)
    sights = sum(image.num_points3D for image in model.images.values())
    image = model.images[1]
    index = next(k for k, p in enumerate(image.points2D) if p.has_point3D())
    image.points2D[index].xy = image.points2D[index].xy + np.array([5.0, 0.0])
    adjustment.drop_outliers(model, 1.0)
    assert not model.images[1].points2D[index].has_point3D()
    assert sum(i.num_points3D for i in model.images.values()) == sights - 1


def test_the_scale_is_a_distances_or_said_to_be_arbitrary() -> None:
    poses = {
        name: files.Pose(np.eye(3), np.array([-3.0 * k, 0.0, 0.0]))
        for k, name in enumerate(IDS)
    }
    scale, notes = estimation.world_scale(poses, ("cam0", "cam3", 0.45))
    assert scale == pytest.approx(0.05) and notes == []
    scale, notes = estimation.world_scale(poses, None)
    assert scale == pytest.approx(1 / 3) and "--distance" in notes[0]
    similarity = estimation.upright(poses, scale)
    centres = np.array([similarity.pose(pose).centre_m for pose in poses.values()])
    np.testing.assert_allclose(centres[:, 0], [-1.5, -0.5, 0.5, 1.5], atol=1e-12)
    same = {name: files.Pose(np.eye(3), np.zeros(3)) for name in IDS}
    with pytest.raises(files.CheckError, match="at one place"):
        estimation.world_scale(same, None)


# Recordings


def texture(seed: int) -> Array:
    """A texture of random blobs of several sizes, 1200x1200."""
    random = np.random.default_rng(seed)
    total: Array = np.zeros((1200, 1200))
    for cell, weight in ((6, 1.0), (15, 1.0), (50, 1.5)):
        coarse = random.uniform(0, 1, (1200 // cell + 2, 1200 // cell + 2))
        at = np.arange(1200) / cell
        low = at.astype(int)
        part = at - low
        rows = coarse[low] * (1 - part)[:, None] + coarse[low + 1] * part[:, None]
        total += weight * (rows[:, low] * (1 - part) + rows[:, low + 1] * part)
    return 255 * (total - total.min()) / (total.max() - total.min())


def true_pose(k: int) -> Any:
    """The true pose of camera `k`: cameras are 8 cm apart and look at a point 1.7 m away."""
    centre = np.array([0.08 * (k - 1.5), 0.01 * (k % 2), 0.0])
    forward = np.array([0.0, 0.0, 1.7]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    return files.Pose(rotation, -rotation @ centre)


def seen(pose: Any, walls: list[tuple[Array, float, float]]) -> Array:
    """The image of textured walls in a pinhole camera. A wall has its texture, its depth, and the x of its left edge.

    Later walls are nearer.
    """
    width, height = SIZE
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack(
        [(u - width / 2) / FOCAL_PX, (v - height / 2) / FOCAL_PX, u * 0 + 1]
    )
    ways = np.tensordot(pose.rotation.T, rays, axes=1)
    image: Array = np.zeros((height, width))
    for pattern, depth_m, from_m in walls:
        x, y = (pose.centre_m[a] + ways[a] / ways[2] * depth_m for a in (0, 1))
        column, row = 400 * x + 600, 400 * y + 600
        c, r = column.astype(int), row.astype(int)
        p, q = column - c, row - r
        value = (pattern[r, c] * (1 - p) + pattern[r, c + 1] * p) * (1 - q)
        value += (pattern[r + 1, c] * (1 - p) + pattern[r + 1, c + 1] * p) * q
        image = np.where(x > from_m, value, image)
    return image


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders with frames of four cameras; an object passes in front of the walls, at another time in each."""
    folder = tmp_path_factory.mktemp("recordings")
    walls = [(texture(1), 2.0, -9.0), (texture(2), 1.4, 0.1)]
    for k, name in enumerate(IDS):
        (folder / name).mkdir()
        still = seen(true_pose(k), walls)
        for frame in range(FRAMES):
            image = still.copy()
            left = 20 + 30 * frame + 7 * k
            image[70:100, left : left + 25] = 255 - 30 * frame
            pixels = np.repeat((image + 0.5).astype(np.uint8)[:, :, None], 3, axis=2)
            pycolmap.Bitmap.from_array(pixels).write(folder / name / f"{frame:04d}.png")
    return folder


def run(program: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [program, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def cameras_of(folder: Path) -> list[dict[str, Any]]:
    cameras: list[dict[str, Any]] = json.loads((folder / "capture.json").read_text())[
        "cameras"
    ]
    return cameras


def off(folder: Path) -> list[Any]:
    """The residuals of a capture's camera poses from the true ones, after alignment."""
    estimated = {}
    for camera in cameras_of(folder):
        pose = files.pose_of(camera, pycolmap)
        estimated[camera["id"]] = files.EstimatedPose(pose.rotation, pose.translation_m)
    found: list[Any] = residuals.residuals(
        {name: true_pose(k) for k, name in enumerate(IDS)}, estimated
    )
    return found


@pytest.fixture(scope="module")
def calibrated(
    program: Path, recordings: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The capture that `stlfr calibrate` makes, given the true focal length and a distance."""
    output = tmp_path_factory.mktemp("calibrated") / "capture"
    ended = run(
        program, "calibrate", recordings, "--rate", 30, "--lens", "PINHOLE", "--focal",
        FOCAL_PX, "--distance", "cam0", "cam2", 0.16, "-o", output,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert "cam3" in ended.stdout and "points that stand still" in ended.stdout
    assert list(output.parent.iterdir()) == [output], "no draft is left"
    return output


def test_recordings_without_a_calibration_become_a_capture(
    calibrated: Path, recordings: Path
) -> None:
    for residual in off(calibrated):
        assert residual.rotation_deg < 0.1 and residual.position_mm < 2.0, residual
    cameras = cameras_of(calibrated)
    assert [c["id"] for c in cameras] == IDS
    assert [c["clock"] for c in cameras] == 4 * [
        {"rate_hz": 30.0, "first_s": 0.0, "shared": False}
    ]
    poses = [files.pose_of(c, pycolmap) for c in cameras]
    apart = np.linalg.norm(poses[0].centre_m - poses[2].centre_m)
    assert apart == pytest.approx(0.16, abs=1e-9)
    for camera in cameras:
        assert camera["params"][:2] == [FOCAL_PX, FOCAL_PX]
        for frame in range(FRAMES):
            copied = calibrated / (camera["frames"] % frame)
            original = recordings / camera["id"] / f"{frame:04d}.png"
            assert copied.read_bytes() == original.read_bytes()


def test_the_same_recordings_give_the_same_calibration(
    program: Path, calibrated: Path, recordings: Path, tmp_path: Path
) -> None:
    """The result is also the same if the input is a capture, whose own calibration is ignored."""
    output = tmp_path / "capture"
    ended = run(
        program, "calibrate", calibrated, "--lens", "PINHOLE", "--focal", FOCAL_PX,
        "--distance", "cam0", "cam2", 0.16, "-o", output,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert cameras_of(output) == cameras_of(calibrated)


def test_refining_mends_a_calibration_that_is_off(
    program: Path, calibrated: Path, tmp_path: Path
) -> None:
    wrong = tmp_path / "wrong"
    (wrong).mkdir()
    for name in IDS:
        (wrong / name).symlink_to(calibrated / name)
    described = json.loads((calibrated / "capture.json").read_text())
    random = np.random.default_rng(3)
    for k, camera in enumerate(described["cameras"]):
        right = true_pose(k)
        turn = pycolmap.Rotation3d(np.radians(0.3) * random.normal(size=3)).matrix()
        rotation = turn @ right.rotation
        centre = right.centre_m + 0.003 * random.normal(size=3)
        x, y, z, w = pycolmap.Rotation3d(rotation).quat
        camera["cam_from_world"] = {
            "rotation_wxyz": [w, x, y, z],
            "translation": list(-rotation @ centre),
        }
        camera["params"][:2] = 2 * [FOCAL_PX * (1.005 if k % 2 else 0.995)]
        # Links that lead out of a capture are refused: the frames are copied.
        (wrong / camera["id"]).unlink()
        (wrong / camera["id"]).mkdir()
        for file in (calibrated / camera["id"]).iterdir():
            (wrong / camera["id"] / file.name).write_bytes(file.read_bytes())
    text = json.dumps(described)
    (wrong / "capture.json").write_text(text)
    output = tmp_path / "refined"
    poses = run(program, "refine", wrong, "-o", tmp_path / "poses")
    assert poses.returncode == 0 and "give --focal" in poses.stderr
    exact = [camera["params"] for camera in cameras_of(tmp_path / "poses")]
    assert exact == [camera["params"] for camera in described["cameras"]]
    ended = run(program, "refine", wrong, "--focal", "-o", output)
    assert ended.returncode == 0, ended.stderr
    assert "turned by" in ended.stdout
    assert (wrong / "capture.json").read_text() == text, "the given one stays"
    before = max(r.rotation_deg for r in off(wrong))
    after = max(r.rotation_deg for r in off(output))
    assert before > 0.2 and after < 0.1, (before, after)
    focal = [camera["params"][0] for camera in cameras_of(output)]
    assert np.ptp(focal) < 0.003 * FOCAL_PX
    assert "Focal lengths are taken as exact" not in ended.stderr
    # The array keeps its given position, orientation and size, within the errors of the few cameras.
    places = [
        [files.pose_of(c, pycolmap).centre_m for c in cameras_of(folder)]
        for folder in (wrong, output)
    ]
    assert np.abs(np.mean(places[0], axis=0) - np.mean(places[1], axis=0)).max() < 0.01


def refused(ended: subprocess.CompletedProcess[str], code: int, words: str) -> None:
    assert ended.returncode == code, ended.stderr
    assert words in ended.stderr.splitlines()[-1], ended.stderr
    assert ended.stdout == ""


def test_failures_are_a_sentence_that_names_the_camera(
    program: Path, recordings: Path, tmp_path: Path
) -> None:
    plain, other = tmp_path / "plain", tmp_path / "other"
    flat = np.full((SIZE[1], SIZE[0], 3), 90, dtype=np.uint8)
    elsewhere = seen(true_pose(0), [(texture(9), 2.0, -9.0)])
    strange = np.repeat(elsewhere.astype(np.uint8)[:, :, None], 3, axis=2)
    for folder, image in ((plain, flat), (other, strange)):
        for name in IDS:
            (folder / name).mkdir(parents=True)
            for file in (recordings / name).iterdir():
                (folder / name / file.name).write_bytes(file.read_bytes())
        for frame in range(FRAMES):
            path = folder / "cam1" / f"{frame:04d}.png"
            pycolmap.Bitmap.from_array(image).write(path)
    ended = run(program, "calibrate", plain, "--rate", 30, "-o", tmp_path / "a")
    refused(ended, 1, "cam1 shows 0 features on what stands still")
    ended = run(program, "calibrate", other, "--rate", 30, "-o", tmp_path / "a")
    refused(
        ended, 1, "no other camera shows enough of the still things that cam1 shows"
    )
    assert not (tmp_path / "a").exists()
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ["other", "plain"]


def test_wrong_requests_are_refused_before_long_work(
    program: Path, recordings: Path, calibrated: Path, tmp_path: Path
) -> None:
    output = tmp_path / "capture"
    for arguments, words in (
        ((recordings,), "give --rate or --times"),
        ((recordings, "--rate", 0), "--rate must be positive"),
        ((recordings, "--rate", 30, "--focal", "nan"), "--focal"),
        ((recordings, "--rate", 30, "--distance", "cam0", "cam0", 1), "two cameras"),
        ((recordings, "--rate", 30, "--distance", "cam0", "cam9", 1), "'cam9'"),
        ((recordings, "--rate", 30, "--distance", "cam0", "cam1", 0), "--distance"),
        ((calibrated, "--rate", 30), "a capture has its clocks"),
        ((tmp_path,), "holds 0 videos and folders of images"),
        ((tmp_path / "nowhere",), "nowhere"),
    ):
        refused(run(program, "calibrate", *arguments, "-o", output), 2, words)
        assert not output.exists()
    for command in (["calibrate"], ["refine", "--focal"]):
        ended = run(program, *command, calibrated, "-o", calibrated)
        refused(ended, 2, str(calibrated))
    refused(run(program, "refine", recordings, "-o", output), 2, "capture.json")
    assert list(tmp_path.iterdir()) == []
