"""Rigs: one corpus for both readers; shutters, lenses and sensors of every shipped rig, measured in its pictures."""

from __future__ import annotations

import copy
import importlib
import json
import math
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
filming_spec = importlib.util.spec_from_file_location(
    "filming", ROOT / "tests" / "python" / "filming.py"
)
assert filming_spec is not None and filming_spec.loader is not None
filming = importlib.util.module_from_spec(filming_spec)
filming_spec.loader.exec_module(filming)
camera, distortion, errors, rig, sensor = (
    filming.camera,
    filming.distortion,
    filming.errors,
    filming.rig,
    filming.sensor,
)

SHIPPED = sorted((ROOT / "rigs").glob("*.json"))
CORPUS = json.loads((ROOT / "tests" / "golden" / "rigs.json").read_text())


# What is a rig


def changed(changes: dict[str, Any]) -> dict[str, Any]:
    """The corpus's rig with fields changed; a field's path has dots."""
    content: dict[str, Any] = copy.deepcopy(CORPUS["rig"])
    for path, value in changes.items():
        *parents, field = path.split(".")
        at: Any = content
        for step in parents:
            at = at[int(step) if step.isdecimal() else step]
        at[field] = value
    return content


def refusal(path: Path, content: Any) -> str | None:
    """What Blender's reader says of a rig file, if it refuses it."""
    path.write_text(json.dumps(content), encoding="utf-8")
    try:
        rig.load(path)
    except errors.BadInputError as error:
        return str(error)
    return None


@pytest.mark.parametrize("changes", CORPUS["good"], ids=str)
def test_a_good_rig_is_read(tmp_path: Path, changes: dict[str, Any]) -> None:
    assert refusal(tmp_path / "rig.json", changed(changes)) is None


@pytest.mark.parametrize(("changes", "field"), CORPUS["bad"], ids=str)
def test_a_bad_rig_is_refused(
    tmp_path: Path, changes: dict[str, Any], field: str
) -> None:
    path = tmp_path / "rig.json"
    complaint = refusal(path, changed(changes))
    assert complaint is not None and complaint.startswith(f"{path}: ")
    assert field in complaint


def violations(schema: dict[str, Any], root: dict[str, Any]) -> Iterator[Any]:
    """Values that a schema of one field refuses."""
    if "$ref" in schema:
        schema = {**root["$defs"][schema["$ref"].rsplit("/")[-1]], **schema}
    kind = schema.get("type")
    yield None
    yield {"object": [], "array": {}, "string": 7}.get(str(kind), "text")
    for limit, beyond in (("minimum", -1), ("maximum", 1)):
        if limit in schema:
            yield (
                schema[limit] + beyond
                if kind == "integer"
                else np.nextafter(schema[limit], math.inf * beyond).item()
            )
    if "const" in schema or "enum" in schema:
        yield 5 if kind == "integer" else "other"
    if "pattern" in schema:
        yield from ("", "-a", "a b", "a/b", "ä")
    if kind == "array":
        items = schema.get("items", {})
        yield from ([value] for value in violations(items, root))
        count = schema.get("minItems")
        if count:
            yield []


def broken_rigs(schema: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Rigs that the schema refuses, one wrong field each."""
    camera_schema, view_schema = (
        schema["$defs"][name] for name in ("RigCamera", "RigView")
    )
    places = {
        "": schema,
        "cameras.1.": camera_schema,
        "views.0.": view_schema,
        "cameras.1.cam_from_rig.": schema["$defs"]["PoseFormat"],
        "cameras.1.distortion.": schema["$defs"]["Distortion"],
    }
    for prefix, part in places.items():
        assert part["additionalProperties"] is False
        yield f"{prefix}unknown", 1
        for field, field_schema in part["properties"].items():
            for value in violations(field_schema, schema):
                yield f"{prefix}{field}", value


def test_both_readers_refuse_what_the_schema_refuses(
    program: Path, tmp_path: Path
) -> None:
    schema = json.loads(
        subprocess.run(
            [program, "rig", "--schema", "rig"], check=True, capture_output=True
        ).stdout
    )
    path = tmp_path / "rig.json"
    count = 0
    base = {"cameras.1.distortion": {"k1": -0.1}}
    assert refusal(path, changed(base)) is None
    for field, value in broken_rigs(schema):
        complaint = refusal(path, changed({**base, field: value}))
        assert complaint is not None, (field, value)
        checked = subprocess.run([program, "rig", "--check", path], capture_output=True)
        assert checked.returncode == 2, (field, value, checked)
        assert checked.stderr.startswith(str(path).encode())
        count += 1
    for field in schema["required"] + [
        f"cameras.1.{f}" for f in schema["$defs"]["RigCamera"]["required"]
    ]:
        content = changed({})
        at: Any = content
        *parents, last = field.split(".")
        for step in parents:
            at = at[int(step) if step.isdecimal() else step]
        del at[last]
        assert refusal(path, content) is not None, field
        checked = subprocess.run([program, "rig", "--check", path], capture_output=True)
        assert checked.returncode == 2, field
    assert count > 120


# Shutters


def loaded(tmp_path: Path, changes: dict[str, Any]) -> Any:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(changed(changes)), encoding="utf-8")
    return rig.load(path)


def test_a_drifting_clock_obeys_its_definition(tmp_path: Path) -> None:
    drifting = {"cameras.1.drift_ppm": 400.0, "cameras.1.jitter_s": 0.001}
    small = loaded(tmp_path, drifting)
    reference, late = rig.shutters(small, 60)
    clock_s = np.array(late.clock_times_s)
    offset_s = late.zero_s - reference.zero_s
    expected = clock_s + (clock_s - clock_s[0]) * 400e-6 + offset_s
    assert late.world_times_s == pytest.approx(expected, abs=1e-12)
    assert late.rate_ppm == 400.0 and offset_s == pytest.approx(0.01)


def test_all_cameras_film_as_long_as_the_reference(tmp_path: Path) -> None:
    small = loaded(tmp_path, {"cameras.1.rate_hz": 60.0, "cameras.1.jitter_s": 0.0})
    assert [len(s.world_times_s) for s in rig.shutters(small, 7)] == [7, 14]
    slow = loaded(tmp_path, {"cameras.1.rate_hz": 24.0})
    assert [len(s.world_times_s) for s in rig.shutters(slow, 7)] == [7, 6]
    assert [len(s.world_times_s) for s in rig.shutters(slow, 1)] == [1, 1]


def test_a_lost_frame_is_a_gap_or_leaves_no_trace(tmp_path: Path) -> None:
    lost = {"cameras.1.rate_hz": 30.0, "cameras.1.lost_frames": [2, 3, 9]}
    _, stamped = rig.shutters(loaded(tmp_path, lost), 7)
    expected = [0.01 + k / 30 for k in (0, 1, 4, 5, 6)]
    assert stamped.world_times_s == pytest.approx(expected)
    assert stamped.stated_times_s == pytest.approx([k / 30 for k in (0, 1, 4, 5, 6)])
    assert stamped.lost_before == (2, 2)
    hidden_rig = loaded(tmp_path, {**lost, "cameras.1.lost_stamped": False})
    _, hidden = rig.shutters(hidden_rig, 7)
    assert hidden.world_times_s == stamped.world_times_s
    assert hidden.stated_times_s is None


def test_a_shared_clock_reads_world_time(tmp_path: Path) -> None:
    shared = {f"cameras.{k}.clock_shared": True for k in (0, 1)}
    reference, late = rig.shutters(loaded(tmp_path, shared), 3)
    assert (reference.zero_s, late.zero_s) == (0.0, 0.0)
    assert late.stated_times_s == late.world_times_s


def test_only_the_rig_in_step_films_two_first_frames_at_once() -> None:
    for path in SHIPPED:
        starts_s = np.sort(
            [s.world_times_s[0] for s in rig.shutters(rig.load(path), 1)]
        )
        if path.stem == "linear8-sync":
            assert (starts_s == 0).all()
        else:
            assert np.diff(starts_s).min() > 1e-4, path.name


# Lenses and sensors, in closed form


def test_distortion_and_its_inverse_agree() -> None:
    lens = camera.Pinhole(640, 480, 686.0, 680.0, 321.0, 239.0)
    bent = distortion.Distortion(-0.21, 0.07, 1e-3, -2e-3)
    pixels = np.random.default_rng(0).uniform((0, 0), (640, 480), (500, 2))
    ideal = distortion.ideal_from_pixels(lens, bent, pixels)
    back = distortion.pixels_from_ideal(lens, bent, ideal)
    assert back == pytest.approx(pixels, abs=1e-9)
    folded = distortion.Distortion(k1=-0.5)  # r (1 - r²/2) reaches 0.544 at most
    found = folded.undistorted(np.array([[0.5, 0.0], [0.6, 0.0]]))
    assert np.isfinite(found[0]).all() and np.isnan(found[1]).all()


def test_resampling_reproduces_ramps() -> None:
    lens = camera.Pinhole(64, 48, 60.0, 60.0, 33.0, 23.0)
    bent = distortion.Distortion(-0.2, 0.05, 1e-3, -2e-3)
    pinhole = sensor.wide_pinhole(lens, bent)
    wide = sensor.Wide(lens, bent, pinhole)
    y, x = np.mgrid[: pinhole.height_px, : pinhole.width_px] + 0.5
    ramps = wide.resample(np.stack([x, y, np.ones_like(x)], axis=2).astype(np.float32))
    grid = np.stack(np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5), axis=2)
    ideal = distortion.ideal_from_pixels(lens, bent, grid.reshape(-1, 2))
    expected = wide.of_image(ideal).reshape(48, 64, 2)
    assert ramps[..., :2] == pytest.approx(expected, abs=1e-4)
    assert ramps[..., 2] == pytest.approx(1.0, abs=1e-6)


def sensor_of(tmp_path: Path, **changes: Any) -> Any:
    fields = {f"cameras.1.{name}": value for name, value in changes.items()}
    return loaded(tmp_path, fields).cameras[1]


def test_noise_is_gaussian_of_its_own_for_every_image(tmp_path: Path) -> None:
    noisy = sensor_of(tmp_path, noise=0.02, bit_depth=16)
    light = np.full((200, 300, 3), 0.2, dtype=np.float32)
    clean = sensor.develop(light, noisy, None) / 65535
    one, other = (sensor.develop(light, noisy, seed) / 65535 - clean for seed in (1, 2))
    assert one.std() == pytest.approx(0.02, rel=0.02)
    assert abs(one.mean()) < 5 * 0.02 / math.sqrt(one.size)
    assert np.mean(one**4) / np.mean(one**2) ** 2 == pytest.approx(3.0, abs=0.1)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.02
    assert (sensor.develop(light, noisy, 1) / 65535 - clean == one).all()


def test_gain_multiplies_light_before_it_is_encoded(tmp_path: Path) -> None:
    light = np.array([[[0.1, 0.2, 0.8]]], dtype=np.float32)
    doubled = sensor.develop(light, sensor_of(tmp_path, gain=2.0), None)
    assert (doubled == np.round(255 * sensor.encoded(2 * light))).all()
    assert doubled[0, 0, 2] == 255
    gray = sensor.develop(light, sensor_of(tmp_path, color="gray", bit_depth=16), None)
    luminance = light.astype(np.float64) @ [0.2126, 0.7152, 0.0722]
    expected = round(65535 * sensor.encoded(luminance).item())
    assert gray.shape == (1, 1) and gray[0, 0] == expected


# In pictures: where a moving disc is

VELOCITY_M_S = np.array([4.0, 2.0, 0.0])
CENTRAL_S = 0.09
"""World time at which the disc is before the rig's centre."""
DISTANCE_M = 1.8
RADIUS_M = 0.08


@pytest.fixture(scope="module")
def moving_disc() -> Any:
    """A disc in uniform motion, right and up: at 80x60, some 7 px a frame of 30 Hz."""
    pytest.importorskip("bpy")
    scene = filming.black_scene()
    disc = filming.add_disc((0.0, 0.0, -DISTANCE_M), RADIUS_M, 0.5)
    for axis in (0, 1):
        driver = disc.driver_add("location", axis).driver
        driver.expression = f"{VELOCITY_M_S[axis]}*((frame-1)/30-{CENTRAL_S})"
    return scene


def time_errors_frames(capture: Path, zero_s: float) -> dict[str, list[float]]:
    """By how much every frame's picture is off its exported time, in its camera's frames."""
    content = json.loads((capture / "capture.json").read_text())
    truth = json.loads((capture / "truth" / "truth.json").read_text())
    errors_frames: dict[str, list[float]] = {}
    for entry, shutter in zip(content["cameras"], truth["shutter"], strict=True):
        assert entry["id"] == shutter["id"]

        def at(time_s: float, entry: dict[str, Any] = entry) -> Any:
            moved = VELOCITY_M_S * (time_s + zero_s - CENTRAL_S)
            return filming.disc_centroid(entry, moved - [0, 0, DISTANCE_M], RADIUS_M)

        frame_s = np.median(np.diff(shutter["times_s"]))
        for k, time_s in enumerate(shutter["times_s"]):
            expected, later = at(time_s), at(time_s + 1e-3)
            velocity_px_s = (later - expected) / 1e-3
            light = filming.read_light(capture / entry["id"] / f"{k:04d}.png")
            off_px = filming.centroid(light, expected, 12.0) - expected
            off_s = off_px @ velocity_px_s / (velocity_px_s @ velocity_px_s)
            errors_frames.setdefault(entry["id"], []).append(off_s / frame_s)
    return errors_frames


def reference_zero_s(filmed: Any) -> float:
    """World time at which the reference's clock reads 0: the only thing that no file says."""
    zero: float = next(
        s.zero_s for s in filmed.shutters if s.id == filmed.rig.reference
    )
    return zero


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_frame_was_taken_when_its_stamp_says(
    path: Path, moving_disc: Any, tmp_path: Path
) -> None:
    frames = 5 if path.stem == "lost-frames" else 3
    wanted = filming.options(path, samples=32, frames=frames)
    filmed = filming.film(moving_disc, wanted, tmp_path)
    found = time_errors_frames(tmp_path, reference_zero_s(filmed))
    assert len(found) == 8
    assert max(abs(e) for errors in found.values() for e in errors) < 0.01
    if path.stem == "lost-frames":
        assert sum(len(s.lost_before) for s in filmed.shutters) >= 4


def test_hard_shutters_are_told_to_the_frame_too(
    moving_disc: Any, tmp_path: Path
) -> None:
    """A clock that is off by 5 %, lost frames, long exposures, noise, gain, 16 bits, distortion, hidden jitter and mixed sizes."""
    rig_file = tmp_path / "hard.json"
    base = CORPUS["rig"]["cameras"][1]
    bent = {"k1": -0.3, "k2": 0.1, "p1": 0.005, "p2": -0.004}
    hidden = {"jitter_s": 0.002, "jitter_stamped": False}
    cameras = [
        {**CORPUS["rig"]["cameras"][0], "width": 80, "height": 60},
        {**base, "id": "drift", "rate_hz": 60.0, "drift_ppm": 50_000.0},
        {**base, "id": "blur", "exposure_s": 0.015, **hidden},
        {**base, "id": "lost", "lost_frames": [1, 3], "lost_stamped": False},
        {**base, "id": "sensor", "gain": 1.5, "bit_depth": 16, "color": "gray"},
        {**base, "id": "noise", "noise": 0.003},
        {**base, "id": "bent", "width": 96, "height": 64, "distortion": bent},
    ]
    rig_file.write_text(json.dumps({**CORPUS["rig"], "cameras": cameras}))
    wanted = filming.options(rig_file, samples=128, frames=5, size_px=None)
    filmed = filming.film(moving_disc, wanted, tmp_path / "capture")
    found = time_errors_frames(tmp_path / "capture", reference_zero_s(filmed))
    assert [len(found[c["id"]]) for c in cameras] == [5, 10, 5, 3, 5, 5, 5]
    assert max(abs(e) for errors in found.values() for e in errors) < 0.01

    content = json.loads((tmp_path / "capture" / "capture.json").read_text())
    clocks = {entry["id"]: entry["clock"] for entry in content["cameras"]}
    assert clocks["drift"]["drift"] is True and "lost" not in clocks["drift"]
    assert clocks["lost"] == {
        "rate_hz": 25.0,
        "first_s": 0.0,
        "shared": False,
        "lost": True,
    }
    truth = json.loads((tmp_path / "capture" / "truth" / "truth.json").read_text())
    offsets = {entry["id"]: entry for entry in truth["offsets"]}
    assert offsets["drift"]["rate_ppm"] == 50_000.0
    assert offsets["lost"]["lost_before"] == [1, 2]
    # The blurred disc is longer than the sharp one, by its way while the shutter is open.
    lights = [
        filming.read_light(tmp_path / "capture" / name / "0002.png")
        for name in ("blur", "drift")
    ]
    lengths_px = [np.sum(light.max(axis=0) > 0.01 * light.max()) for light in lights]
    way_px = 0.015 * VELOCITY_M_S[0] * 64 / DISTANCE_M
    assert lengths_px[0] - lengths_px[1] == pytest.approx(way_px, abs=1.5)


def test_the_lens_is_distorted_as_told(tmp_path: Path) -> None:
    """Discs all over the image lie where COLMAP's model says, to 0.05 px, and nowhere near without it."""
    pytest.importorskip("bpy")
    scene = filming.black_scene()
    bent = {"k1": -0.3, "k2": 0.1, "p1": 0.005, "p2": -0.004}
    camera_entry = {
        **CORPUS["rig"]["cameras"][0],
        "width": 160,
        "height": 120,
        "shift_x": 0.02,
        "distortion": bent,
    }
    rig_file = tmp_path / "bent.json"
    rig_file.write_text(json.dumps({**CORPUS["rig"], "cameras": [camera_entry]}))
    places = [
        (x, y, -1.0) for x in np.linspace(-0.5, 0.5, 7) for y in (-0.3, -0.1, 0.1, 0.3)
    ]
    for place in places:
        filming.add_disc(place, 0.02, 0.5)
    wanted = filming.options(rig_file, samples=256, frames=1, size_px=None)
    filming.film(scene, wanted, tmp_path / "capture")
    (entry,) = json.loads((tmp_path / "capture" / "capture.json").read_text())[
        "cameras"
    ]
    assert entry["model"] == "OPENCV" and entry["params"][4:] == list(bent.values())
    light = filming.read_light(tmp_path / "capture" / "a" / "0000.png")
    straight = {**entry, "model": "PINHOLE", "params": entry["params"][:4]}
    seen, moved_px = 0, []
    for place in places:
        expected = filming.disc_centroid(entry, np.array(place), 0.02)
        if not (8 < expected[0] < 152 and 8 < expected[1] < 112):
            continue
        off_px = filming.centroid(light, expected, 7.0) - expected
        assert np.abs(off_px).max() < 0.05, place
        seen += 1
        moved_px.append(
            np.linalg.norm(
                filming.disc_centroid(straight, np.array(place), 0.02) - expected
            )
        )
    assert seen >= 24 and max(moved_px) > 5.0


def test_a_sensor_without_faults_records_blenders_picture(tmp_path: Path) -> None:
    """8 bits by Blender and 16 by us, in colour and grey, differ by an 8-bit step at most."""
    pytest.importorskip("bpy")
    scene = filming.scenes.open_scene("magazine", None)
    base = {**CORPUS["rig"]["cameras"][0], "width": 80, "height": 60}
    cameras = [
        {**base, "id": f"{color}{depth}", "color": color, "bit_depth": depth}
        for color in ("rgb", "gray")
        for depth in (8, 16)
    ]
    content = {**CORPUS["rig"], "reference": "rgb8", "cameras": cameras}
    rig_file = tmp_path / "rig.json"
    rig_file.write_text(json.dumps(content))
    loaded_rig = rig.load(rig_file)
    studios = importlib.import_module("stlfr_extension.film")
    studio = studios.Studio(scene, loaded_rig.cameras, 2)
    import cv2

    pictures = {}
    for view in loaded_rig.cameras:
        image = studios.Image(view.id, 0.05, 4, 77)
        studio.render_image(image, tmp_path / f"{view.id}.png", tmp_path)
        picture = cv2.imread(str(tmp_path / f"{view.id}.png"), cv2.IMREAD_UNCHANGED)
        assert picture.dtype == (np.uint8 if view.bit_depth == 8 else np.uint16)
        assert picture.ndim == (3 if view.color == "rgb" else 2)
        pictures[view.id] = picture / (2.0**view.bit_depth - 1)
    for color in ("rgb", "gray"):
        difference = pictures[f"{color}8"] - pictures[f"{color}16"]
        assert np.abs(difference).max() < 1.01 / 255
    assert pictures["rgb16"].std() > 0.1


# Every shipped rig's film goes all the way


@pytest.fixture(scope="module")
def magazine() -> Any:
    """The demo's scene."""
    pytest.importorskip("bpy")
    return filming.scenes.open_scene("magazine", None)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_rig_is_filmed_and_reconstructed(
    path: Path, magazine: Any, program: Path, tmp_path: Path
) -> None:
    capture = tmp_path / "capture"
    wanted = filming.options(path, size_px=(160, 120), frames=4, samples=6)
    filmed = filming.film(magazine, wanted, capture)
    found = subprocess.run(
        [program, "offsets", capture, "--json"],
        check=True,
        capture_output=True,
        text=True,
    )
    offsets = json.loads(found.stdout)
    assert [c["id"] for c in offsets["cameras"]] == [c.id for c in filmed.rig.cameras]
    truth = json.loads((capture / "truth" / "truth.json").read_text())
    frame_s = 1 / filmed.rig.reference_camera.rate_hz
    known = [
        (found["offset_s"] - true["offset_s"]) / frame_s
        for found, true in zip(offsets["cameras"], truth["offsets"], strict=True)
        # What is lost without a trace is another matter than the offset.
        if found["offset_s"] is not None and not true["lost_before"]
    ]
    # So few and small frames give no good offsets, but no wrong ones.
    assert max(map(abs, known)) < 0.1
    assert len(known) > 1 or path.stem == "lost-frames"
    # The reference is always there; the middle of its film is a time that it has.
    content = json.loads((capture / "capture.json").read_text())
    reference = next(c for c in content["cameras"] if c["id"] == content["reference"])
    times_s = reference["clock"].get("times_s") or [
        k / reference["clock"]["rate_hz"] for k in range(4)
    ]
    view = {
        field: reference[field]
        for field in ("width", "height", "model", "params", "cam_from_world")
    }
    (tmp_path / "view.json").write_text(json.dumps(view))
    command: list[str | Path] = [
        program,
        "render",
        capture,
        "--camera",
        tmp_path / "view.json",
    ]
    time_s = float(np.mean(times_s[1:3]))
    command += ["--time", str(time_s), "-o", tmp_path / "view.png"]
    subprocess.run(command, check=True)
    import cv2

    picture = cv2.imread(str(tmp_path / "view.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape[:2] == (120, 160) and picture[..., :3].std() > 20
