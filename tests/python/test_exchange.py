"""Calibrations that `stlfr export` writes for other programs, read by pycolmap."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pycolmap = pytest.importorskip("pycolmap")


def run(program: Path, *arguments: object) -> None:
    """Run the program; it must succeed."""
    subprocess.run([program, *map(str, arguments)], check=True, timeout=120)


def colmap_cameras(folder: Path) -> dict[str, tuple[Any, Any]]:
    """The lens and the 3x4 matrix cam_from_world of each image, as pycolmap reads them, by image name."""
    model = pycolmap.Reconstruction(folder)
    return {
        image.name: (model.cameras[image.camera_id], image.cam_from_world().matrix())
        for image in model.images.values()
    }


@pytest.mark.parametrize("file_format", ["colmap", "colmap-text"])
def test_pycolmap_reads_what_we_export(
    program: Path, capture_dir: Path, tmp_path: Path, file_format: str
) -> None:
    run(program, "export", capture_dir, "--format", file_format, "-o", tmp_path)
    found = colmap_cameras(tmp_path)
    cameras = json.loads((capture_dir / "capture.json").read_text())["cameras"]
    assert set(found) == {f"{c['id']}/0000.png" for c in cameras}
    for camera in cameras:
        lens, matrix = found[f"{camera['id']}/0000.png"]
        assert (lens.model.name, lens.width, lens.height) == (
            camera["model"],
            camera["width"],
            camera["height"],
        )
        np.testing.assert_allclose(lens.params, camera["params"], rtol=1e-15)
        w, x, y, z = camera["cam_from_world"]["rotation_wxyz"]
        rotation = pycolmap.Rotation3d(np.array([x, y, z, w])).matrix()
        np.testing.assert_allclose(matrix[:, :3], rotation, rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            matrix[:, 3], camera["cam_from_world"]["translation"], rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("file_format", ["colmap", "colmap-text", "llff", "nerf"])
def test_what_is_exported_imports_as_the_same_capture(
    program: Path, capture_dir: Path, tmp_path: Path, file_format: str
) -> None:
    name = {"llff": "poses_bounds.npy", "nerf": "transforms.json"}.get(file_format, "m")
    bounds = ["--near", 1, "--far", 6] if file_format == "llff" else []
    exported, imported = tmp_path / name, tmp_path / "capture"
    command = ["export", capture_dir, "--format", file_format, "-o", exported, *bounds]
    run(program, *command)
    (tmp_path / "images").mkdir()
    cameras = json.loads((capture_dir / "capture.json").read_text())["cameras"]
    for camera in cameras:
        (tmp_path / "images" / camera["id"]).symlink_to(capture_dir / camera["id"])
    command = ["import", exported, "--images", tmp_path / "images", "--rate", 30]
    run(program, *command, "-o", imported)
    again = json.loads((imported / "capture.json").read_text())["cameras"]
    for before, after in zip(cameras, again, strict=True):
        if file_format != "llff":  # this format has no camera names
            assert after["id"] == before["id"]
        assert after["params"] == pytest.approx(before["params"], rel=1e-12)
        first, second = (c["cam_from_world"] for c in (before, after))
        assert second["translation"] == pytest.approx(first["translation"], abs=1e-12)
        alignment = np.dot(first["rotation_wxyz"], second["rotation_wxyz"])
        assert abs(alignment) == pytest.approx(1.0, abs=1e-12)
        for k in (0, 5):
            source = capture_dir / (before["frames"] % k)
            copied = imported / (after["frames"] % k)
            assert copied.read_bytes() == source.read_bytes()


def test_pycolmaps_own_files_are_read(program: Path, tmp_path: Path) -> None:
    """COLMAP's text and binary models are imported, as pycolmap writes them, with points and their observations."""
    model = pycolmap.synthesize_dataset(pycolmap.SyntheticDatasetOptions())
    images = {Path(image.name).stem: image for image in model.images.values()}
    assert all(image.num_points2D() > 0 for image in images.values())
    for name, image in images.items():
        (tmp_path / "images" / name).mkdir(parents=True)
        lens = model.cameras[image.camera_id]
        blank = np.zeros((lens.height, lens.width), np.uint8)
        path = tmp_path / "images" / name / "0.png"
        pycolmap.Bitmap.from_array(blank).write(path)
    for kind, write in (("text", model.write_text), ("binary", model.write_binary)):
        (tmp_path / kind).mkdir()
        write(tmp_path / kind)
        target = tmp_path / f"capture-{kind}"
        command = ["import", tmp_path / kind, "--images", tmp_path / "images"]
        run(program, *command, "--rate", 30, "-o", target)
        cameras = json.loads((target / "capture.json").read_text())["cameras"]
        assert {c["id"] for c in cameras} == set(images)
        for camera in cameras:
            image = images[camera["id"]]
            lens, pose = model.cameras[image.camera_id], image.cam_from_world()
            assert camera["model"] == lens.model.name
            assert camera["params"] == pytest.approx(lens.params, rel=1e-12)
            translation = camera["cam_from_world"]["translation"]
            assert translation == pytest.approx(pose.translation, abs=1e-12)
            w, x, y, z = camera["cam_from_world"]["rotation_wxyz"]
            alignment = np.dot(pose.rotation.quat, [x, y, z, w])
            assert abs(alignment) == pytest.approx(1.0, abs=1e-12)


def film_with_true_offsets(capture_dir: Path, folder: Path) -> dict[str, float]:
    """Copy a capture, and write its true offsets as if they were estimated; returns the offsets by camera id."""
    shutil.copytree(capture_dir, folder)
    truth = json.loads((folder / "truth/truth.json").read_text())
    offsets = {camera["id"]: camera["offset_s"] for camera in truth["offsets"]}
    described = json.loads((folder / "capture.json").read_text())
    ids = [camera["id"] for camera in described["cameras"]]
    reference = described.get("reference", ids[(len(ids) - 1) // 2])
    relative = {i: offsets[i] - offsets[reference] for i in ids}
    errors = {i: 0.0 if i == reference else 1e-5 for i in ids}
    cameras = [{"id": i, "offset_s": relative[i], "std_err_s": errors[i]} for i in ids]
    text = json.dumps({"reference": reference, "cameras": cameras})
    (folder / "offsets.json").write_text(text)
    return relative


def test_pycolmap_reads_synchronized_images_as_frames_of_a_rig(
    program: Path, capture_dir: Path, tmp_path: Path
) -> None:
    film, out = tmp_path / "film", tmp_path / "out"
    film_with_true_offsets(capture_dir, film)
    instants = ["--times", "0.07:0.1:2", "--set", "sync=crossfade"]
    command = ["export", film, "--synchronized", "--format", "colmap", *instants]
    run(program, *command, "-o", out)
    model = pycolmap.Reconstruction(out / "sparse/0")
    cameras = json.loads((film / "capture.json").read_text())["cameras"]
    assert (model.num_rigs(), model.num_frames()) == (1, 2)
    assert model.num_images() == 2 * len(cameras)
    poses = {c["id"]: c["cam_from_world"] for c in cameras}
    for image in model.images.values():
        assert (out / "images" / image.name).is_file()
        # The pose is that of the frame and the rig.
        expected = poses[image.name.split("/")[0]]
        found = image.cam_from_world()
        np.testing.assert_allclose(
            found.translation, expected["translation"], rtol=0, atol=1e-9
        )
    frames = [{data.id for data in frame.data_ids} for frame in model.frames.values()]
    assert [len(frame) for frame in frames] == [len(cameras)] * 2
    assert not frames[0] & frames[1]


def test_filmed_frames_have_colmap4ds_times(
    program: Path, capture_dir: Path, tmp_path: Path
) -> None:
    """The file follows colmap4d's specification 1.0: a count, then each image's number and its time in nanoseconds."""
    film, out = tmp_path / "film", tmp_path / "out"
    offsets = film_with_true_offsets(capture_dir, film)
    run(program, "export", film, "--frames", "--format", "colmap", "-o", out)
    model = pycolmap.Reconstruction(out / "sparse/0")
    data = (out / "sparse/0/times.bin").read_bytes()
    (count,) = struct.unpack_from("<Q", data)
    times = dict(struct.iter_unpack("<Iq", data[8:]))
    assert len(times) == count == model.num_images()
    clocks = {
        camera["id"]: camera["clock"]
        for camera in json.loads((film / "capture.json").read_text())["cameras"]
    }
    for number, image in model.images.items():
        camera, file = image.name.split("/")
        clock, frame = clocks[camera], int(Path(file).stem)
        nominal = (
            clock["times_s"][frame]
            if "times_s" in clock
            else clock["first_s"] + frame / clock["rate_hz"]
        )
        assert times[number] / 1e9 == pytest.approx(nominal + offsets[camera], abs=1e-9)
        original = (film / camera / f"{frame:04d}.png").read_bytes()
        copied = pycolmap.Bitmap.read(out / "images" / image.name, as_rgb=True)
        (tmp_path / "original.png").write_bytes(original)
        expected = pycolmap.Bitmap.read(tmp_path / "original.png", as_rgb=True)
        assert np.array_equal(copied.to_array(), expected.to_array())
    meta = json.loads((out / "sparse/0/time_meta.json").read_text())
    assert meta["colmap4d_spec"] == "1.0"
    assert meta["time_convention"] == "mid_exposure"
    numbers = {device["camera_ids"][0] for device in meta["devices"].values()}
    assert numbers == set(model.cameras)
