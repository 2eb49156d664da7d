"""Rolling shutters: bands of rows, and films of them against closed form."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import (
    add_disc,
    black_scene,
    film,
    options,
    read_light,
    rig_camera,
    write_rig,
)

rolling = importlib.import_module("stlfr_extension.rolling")

READOUT_S = 0.03


@pytest.mark.parametrize("readout_s", [0.0, 0.001, 0.015, 1 / 30])
@pytest.mark.parametrize("size_px", [(64, 48), (640, 480), (50, 7), (8, 1)])
def test_bands_cover_all_rows_and_are_short(
    size_px: tuple[int, int], readout_s: float
) -> None:
    bands = rolling.bands(size_px, readout_s)
    height = size_px[1]
    rows = [row for band in bands for row in range(band.first, band.end)]
    assert rows == list(range(height))
    step_px = 0.0
    for band in bands:
        times_s = rolling.row_offsets_s(
            np.arange(band.first, band.end) + 0.5, height, readout_s
        )
        assert band.offset_s == pytest.approx(times_s.mean(), abs=1e-12)
        error_s = np.abs(times_s - band.offset_s).max()
        step_px = max(step_px, error_s * rolling.SPEED * size_px[0])
    row_s = readout_s / max(1, height - 1)
    assert step_px <= max(rolling.MAX_STEP_PX, row_s * rolling.SPEED * size_px[0] / 2)
    assert len(bands) == 1 or readout_s > 0.0


def test_a_point_is_exposed_when_its_row_is() -> None:
    nodes_s = rolling.nodes_s(READOUT_S)
    speeds = np.array([0.0, 400.0, -300.0, 900.0])
    y_px = 20.0 + nodes_s[:, None] * speeds
    when = rolling.exposed(y_px, 48, READOUT_S)
    found_s = when.between(
        np.repeat(nodes_s[:, None, None], len(speeds), axis=1)
    ).ravel()
    row_s = READOUT_S / 47
    expected_s = (20.0 - 24.0) * row_s / (1 - speeds * row_s)
    assert found_s == pytest.approx(expected_s, abs=1e-9)
    outside = rolling.exposed(
        np.full((len(nodes_s), 2), [[-50.0, 90.0]]), 48, READOUT_S
    )
    ends_s = outside.between(np.repeat(nodes_s[:, None, None], 2, axis=1)).ravel()
    assert ends_s == pytest.approx([-READOUT_S / 2, READOUT_S / 2])


def bars_edge_px(light: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The x at which each row's light ends, if it begins at the left border."""
    return np.asarray(light.sum(axis=1) / light.max())


def test_a_moving_edge_is_slanted_in_frames_and_upright_in_truth(
    tmp_path: Path,
) -> None:
    bpy = pytest.importorskip("bpy")
    scene = black_scene()
    # The right edge of a large square passes through the image; its other edges are far outside.
    square = add_disc((0.0, 0.0, -2.0), 20.0, 1.0, vertices=4)
    square.rotation_euler[2] = np.pi / 4
    bpy.context.view_layer.update()
    half_m, speed_m_s = 20.0 / np.sqrt(2.0), 2.0
    driver = square.driver_add("location", 0).driver
    driver.expression = f"{speed_m_s} * (frame - 1) / 30 - {half_m} - 0.2"
    rig_file = write_rig(
        tmp_path / "rig.json",
        rig_camera("rolling", readout_s=READOUT_S, delay_s=0.04),
        rig_camera("global", delay_s=0.04),
        rig_camera("bent", readout_s=READOUT_S, delay_s=0.04, distortion={"k1": -0.05}),
    )
    wanted = options(rig_file, frames=3, size_px=None, samples=32, instants_s=(0.03,))
    film(scene, wanted, tmp_path / "capture")
    speed_px_s = speed_m_s * 64 / 2.0
    rows_s = rolling.row_offsets_s(np.arange(48) + 0.5, 48, READOUT_S)

    def edges(name: str) -> np.ndarray[Any, Any]:
        return bars_edge_px(read_light(tmp_path / "capture" / name))

    upright, slanted = edges("global/0001.png"), edges("rolling/0001.png")
    assert upright == pytest.approx(upright.mean(), abs=0.1)
    expected = upright.mean() + speed_px_s * rows_s
    # Because of bands, a row shows an instant at most 2.5 ms from its own.
    assert slanted == pytest.approx(expected, abs=0.2 + 0.0025 * speed_px_s)
    slope = np.polyfit(np.arange(48), slanted, 1)[0]
    assert slope == pytest.approx(speed_px_s * READOUT_S / 47, rel=0.05)
    # The middle of the image has little distortion; exposure times follow the rows of the distorted image.
    bent = edges("bent/0001.png")
    assert bent[16:32] == pytest.approx(expected[16:32], abs=0.35 + 0.0025 * speed_px_s)
    truth = edges("truth/views/t0-rolling.png")
    assert truth == pytest.approx(truth.mean(), abs=0.1)


@pytest.mark.parametrize("engine", ["workbench", "cycles"])
@pytest.mark.parametrize(
    "lens",
    [
        {},
        {"width": 48, "height": 64, "shift_x": 0.05, "shift_y": -0.1},
        {"distortion": {"k1": -0.05}},
    ],
)
def test_frames_of_a_still_scene_are_the_same_by_any_shutter(
    tmp_path: Path, engine: str, lens: dict[str, Any]
) -> None:
    pytest.importorskip("bpy")
    scene = black_scene()
    add_disc((0.2, -0.1, -2.0), 0.55, 1.0, vertices=64)
    add_disc((-0.5, 0.4, -2.5), 0.4, 0.5, vertices=64)
    rig_file = write_rig(
        tmp_path / "rig.json",
        rig_camera("global", **lens),
        rig_camera("rolling", readout_s=READOUT_S, **lens),
    )
    wanted = options(rig_file, frames=1, size_px=None, samples=32, engine=engine)
    film(scene, wanted, tmp_path / "capture")
    whole, banded = (
        read_light(tmp_path / "capture" / name / "0000.png")
        for name in ("global", "rolling")
    )
    assert whole.max() > 0.1
    # Edges differ by the noise of 32 samples in Cycles, and by Workbench's sub-pixel grid.
    assert np.abs(banded - whole).mean() < (0.001 if engine == "workbench" else 0.01)
    # The discs' centres agree, but for the noise of Cycles' edges.
    limit_px = 0.01 if engine == "workbench" else 0.05
    for axis in (0, 1):
        at = np.arange(whole.shape[axis])
        centres = [
            (image.sum(axis=1 - axis) * at).sum() / image.sum()
            for image in (whole, banded)
        ]
        assert centres[1] == pytest.approx(centres[0], abs=limit_px)
