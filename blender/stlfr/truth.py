"""What only a simulator knows: the instants that truth is rendered at, the offsets, the shutters' times.

All times are on the reference camera's clock, in seconds. No `bpy` here.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

from .errors import BadInputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .rig import Rig, Shutter

MIN_GAP_FRAMES = 0.04
"""An instant lies in the middle of a gap between two exposures (of any cameras) at least this wide,
in reference frames: narrower, and some camera's frame nearly is the truth; wider than an eighth,
and eight evenly spread cameras leave no gap."""


def reference_zero_s(rig: Rig, shutters: list[Shutter]) -> float:
    """World time at which the reference camera's clock reads 0."""
    return next(s.zero_s for s in shutters if s.id == rig.reference)


def offsets_s(rig: Rig, shutters: list[Shutter]) -> dict[str, float]:
    """time on the reference's clock = time on the camera's clock + offset, for every camera."""
    zero_s = reference_zero_s(rig, shutters)
    return {s.id: s.zero_s - zero_s for s in shutters}


def covered_span_s(rig: Rig, shutters: list[Shutter]) -> tuple[float, float]:
    """From where to where every camera has a frame on either side and one more beyond that."""
    zero_s = reference_zero_s(rig, shutters)
    if min(len(s.world_times_s) for s in shutters) < 4:
        return (0.0, -1.0)
    start_s = max(s.world_times_s[1] for s in shutters) - zero_s
    end_s = min(s.world_times_s[-2] for s in shutters) - zero_s
    return (start_s, end_s)


def instants_s(rig: Rig, shutters: list[Shutter], count: int) -> list[float]:
    """`count` instants spread over the covered span, each in the middle of a gap between exposures."""
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
            f"--instants {count}: {len(shutters[0].world_times_s)} frames a camera leave room for "
            f"{len(middles_s)} between frames of all cameras; film more --frames"
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
    """The given instants in order; every camera must have frames at or on both sides of each."""
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
    """`count` evenly spaced times over the covered span, ends included."""
    if count == 0:
        return []
    start_s, end_s = covered_span_s(rig, shutters)
    if start_s > end_s:
        raise BadInputError(
            f"--truth-video {count}: no instant is covered by all cameras; film more --frames"
        )
    return [start_s + (end_s - start_s) * i / max(1, count - 1) for i in range(count)]


def clocks_json(rig: Rig, shutters: list[Shutter]) -> dict[str, Any]:
    """What truth.json says of each camera's clock, and when its shutter opened."""
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
