"""Ground truth of a simulated capture: instants with ground truth images, true offsets, true exposure times.

All times are seconds on the reference camera's clock. Does not import `bpy`.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

from .errors import BadInputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .rig import Rig, Shutter

MIN_GAP_FRAMES = 0.04
"""Instants with ground truth lie in the middle of gaps between the exposures of any cameras. This is the minimum length
of such a gap, in frame intervals of the reference camera. If smaller, some camera's frame nearly equals the ground
truth; if larger than an eighth, eight cameras with evenly spread offsets have no gap."""


def reference_zero_s(rig: Rig, shutters: list[Shutter]) -> float:
    """World time at which the reference camera's clock shows 0."""
    return next(s.zero_s for s in shutters if s.id == rig.reference)


def offsets_s(rig: Rig, shutters: list[Shutter]) -> dict[str, float]:
    """The true offset of every camera by id: time on the reference's clock = time on the camera's clock + offset."""
    zero_s = reference_zero_s(rig, shutters)
    return {s.id: s.zero_s - zero_s for s in shutters}


def covered_span_s(rig: Rig, shutters: list[Shutter]) -> tuple[float, float]:
    """The first and last instant of the covered span, in which all instants have enough frames for interpolation.

    Every camera has at least two frames up to each of these instants, and at least two frames from it on. If a camera
    has fewer than four frames, the span is empty: its end is before its start.
    """
    zero_s = reference_zero_s(rig, shutters)
    if min(len(s.world_times_s) for s in shutters) < 4:
        return (0.0, -1.0)
    start_s = max(s.world_times_s[1] for s in shutters) - zero_s
    end_s = min(s.world_times_s[-2] for s in shutters) - zero_s
    return (start_s, end_s)


def instants_s(rig: Rig, shutters: list[Shutter], count: int) -> list[float]:
    """`count` instants spread over the covered span, each in the middle of a gap between exposures.

    Raises `BadInputError` if there are too few gaps of at least `MIN_GAP_FRAMES`.
    """
    if count == 0:
        return []
    start_s, end_s = covered_span_s(rig, shutters)
    zero_s = reference_zero_s(rig, shutters)
    exposures_s = sorted(
        time_s - zero_s
        for s in shutters
        for time_s in s.world_times_s
        if start_s <= time_s - zero_s <= end_s
    )
    min_gap_s = MIN_GAP_FRAMES / rig.reference_camera.rate_hz
    middles_s = [
        (before + after) / 2
        for before, after in itertools.pairwise(exposures_s)
        if after - before >= min_gap_s
    ]
    if len(middles_s) < count:
        raise BadInputError(
            f"--instants {count}: there is room for {len(middles_s)} between the frames of all cameras; "
            "film more --frames"
        )
    chosen: list[float] = []
    for i in range(count):
        wanted_s = start_s + (end_s - start_s) * (i + 0.5) / count
        free = [middle_s for middle_s in middles_s if middle_s not in chosen]
        chosen.append(min(free, key=lambda middle_s: abs(middle_s - wanted_s)))
    return sorted(chosen)


def given_instants_s(
    rig: Rig, shutters: list[Shutter], times_s: Sequence[float]
) -> list[float]:
    """The given instants, sorted and without duplicates.

    Raises `BadInputError` if an instant is before the first frame or after the last frame of some camera.
    """
    zero_s = reference_zero_s(rig, shutters)
    start_s = max(s.world_times_s[0] for s in shutters) - zero_s
    end_s = min(s.world_times_s[-1] for s in shutters) - zero_s
    for time_s in times_s:
        if not start_s <= time_s <= end_s:
            raise BadInputError(
                f"--instants-s {time_s:g}: all cameras together film from {start_s:.4f} to {end_s:.4f} s"
            )
    return sorted(set(times_s))


def video_times_s(rig: Rig, shutters: list[Shutter], count: int) -> list[float]:
    """`count` evenly spaced times over the covered span, including its ends.

    Raises `BadInputError` if the covered span is empty.
    """
    if count == 0:
        return []
    start_s, end_s = covered_span_s(rig, shutters)
    if start_s > end_s:
        raise BadInputError(
            f"--truth-video {count}: no instant is covered by all cameras; film more --frames"
        )
    return [start_s + (end_s - start_s) * i / max(1, count - 1) for i in range(count)]


def clocks_json(rig: Rig, shutters: list[Shutter]) -> dict[str, Any]:
    """The fields of truth.json about clocks: every camera's true offset and drift, and its true exposure times."""
    zero_s = reference_zero_s(rig, shutters)
    offsets = offsets_s(rig, shutters)
    return {
        "offsets": [
            {
                "id": s.id,
                "offset_s": offsets[s.id],
                "rate_ppm": s.rate_ppm,
                "lost_before": list(s.lost_before),
            }
            for s in shutters
        ],
        "shutter": [
            {"id": s.id, "times_s": [time_s - zero_s for time_s in s.world_times_s]}
            for s in shutters
        ],
    }
