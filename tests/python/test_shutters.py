"""Exposure times of simulated cameras, and instants and offsets of the ground truth, against closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import (
    ROOT,
    SHIPPED,
    errors,
    loaded,
    plan,
    rig,
    rig_camera,
    truth,
    write_rig,
)


def loaded_rig(path: Path, *cameras: dict[str, Any], **changes: Any) -> Any:
    return rig.load(write_rig(path / "rig.json", *cameras, **changes))


def test_a_camera_opening_after_the_reference_has_a_positive_offset(
    tmp_path: Path,
) -> None:
    small = loaded_rig(
        tmp_path,
        rig_camera("ref", delay_s=0.010),
        rig_camera("late", delay_s=0.010 + 0.4 / 30),
    )
    shutters = rig.shutters(small, 5)
    assert truth.offsets_s(small, shutters) == {
        "ref": 0.0,
        "late": pytest.approx(+0.4 / 30),
    }
    assert shutters[1].world_times_s[2] == pytest.approx(0.010 + 2.4 / 30)
    assert shutters[1].clock_times_s[2] == pytest.approx(2 / 30)


def test_jitter_is_gaussian_and_does_not_depend_on_how_much_is_filmed(
    tmp_path: Path,
) -> None:
    small = loaded_rig(
        tmp_path, rig_camera("a", jitter_s=0.001), rig_camera("b", jitter_s=0.001)
    )
    long, other = rig.shutters(small, 4000)
    assert rig.shutter(small, 0, 7).world_times_s == long.world_times_s[:7]
    jitter = np.array(long.clock_times_s) - np.arange(4000) / 30
    assert abs(jitter.mean()) < 5e-5
    assert jitter.std() == pytest.approx(0.001, rel=0.05)
    assert abs(np.corrcoef(jitter, np.array(other.clock_times_s))[0, 1]) < 0.1


def test_hidden_jitter_moves_the_true_offset_by_its_mean(tmp_path: Path) -> None:
    hidden = {"jitter_s": 0.002, "jitter_stamped": False}
    small = loaded_rig(
        tmp_path, rig_camera("ref"), rig_camera("late", delay_s=0.01, **hidden)
    )
    shutters = rig.shutters(small, 9)
    nominal_s = np.arange(9) / 30
    expected = np.mean(np.array(shutters[1].world_times_s) - nominal_s)
    assert truth.offsets_s(small, shutters)["late"] == pytest.approx(expected)
    assert expected != pytest.approx(0.01, abs=1e-5)


def test_instants_lie_between_frames_of_all_cameras_with_another_frame_beyond() -> None:
    linear8 = rig.load(ROOT / "rigs" / "linear8.json")
    shutters = rig.shutters(linear8, 9)
    zero_s = truth.reference_zero_s(linear8, shutters)
    instants = truth.instants_s(linear8, shutters, 3)
    assert len(set(instants)) == 3
    for instant in instants:
        for shutter in shutters:
            times = np.array(shutter.world_times_s) - zero_s
            assert np.sum(times < instant) >= 2 and np.sum(times > instant) >= 2
            assert np.abs(times - instant).min() > 0.019 / 30


def test_too_short_a_film_for_truth_is_refused() -> None:
    linear8 = rig.load(ROOT / "rigs" / "linear8.json")
    with pytest.raises(
        errors.BadInputError,
        match=r"--instants 3: there is room for 0 .* film more --frames",
    ):
        truth.instants_s(linear8, rig.shutters(linear8, 2), 3)


def test_every_image_has_noise_of_its_own() -> None:
    whole = plan.make(
        plan.Options(
            ROOT / "rigs" / "linear8.json", "magazine", None, None, 9, 16, 3, 5, True
        )
    )
    seeds = [job.seed for job in whole.jobs]
    assert len(seeds) == len(set(seeds)) == 8 * 9 + 2 * 3 * 10 + 5


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
