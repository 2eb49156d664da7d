"""The motion channels that `stlfr render -o x.exr` writes, as Blender's compositor reads them."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt
import pytest
from filming import IDENTITY, run

exr = importlib.import_module("stlfr_extension.exr")
png = importlib.import_module("stlfr_extension.png")

Array = npt.NDArray[np.float64]

WIDTH, HEIGHT, FOCAL_PX = 128, 96, 150.0
DEPTH_M = 2.0
SPEED_PX = np.array([3.2, -1.6])
"""The wall's motion, pixels to the right and down per frame."""
RATE_HZ, FRAMES = 25.0, 5
SPACING_M = 0.06

BORDER = 12
"""Width of the border whose motion isn't checked, because its surfaces aren't visible in all frames."""
MAX_ERRORS_PX = {50: 0.03, 99: 0.1, 100: 0.15}
"""Bounds of the errors, by percentile. Nine frames had at most 0.013, 0.091 and 0.116 px."""


def wall(center_m: float, frame: float) -> npt.NDArray[np.uint16]:
    """The image of the wall in a camera at `center_m`: waves in many directions, with wavelengths from 8 pixels."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    x += FOCAL_PX * center_m / DEPTH_M - SPEED_PX[0] * frame
    y -= SPEED_PX[1] * frame
    color = []
    for channel in range(3):
        value = np.full(x.shape, 0.5)
        for k in range(1, 10):
            angle, length = 2.4 * k + channel, 8.0 + 30.0 * ((0.618 * k) % 1.0)
            along = x * np.cos(angle) + y * np.sin(angle)
            value += 0.06 * np.sin(2.0 * np.pi * along / length + 1.7 * k + channel)
        color.append(value)
    samples: npt.NDArray[np.uint16] = np.round(
        np.clip(np.stack(color, axis=2), 0.0, 1.0) * 65535.0
    ).astype(np.uint16)
    return samples


def lens(center_m: float) -> dict[str, Any]:
    """The camera object of a camera at `center_m` that looks at the wall."""
    return {
        "width": WIDTH,
        "height": HEIGHT,
        "model": "PINHOLE",
        "params": [FOCAL_PX, FOCAL_PX, WIDTH / 2, HEIGHT / 2],
        "cam_from_world": {**IDENTITY, "translation": [-center_m, 0, 0]},
    }


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture by five cameras with known frame times, in front of a wall that moves uniformly."""
    folder = tmp_path_factory.mktemp("wall")
    cameras = []
    for c, late in enumerate((0.0, 0.5, 0.25, 0.75, 0.4)):
        center_m = SPACING_M * (c - 2)
        times = [frame + late for frame in range(FRAMES)]
        (folder / f"cam{c}").mkdir()
        for frame, at in enumerate(times):
            data = png.encoded(wall(center_m, at))
            (folder / f"cam{c}" / f"{frame}.png").write_bytes(data)
        clock = {"times_s": [at / RATE_HZ for at in times], "shared": True}
        filmed = {"id": f"cam{c}", "frames": f"cam{c}/%d.png", **lens(center_m)}
        cameras.append({**filmed, "clock": clock})
    content = {"format": "stlfr-capture", "version": 1, "name": "wall"}
    (folder / "capture.json").write_text(json.dumps({**content, "cameras": cameras}))
    return folder


def read_by_blender(file: Path) -> dict[str, npt.NDArray[np.float32]]:
    """The passes of a file in Blender's compositor, by name; they are saved without compression and read."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
    tree = bpy.data.node_groups.new("read", "CompositorNodeTree")
    scene.compositing_node_group = tree
    source = tree.nodes.new("CompositorNodeImage")
    source.image = bpy.data.images.load(str(file))
    saved = tree.nodes.new("CompositorNodeOutputFile")
    saved.directory, saved.file_name = str(file.parent), f"{file.stem}-again"
    saved.format.media_type = "MULTI_LAYER_IMAGE"
    saved.format.file_format = "OPEN_EXR_MULTILAYER"
    saved.format.color_depth, saved.format.exr_codec = "32", "NONE"
    saved.format.use_exr_interleave = True
    saved.file_output_items.clear()
    kinds = {"RGBA": "RGBA", "VECTOR": "VECTOR", "VALUE": "FLOAT"}
    for output in source.outputs:
        saved.file_output_items.new(kinds[output.type], output.name)
        tree.links.new(output, saved.inputs[output.name])
    bpy.ops.render.render()
    found: dict[str, npt.NDArray[np.float32]] = exr.read_channels(
        file.parent / f"{file.stem}-again.exr"
    )
    return found


def render(program: Path, capture: Path, output: Path, *arguments: object) -> str:
    """Run `stlfr render`, and return its notes."""
    command = [program, "render", capture, "-o", output, *arguments]
    ended = run([*map(str, command)])
    assert ended.returncode == 0, ended.stderr
    return ended.stderr


FLOW = ["--proxy", "scene-flow", "--sync", "nearest"]
PLANE = [
    "--preset",
    "draft",
    "--proxy",
    "plane",
    "--set",
    f"proxy.plane_depth_m={DEPTH_M}",
]


def vector(channels: dict[str, npt.NDArray[np.float32]], name: str) -> Array:
    """The vectors of a layer, pixels to the right and up, without the border."""
    both = np.stack([channels[f"{name}.{axis}"] for axis in "XY"], axis=2)
    inner = both[BORDER:-BORDER, BORDER:-BORDER]
    return np.asarray(inner, dtype=np.float64)


def must_be(found: Array, right_down_px: Array) -> None:
    """Assert the motion of all pixels, to scene flow's errors."""
    wanted = right_down_px * [1.0, -1.0]
    error_px = np.abs(found - wanted).max(axis=2)
    for percentile, bound_px in MAX_ERRORS_PX.items():
        largest_px = np.percentile(error_px, percentile)
        assert largest_px <= bound_px, (percentile, largest_px, wanted)


def test_a_still_has_the_motion_of_a_frame_of_the_recording(
    program: Path, capture: Path, tmp_path: Path
) -> None:
    file = tmp_path / "still.exr"
    render(program, capture, file, "--like", "cam2", "--time", "0.09", *FLOW)
    found = read_by_blender(file)
    must_be(vector(found, "forward"), SPEED_PX)
    must_be(vector(found, "backward"), -SPEED_PX)
    # Blender's pass of the same motion, in Cycles' convention: the backward motion, and minus the forward motion.
    np.testing.assert_array_equal(vector(found, "Vector"), vector(found, "backward"))
    np.testing.assert_allclose(
        -found["Vector.Z"], found["forward.X"], rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(found["Depth.V"][BORDER:-BORDER], DEPTH_M, rtol=0.02)
    assert found["Combined.R"].std() > 0.05


def test_a_sequence_has_the_motion_to_its_neighbours(
    program: Path, capture: Path, tmp_path: Path
) -> None:
    """The sequence is in slow motion, with half a frame interval from one picture to the next."""
    start, step = 2.0 / RATE_HZ, 0.5 / RATE_HZ
    times = f"{start}:{start + 2 * step}:3"
    view = tmp_path / "view.json"
    view.write_text(json.dumps(lens(0.03)))
    pattern = tmp_path / "%d.exr"
    render(program, capture, pattern, "--camera", view, "--times", times, *FLOW)
    for k in range(3):
        found = read_by_blender(tmp_path / f"{k}.exr")
        must_be(vector(found, "forward"), 0.5 * SPEED_PX)
        must_be(vector(found, "backward"), -0.5 * SPEED_PX)


def path(tmp_path: Path, times_s: tuple[float, float]) -> Path:
    """A path of one second with four pictures, in which the view moves 3 cm to the right."""
    keys = [
        {"at_s": at_s, "time_s": time_s, "camera": lens(center_m)}
        for at_s, time_s, center_m in (
            (0.0, times_s[0], 0.0),
            (1.0, times_s[1], 0.03),
        )
    ]
    content = {"format": "stlfr-path", "version": 1, "rate_hz": 4.0, "keys": keys}
    file = tmp_path / "path.json"
    file.write_text(json.dumps({**content, "constant_speed": True}))
    return file


SHIFT_PX = np.array([-FOCAL_PX * 0.0075 / DEPTH_M, 0.0])
"""The wall's displacement from one picture of the path to the next, because the view moves; pixels."""


def test_in_a_frozen_instant_the_view_alone_moves(
    program: Path, capture: Path, tmp_path: Path
) -> None:
    """The motion follows from the depths, with any method."""
    frozen = path(tmp_path, (0.09, 0.09))
    notes = render(program, capture, tmp_path / "%d.exr", "--path", frozen, *PLANE)
    assert "no motion" not in notes
    for k in range(4):
        found = read_by_blender(tmp_path / f"{k}.exr")
        must_be(vector(found, "forward"), SHIFT_PX)
        must_be(vector(found, "backward"), -SHIFT_PX)


def test_along_a_path_the_scene_and_the_view_move(
    program: Path, capture: Path, tmp_path: Path
) -> None:
    moving = path(tmp_path, (2.0 / RATE_HZ, 3.0 / RATE_HZ))
    render(program, capture, tmp_path / "%d.exr", "--path", moving, *FLOW)
    for k in range(4):
        found = read_by_blender(tmp_path / f"{k}.exr")
        must_be(vector(found, "forward"), 0.25 * SPEED_PX + SHIFT_PX)
        must_be(vector(found, "backward"), -0.25 * SPEED_PX - SHIFT_PX)


def test_unknown_motion_is_left_out_and_noted(
    program: Path, capture: Path, tmp_path: Path
) -> None:
    file = tmp_path / "still.exr"
    view = ["--like", "cam2", "--time", "0.09"]
    notes = render(program, capture, file, *view, *PLANE)
    assert notes.count("have no motion") == 1
    names = [
        channel.split(b"\0")[0] for channel in file.read_bytes()[:400].split(b"\0")
    ]
    assert b"Z" in names and not {b"forward.u", b"Vector.X"} & set(names)
