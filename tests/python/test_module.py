"""The Python module `stlfr`: its results, its errors, and that it runs in one process with Blender."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import threading
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import stlfr
from filming import ROOT


def described(capture_dir: Path) -> list[dict[str, Any]]:
    """The camera entries of capture.json."""
    cameras: list[dict[str, Any]] = json.loads(
        (capture_dir / "capture.json").read_text()
    )["cameras"]
    return cameras


def places(capture_dir: Path) -> list[dict[str, Any]]:
    """The cameras as camera objects, in the form in which a view is requested."""
    fields = ("width", "height", "model", "params", "cam_from_world")
    return [{name: c[name] for name in fields} for c in described(capture_dir)]


def project_by_hand(
    camera: dict[str, Any], points: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Project points by the pinhole formula, with the quaternion's rotation written out."""
    w, x, y, z = np.array(camera["cam_from_world"]["rotation_wxyz"])
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    in_camera = points @ rotation.T + np.array(camera["cam_from_world"]["translation"])
    fx, fy, cx, cy = camera["params"]
    pixels = in_camera[:, :2] / in_camera[:, 2:] * (fx, fy) + (cx, cy)
    pixels[in_camera[:, 2] <= 0] = np.nan
    return np.asarray(pixels, dtype=np.float64)


def test_it_is_this_trees_version() -> None:
    """The installed module is built from this checkout."""
    with (ROOT / "Cargo.toml").open("rb") as file:
        assert stlfr.__version__ == tomllib.load(file)["package"]["version"]
    assert Path(stlfr.__file__).is_relative_to(sys.prefix)  # not blender/stlfr


def test_a_capture_is_what_its_file_says(capture_dir: Path) -> None:
    """Its name, camera ids and frame times equal those of capture.json."""
    capture = stlfr.open(capture_dir)
    cameras = described(capture_dir)
    assert capture.camera_ids == [c["id"] for c in cameras]
    assert capture.reference == "cam3"
    assert capture.name in repr(capture)
    for camera in cameras:
        times_s = capture.times(camera["id"])
        assert times_s.dtype == np.float64
        np.testing.assert_allclose(
            times_s, camera["clock"]["times_s"], rtol=0, atol=1e-12
        )


def test_points_are_projected_as_by_hand(capture_dir: Path) -> None:
    """A thousand points around the rig, some of them behind it."""
    capture = stlfr.open(str(capture_dir))
    points = np.random.default_rng(5).uniform(-4, 4, (1000, 3))
    seen = 0
    for camera in described(capture_dir):
        expected = project_by_hand(camera, points)
        pixels = capture.project(camera["id"], points)
        assert pixels.shape == (1000, 2)
        np.testing.assert_array_equal(np.isnan(pixels), np.isnan(expected))
        # Quaternions in files are normalized to 1e-16, and points near the camera's plane have large pixel coordinates.
        np.testing.assert_allclose(pixels, expected, rtol=1e-9, atol=1e-7)
        seen += int(np.sum(~np.isnan(pixels[:, 0])))
    assert 1000 < seen < 7000


def test_what_is_like_an_array_is_taken(capture_dir: Path) -> None:
    """`project` accepts lists, single precision, strided views, and arrays without points."""
    capture = stlfr.open(capture_dir)
    points = np.array([[0.1, 2.0, 0.2], [0.3, 3.0, -0.1]])
    expected = capture.project("cam0", points)
    np.testing.assert_array_equal(capture.project("cam0", points.tolist()), expected)
    np.testing.assert_allclose(
        capture.project("cam0", points.astype(np.float32)), expected, rtol=1e-5
    )
    doubled = np.repeat(points, 2, axis=1)[:, ::2]
    np.testing.assert_array_equal(capture.project("cam0", doubled), expected)
    assert capture.project("cam0", np.empty((0, 3))).shape == (0, 2)


def test_cameras_are_camera_objects_and_times_are_covered(own_capture: Path) -> None:
    capture = stlfr.open(own_capture)
    assert [camera["id"] for camera in capture.cameras] == capture.camera_ids
    camera = capture.camera("cam3")
    assert camera == capture.cameras[3] and camera["width"] == 160
    assert capture.camera("between")["params"] == camera["params"]
    first_s, last_s = capture.covered_s("cam3")
    assert first_s == pytest.approx(capture.times("cam3")[0])
    assert capture.covered_s()[0] <= first_s < last_s <= capture.covered_s()[1]


def test_alpha_is_there_as_it_is_asked_for(own_capture: Path) -> None:
    capture = stlfr.open(own_capture)
    options = {"sync": "nearest", "proxy": "plane", "blend.cameras": 2}
    for alpha, channels in [(True, 4), (False, 3)]:
        image = capture.render(0.07, like="between", options=options, alpha=alpha)
        assert image.shape == (120, 160, channels)
    wrongs: list[dict[str, Any]] = [
        {"preset": "fast"},
        {"options": {"proxy": "sphere"}},
    ]
    for wrong in wrongs:
        with pytest.raises(ValueError, match=r"^(preset|options): "):
            capture.render(0.07, like="cam3", **wrong)
    with pytest.raises(TypeError, match="has no argument 'speed'"):
        capture.render(0.07, like="cam3", speed=1)  # type: ignore[call-arg]


def test_a_missing_folder_is_not_found_and_help_is_the_stubs(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"capture\.json"):
        stlfr.open(tmp_path / "none")
    assert "alpha" in (stlfr.Capture.render.__doc__ or "")
    assert stlfr.Capture.cameras.__doc__ and stlfr.Capture.moment.__doc__


def test_bad_input_is_a_value_error(capture_dir: Path) -> None:
    """Each error message is one sentence."""
    capture = stlfr.open(capture_dir)
    for shape in [(3,), (4, 2), (2, 3, 3)]:
        with pytest.raises(ValueError, match=r"points: .*must be \(N, 3\)"):
            capture.project("cam0", np.zeros(shape))
    with pytest.raises(
        ValueError, match="no camera of this capture has the id 'cam99'"
    ):
        capture.times("cam99")


def test_errors_are_the_command_lines(tmp_path: Path, program: Path) -> None:
    """The module and the command line give the same error message."""
    for text in [
        None,
        "{",
        '{"format": "x", "version": 1, "name": "n", "cameras": []}',
    ]:
        if text is not None:
            (tmp_path / "capture.json").write_text(text)
        kinds = (ValueError, FileNotFoundError)
        with pytest.raises(kinds, match=r"capture\.json") as raised:
            stlfr.open(tmp_path)
        printed = subprocess.run(
            [program, "check", tmp_path], capture_output=True, text=True
        )
        assert (printed.returncode, printed.stderr) == (2, f"{raised.value}\n")


def test_it_runs_beside_blender(capture_dir: Path) -> None:
    """Blender and the module exchange arrays in one process."""
    script = (
        "import sys, bpy, numpy as np, stlfr\n"
        "mesh = bpy.data.meshes.new('points')\n"
        "mesh.from_pydata([(0.1, 2.0, 0.2), (0.3, 3.0, -0.1)], [], [])\n"
        "points = np.empty(6, dtype=np.float32)\n"
        "mesh.vertices.foreach_get('co', points)\n"
        "pixels = stlfr.open(sys.argv[1]).project('cam0', points.reshape(-1, 3))\n"
        "image = bpy.data.images.new('i', 2, 1, float_buffer=True)\n"
        "image.pixels.foreach_set(np.pad(pixels, ((0, 0), (0, 2))).astype(np.float32).ravel())\n"
        "print(pixels.tolist())\n"
    )
    command = [sys.executable, "-I", "-c", script, str(capture_dir)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    points = np.array([[0.1, 2.0, 0.2], [0.3, 3.0, -0.1]], dtype=np.float32)
    expected = stlfr.open(capture_dir).project("cam0", points)
    np.testing.assert_array_equal(json.loads(printed.splitlines()[-1]), expected)


def test_threads_run_while_it_works(capture_dir: Path) -> None:
    """A long projection releases the GIL, so that another thread continues to count."""
    capture = stlfr.open(capture_dir)
    points = np.random.default_rng(1).uniform(-4, 4, (3_000_000, 3))
    ended = threading.Event()

    def work() -> None:
        capture.project("cam0", points)
        ended.set()

    worker = threading.Thread(target=work)
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(10)  # so that Python itself doesn't switch threads
    try:
        worker.start()
        count = 0
        while not ended.wait(0.0005):
            count += 1
    finally:
        sys.setswitchinterval(interval_s)
        worker.join()
    assert count > 3


@pytest.fixture(scope="module")
def own_capture(capture_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tiny capture into which offsets.json may be written."""
    return Path(
        shutil.copytree(capture_dir, tmp_path_factory.mktemp("captures") / "own")
    )


def test_offsets_are_the_command_lines(own_capture: Path, program: Path) -> None:
    """Offsets estimated by the module equal those that the command prints for a copy without saved offsets."""
    offsets = stlfr.open(own_capture).offsets()
    assert offsets["reference"] == "cam3"
    (own_capture / "offsets.json").unlink()
    printed = subprocess.run(
        [program, "-q", "offsets", own_capture, "--json"],
        capture_output=True,
        check=True,
    )
    assert json.loads(printed.stdout) == offsets


def test_images_are_the_command_lines(
    own_capture: Path, program: Path, tmp_path: Path
) -> None:
    """A view, a view with unseen pixels, and a synchronized image equal those of `stlfr render`."""
    capture = stlfr.open(own_capture)
    time_s = float(np.mean(capture.times("cam3")))
    view = {
        k: described(own_capture)[3][k]
        for k in ("width", "height", "model", "params", "cam_from_world")
    }
    aside = json.loads(json.dumps(view))
    aside["cam_from_world"]["translation"][0] -= 0.6
    file, image = tmp_path / "view.json", tmp_path / "image.png"
    for given, alpha in [(view, False), (aside, True), (None, False)]:
        file.write_text(json.dumps(given))
        if given:
            where, rendered = (
                ["--camera", str(file)],
                capture.render(time_s, camera=given),
            )
        else:
            where, rendered = ["--like", "cam3"], capture.render(time_s, like="cam3")
        command: list[str | Path] = [
            program,
            "-q",
            "render",
            own_capture,
            *where,
            "--time",
            repr(time_s),
            "-o",
            image,
        ]
        subprocess.run(command, check=True)
        written = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
        assert written is not None
        order = [2, 1, 0, 3] if written.shape[2] == 4 else [2, 1, 0]
        np.testing.assert_array_equal(rendered, written[:, :, order])
        assert not alpha or rendered.shape[2] == 4


def test_what_cannot_be_rendered_is_a_value_error(
    own_capture: Path, program: Path, tmp_path: Path
) -> None:
    """The error message is that of the command line."""
    capture = stlfr.open(own_capture)
    with pytest.raises(ValueError, match="either camera or like"):
        capture.render(0.0)
    with pytest.raises(ValueError, match="options: speed: unknown field `speed`"):
        capture.render(0.0, like="cam3", options={"speed": 11})
    with pytest.raises(ValueError, match="cam3") as raised:
        capture.render(99.0, like="cam3")
    command: list[str | Path] = [
        program,
        "-q",
        "render",
        own_capture,
        "--like",
        "cam3",
        "--time",
        "99",
        "-o",
        tmp_path / "x.png",
    ]
    printed = subprocess.run(command, capture_output=True, text=True)
    assert (printed.returncode, printed.stderr) == (2, f"{raised.value}\n")


def test_the_options_are_those_that_render_takes(capture_dir: Path) -> None:
    """Every option has a help text and a default, and `render` accepts this default under the option's path."""
    capture = stlfr.open(capture_dir)
    options = {option["name"]: option for option in stlfr.options()}
    assert options["trail.instants"]["unit"] == "instants"
    assert options["trail.instants"]["range"] == [1.0, 10000.0]
    for name, option in options.items():
        assert option["help"].endswith(".")
        value: Any = option["default"]
        for field in reversed(name.split(".")):
            value = {field: value}
        with pytest.raises(ValueError, match="no camera and no true view is called"):
            capture.render(0.0, like="none", options=value)


def test_the_methods_are_those_that_render_takes(capture_dir: Path) -> None:
    """`methods` lists exactly the methods that `render` accepts."""
    capture = stlfr.open(capture_dir)
    stages = stlfr.methods()
    assert set(stages) == {"sync", "proxy", "trail", "preset"}
    paths = {
        "sync": ["sync"],
        "proxy": ["proxy", "method"],
        "trail": ["trail", "mode"],
        "preset": ["preset"],
    }
    for name, path in paths.items():

        def options(method: str, path: list[str] = path) -> dict[str, Any]:
            value: Any = method
            for field in reversed(path):
                value = {field: value}
            return dict(value)

        methods = [method["name"] for method in stages[name]["methods"]]
        assert stages[name]["default"] in methods and all(
            m["help"] for m in stages[name]["methods"]
        )
        for method in methods:
            with pytest.raises(
                ValueError, match="no camera and no true view is called"
            ):
                capture.render(0.0, like="none", options=options(method))
        with pytest.raises(ValueError, match="unknown variant") as raised:
            capture.render(0.0, like="none", options=options("unbuilt"))
        assert sorted(re.findall("`([a-z-]+)`", str(raised.value))[1:]) == sorted(
            methods
        )


def test_auto_renders_by_the_plan(
    own_capture: Path, program: Path, tmp_path: Path
) -> None:
    """With automatic methods, the image equals that with the options that `stlfr plan` writes."""
    planned = tmp_path / "planned.json"
    subprocess.run([program, "-q", "plan", own_capture, "-o", planned], check=True)
    capture = stlfr.open(own_capture)
    time_s = float(np.mean(capture.times("cam3")))
    auto = {"auto": {"sync": True, "proxy": True}}
    image = capture.render(time_s, like="cam3", options=auto)
    options = json.loads(planned.read_text())
    assert np.array_equal(image, capture.render(time_s, like="cam3", options=options))


def test_a_trail_can_be_stopped(own_capture: Path) -> None:
    """Rendering stops before any instant of the trail; an exception of the caller's function is raised."""
    capture = stlfr.open(own_capture)
    time_s = float(np.mean(capture.times("cam3")))
    options = {"sync": "nearest", "trail": {"duration_s": 0.01, "instants": 3}}
    asked: list[tuple[int, int]] = []

    def proceed(done: int, total: int) -> bool:
        asked.append((done, total))
        return True

    whole = capture.render(time_s, like="cam3", options=options, proceed=proceed)
    assert asked == [(0, 3), (1, 3), (2, 3)] and whole.shape == (120, 160, 3)
    with pytest.raises(InterruptedError, match="rendering was stopped"):
        capture.render(
            time_s, like="cam3", options=options, proceed=lambda done, _: done < 1
        )

    def fail(done: int, total: int) -> bool:
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        capture.render(time_s, like="cam3", options=options, proceed=fail)


def test_a_view_is_stopped_between_its_steps(own_capture: Path) -> None:
    """Rendering can be stopped between the steps of a view, not only before it begins."""
    capture, (camera, *_) = stlfr.open(own_capture), places(own_capture)
    time_s = float(np.mean(capture.times("cam3")))
    asked: list[tuple[int, int]] = []

    def proceed(done: int, total: int) -> bool:
        asked.append((done, total))
        return len(asked) < 3

    with pytest.raises(InterruptedError, match="rendering was stopped"):
        capture.render(time_s, camera=camera, preset="balanced", proceed=proceed)
    assert asked == [(0, 1)] * 3


def test_a_moments_views_are_those_of_render(own_capture: Path) -> None:
    """This also holds for viewpoints with unseen pixels, and after rendering with other options."""
    capture, cameras = stlfr.open(own_capture), places(own_capture)
    time_s = float(np.mean(capture.times("cam3")))
    options = {"preset": "draft"}
    moment = capture.moment(time_s, options=options)
    capture.render(time_s, camera=cameras[0], options={"preset": "balanced"})
    aside = json.loads(json.dumps(cameras[0]))
    aside["cam_from_world"]["translation"][0] += 0.8
    for camera in (cameras[0], cameras[4], aside):
        expected = capture.render(time_s, camera=camera, options=options)
        found = moment.view(camera)
        assert found.shape[2] == (4 if camera is aside else 3)
        np.testing.assert_array_equal(found, expected)
    with pytest.raises(ValueError, match="no camera has frames around 50 s: they"):
        capture.moment(50.0)
    with pytest.raises(ValueError, match="camera: "):
        moment.view({"width": 3})


def test_a_preview_is_nearly_the_view_once_its_depth_and_motion_are_there(
    own_capture: Path,
) -> None:
    capture, (camera, *_) = stlfr.open(own_capture), places(own_capture)
    time_s = float(np.mean(capture.times("cam3")))
    options = {"proxy": "scene-flow"}
    assert capture.preview(time_s, camera=camera, options=options) is None
    assert not capture.load_preview(time_s, camera=camera, options=options)
    whole = capture.render(time_s, camera=camera, options=options)
    assert capture.load_preview(time_s, camera=camera, options=options)
    quick = capture.preview(time_s, camera=camera, options=options)
    assert quick is not None
    assert quick.shape == whole.shape and quick.dtype == whole.dtype
    rms = (
        np.sqrt(np.mean((quick.astype(float) - whole) ** 2)) / np.iinfo(whole.dtype).max
    )
    assert 0.0 < rms < 0.03, rms
    capture.render(time_s, camera=camera, preset="draft")
    assert capture.preview(time_s, camera=camera, preset="draft") is None
    assert not capture.load_preview(time_s, camera=camera, preset="draft")
    methods: list[Any] = [capture.preview, capture.load_preview]
    for method in methods:
        with pytest.raises(ValueError, match="camera must be given"):
            method(time_s, options=options)
        with pytest.raises(TypeError, match="no arguments 'like' and 'proceed'"):
            method(time_s, camera=camera, like="cam3")
        with pytest.raises(TypeError, match="has no argument 'speed'"):
            method(time_s, camera=camera, speed=2)


def test_comparing_is_the_command_lines(own_capture: Path, program: Path) -> None:
    """The results equal those of `stlfr compare`; with `lines`, progress is printed to standard output."""
    script = "import sys, stlfr; print(stlfr.compare(sys.argv[1], options={'preset': 'draft'}, lines=True)['report'])"
    command = [sys.executable, "-I", "-c", script, str(own_capture)]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    *lines, report = ended.stdout.splitlines()
    said = [json.loads(line) for line in lines]
    assert said[-1]["done"] == said[-1]["total"] > 0
    assert said[-1]["what"] == "Comparing with the truth"
    folder = own_capture / "review"
    assert Path(report) == folder / "report.html" and Path(report).is_file()
    found = (folder / "metrics.json").read_text()
    shutil.rmtree(folder)
    by_program: list[str | Path] = [program, "-q", "compare", own_capture]
    subprocess.run([*by_program, "--preset", "draft"], check=True, capture_output=True)
    assert (folder / "metrics.json").read_text() == found


def test_comparing_replaces_nothing_of_anybody_elses(own_capture: Path) -> None:
    (own_capture / "truth").rename(own_capture / "away")
    with pytest.raises(ValueError, match=r"has no truth/truth\.json to compare with"):
        stlfr.compare(own_capture)
    (own_capture / "away").rename(own_capture / "truth")
    shutil.rmtree(own_capture / "review", ignore_errors=True)
    (own_capture / "review/report.html").mkdir(parents=True)
    with pytest.raises(ValueError, match=r"report\.html"):
        stlfr.compare(own_capture)
