"""Translates messages of the command line into the terms of Blender's panels. Does not import `bpy`."""

from __future__ import annotations

import re
from collections.abc import Iterator

MEANINGS: dict[str, str] = {
    r"--instants-s [\d.e+-]+": "Instants",
    r"--instants (\d+)": r"Instants is \1",
    r"film more --frames": "set Frames higher",
    r"--frames": "Frames",
    r"--samples": "Samples",
    r"--workers": "Processes",
    r"--size \d+x\d+": "the size",
    r"--truth-video( \d+)?": "the true slow motion",
    r"--blend ": "",
    r"--scene ": "",
    r", or film with --engine cycles": "",
    r"--engine workbench": "Workbench",
    r"--engine cycles": "Cycles",
    r"the plane proxy with proxy\.plane_depth_m focuses by hand": (
        "choose the scene shape Plane in the render properties, and focus by hand"
    ),
    r"proxy\.plane_depth_m": "Plane Depth",
    r"options: ": "",
    r"trail\.duration_s": "the trail's duration",
    r"trail\.instants": "the trail's instants",
    r"\S*/?\.film/rig\.json: ": "the rig: ",
    r"\S*\.film/\S+\.blend": "the copy of this file that is filmed",
    r"filming was stopped; the same command goes on where it was": (
        "filming was stopped; Resume goes on where it was"
    ),
    r"`?stlfr setup`?": "the extension's installation",
    r"`?stlfr (compare|offsets|render)( \S+)?`?": r"\1",
}
"""Regular expressions for parts of a message, and their replacements in the panels' terms; applied in this order."""


def in_blender(sentence: str) -> str:
    """The message in the terms of Blender's panels, without command line options and hidden files."""
    for pattern, meaning in MEANINGS.items():
        sentence = re.sub(pattern, meaning, sentence)
    return sentence


def duration(seconds: float) -> str:
    """A duration as text, such as `3 min 20 s`."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def wrapped(text: str, columns: int) -> Iterator[str]:
    """Yields the text in lines of at most `columns` characters, broken at spaces, and in longer words at slashes."""
    line = ""
    for word in re.findall(r"\S+", text):
        while len(word) > columns:
            cut = word.rfind("/", 1, columns) + 1 or columns
            if line:
                yield line
                line = ""
            yield word[:cut]
            word = word[cut:]
        if line and len(line) + 1 + len(word) > columns:
            yield line
            line = ""
        line = f"{line} {word}" if line else word
    if line:
        yield line


def frames(first: float, last: float) -> str:
    """A range of scene frames as text, rounded inwards to tenths, so that all frames in it are covered."""
    ten_first, ten_last = -int(-first * 10 // 1), int(last * 10 // 1)
    first, last = ten_first / 10, ten_last / 10
    return f"{first:g} to {last:g}"
