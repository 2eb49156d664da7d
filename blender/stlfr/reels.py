"""A comparison in Blender's video sequencer: each reel of review.json becomes a scene with strips.

Four pictures form a 2 x 2 layout: ground truth, traditional light field rendering (LFR), space-time light field
rendering (ST-LFR), and the difference. Each has its own channel and a label above it. The shot's name is above all
pictures, and each shot has a marker. The difference is |truth - ST-LFR| times a gain; the sequencer computes it, so
that the user can change the gain there.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import bpy

from . import reading
from .errors import BadInputError

GAP_PX = 8
"""Gap between two pictures side by side. If larger, it wastes space; at 0, the border between pictures is invisible."""

LABEL_PX = 28
"""Height of a label above its picture, and of the shot's name above all pictures. If larger, it wastes space; if
smaller, text of 18 px covers the pictures."""

MIN_PANEL_PX = 480
"""Minimum width of pictures; narrower ones are enlarged by an integer factor. If larger, the sequence plays and renders
more slowly; if smaller, labels don't fit above their pictures."""

MIN_RATE_HZ, MAX_RATE_HZ = 1e-2, 1e5
"""Minimum and maximum frame rate of a reel, within the rates that Blender supports. With wider limits, a scene may play
at another rate than its reel; with narrower limits, slow or fast videos are refused."""

MAX_FRAMES = 1_048_574
"""Blender's largest frame number. If larger, strips end beyond the last possible frame; if smaller, long videos are
refused."""

BACKGROUND_CHANNEL = 1
QUADRANTS = {
    "truth": (0, 0),
    "traditional": (1, 0),
    "space_time": (0, 1),
    "diff": (1, 1),
}
"""Column and row of each picture in the 2 x 2 layout, counted from the top left."""

CHANNELS = {"truth": 2, "traditional": 3, "space_time": 4, "diff": 5}
CHANNEL_NAMES = {
    "truth": "Truth",
    "traditional": "Traditional LFR",
    "space_time": "ST-LFR",
    "diff": "Difference",
}
FIRST_LABEL_CHANNEL = 7
"""First channel of the labels. It is above the pictures' channels, so that labels are drawn over the pictures."""


@dataclass(frozen=True)
class Grid:
    """The 2 x 2 layout of the pictures, each of size `panel_px`. Offsets are pixels from the frame's middle, y up."""

    panel_px: tuple[int, int]

    @property
    def cell_px(self) -> tuple[int, int]:
        return (self.panel_px[0] + GAP_PX, self.panel_px[1] + LABEL_PX)

    @property
    def size_px(self) -> tuple[int, int]:
        """The size of the whole frame, rounded up to even numbers, as video encoders require."""
        width, height = (2 * side + GAP_PX for side in self.cell_px)
        height += LABEL_PX
        return (width + width % 2, height + height % 2)

    def middle_px(self, panel: str) -> tuple[float, float]:
        """The middle of a picture (a key of `QUADRANTS`), in pixels from the frame's middle, y up."""
        column, row = QUADRANTS[panel]
        x = (column - 0.5) * self.cell_px[0]
        y = (0.5 - row) * self.cell_px[1] - LABEL_PX
        return (x, y)

    def label_at(self, panel: str) -> tuple[float, float]:
        """The left end of a picture's label, in fractions of the frame's size from its bottom left."""
        x, y = self.middle_px(panel)
        left = x - self.panel_px[0] / 2
        above = y + self.panel_px[1] / 2 + LABEL_PX / 2
        return (0.5 + left / self.size_px[0], 0.5 + above / self.size_px[1])

    @property
    def headline_at(self) -> tuple[float, float]:
        """The left end of the shot's name, in fractions of the frame's size from its bottom left."""
        left, _ = self.label_at("truth")
        return (left, 1.0 - LABEL_PX / 2 / self.size_px[1])


@dataclass(frozen=True)
class Panel:
    """One picture of a shot: its label and its image or video file."""

    title: str
    file: Path


@dataclass(frozen=True)
class Shot:
    """Up to three pictures of one view, shown together from the frame `start` on for `frames` frames."""

    label: str
    start: int
    frames: int
    is_movie: bool
    panels: dict[str, Panel]
    """The existing pictures, by name: `truth`, `traditional`, `space_time`."""


@dataclass(frozen=True)
class Reel:
    """A sequence of shots with one frame rate, which becomes one scene."""

    name: str
    rate_hz: float
    shots: list[Shot]
    gain: float
    """Factor by which differences are multiplied for display."""


def read_shots(entries: list[dict[str, Any]], folder: Path) -> list[Shot]:
    """The shots of a reel, from its entries in `folder`/review.json; the first shot starts at frame 1.

    Raises an error if an entry is invalid.
    """
    shots, start = [], 1
    for entry in entries:
        panels = {}
        if entry["truth"] is not None:
            panels["truth"] = Panel("Truth", _file(entry["truth"], folder))
        for name in ("traditional", "space_time"):
            if (panel := entry[name]) is not None:
                panels[name] = Panel(str(panel["title"]), _file(panel["file"], folder))
        frames = entry["frames"]
        if not isinstance(frames, int) or frames < 1:
            raise ValueError(f"frames is {frames}, not a whole number above 0")
        if not panels:
            raise ValueError("a shot has no picture")
        label = str(entry["label"])
        shots.append(Shot(label, start, frames, bool(entry["is_movie"]), panels))
        start += frames
    if start > MAX_FRAMES:
        raise ValueError(f"a reel has {start - 1} frames, more than Blender's scenes")
    if not shots:
        raise ValueError("shots is empty")
    return shots


def _file(name: str, folder: Path) -> Path:
    """The path of a picture in the review's folder. Raises `ValueError` if it is outside of this folder."""
    path = folder / name
    if not path.resolve().is_relative_to(folder):
        raise ValueError(f"{name} leads out of the folder")
    return path


def picture_strip(strips: Any, name: str, file: Path, channel: int, shot: Shot) -> Any:
    """Add a strip with a still image or a movie, as long as its shot."""
    new = strips.new_movie if shot.is_movie else strips.new_image
    strip = new(name, str(file), channel, shot.start, fit_method="ORIGINAL")
    strip.frame_final_duration = shot.frames
    strip.select = False
    return strip


def place(strip: Any, grid: Grid, panel: str) -> None:
    """Place a picture in its quadrant, scaled to the layout's picture size without smoothing."""
    element = strip.elements[0]
    scale = min(
        grid.panel_px[0] / max(1, element.orig_width),
        grid.panel_px[1] / max(1, element.orig_height),
    )
    strip.transform.scale_x = strip.transform.scale_y = scale
    strip.transform.offset_x, strip.transform.offset_y = grid.middle_px(panel)
    strip.transform.filter = "NEAREST"


def label(
    strips: Any, text: str, at: tuple[float, float], channel: int, shot: Shot
) -> None:
    """Add a strip with white text, as long as its shot. `at` is the text's left end, vertically centred."""
    strip = strips.new_effect(
        text[:60], "TEXT", channel, shot.start, length=shot.frames
    )
    strip.text, strip.font_size = text, 18.0
    strip.location = at
    strip.anchor_x, strip.anchor_y, strip.alignment_x = "LEFT", "CENTER", "LEFT"
    strip.color = (0.9, 0.9, 0.9, 1.0)
    strip.blend_type = "ALPHA_OVER"
    strip.select = False


def add_shot(strips: Any, shot: Shot, grid: Grid, gain: float) -> None:
    """Add the strips of one shot: up to three pictures, their difference, and the labels."""
    for name, panel in shot.panels.items():
        title = f"{panel.title}: {shot.label}"[:60]
        strip = picture_strip(strips, title, panel.file, CHANNELS[name], shot)
        strip.blend_type = "ALPHA_OVER"
        place(strip, grid, name)
    titles = {name: panel.title for name, panel in shot.panels.items()}
    if "truth" in shot.panels and "space_time" in shot.panels:
        add_difference(strips, shot, grid, gain)
        titles["diff"] = f"|Truth - ST-LFR| x {gain:g}"
    for channel, (name, title) in enumerate(titles.items(), FIRST_LABEL_CHANNEL):
        label(strips, title, grid.label_at(name), channel, shot)
    label(
        strips, shot.label, grid.headline_at, FIRST_LABEL_CHANNEL + len(QUADRANTS), shot
    )


def add_difference(strips: Any, shot: Shot, grid: Grid, gain: float) -> None:
    """Add a meta strip that shows |truth - ST-LFR| times the gain.

    It contains both pictures, the upper one with the blend mode difference. The gain is the meta strip's colour factor.
    """
    meta = strips.new_meta(
        f"Difference: {shot.label}"[:60], CHANNELS["diff"], shot.start
    )
    for channel, name in enumerate(("truth", "space_time"), start=1):
        panel = shot.panels[name]
        title = f"{panel.title} (difference)"
        strip = picture_strip(meta.strips, title, panel.file, channel, shot)
        strip.blend_type = "DIFFERENCE" if channel == 2 else "REPLACE"
        place(strip, grid, "diff")
    meta.frame_final_duration = shot.frames
    meta.color_multiply = gain
    meta.blend_type = "ALPHA_OVER"
    meta.select = False


def add_reel(scene: Any, reel: Reel) -> None:
    """Fill a scene with all the shots of a reel, one after the other."""
    shots = reel.shots
    sizes = [
        picture_size(panel.file) for shot in shots for panel in shot.panels.values()
    ]
    width, height = (max(side) for side in zip(*sizes, strict=True))
    scale = -(-MIN_PANEL_PX // width)
    grid = Grid((width * scale, height * scale))
    configure(scene, reel.rate_hz, grid)
    editor = scene.sequence_editor_create()
    editor.use_prefetch = (
        False  # prefetching fills the memory with pictures that aren't shown
    )
    total = sum(shot.frames for shot in shots)
    ground = editor.strips.new_effect(
        "Background", "COLOR", BACKGROUND_CHANNEL, 1, length=total
    )
    ground.color = (0.09, 0.09, 0.09)
    ground.select = False
    for shot in shots:
        add_shot(editor.strips, shot, grid, reel.gain)
        scene.timeline_markers.new(shot.label[:60], frame=shot.start)
    scene.frame_start, scene.frame_end = 1, total
    scene.frame_set(1)
    for panel, channel in CHANNELS.items():
        editor.channels[channel].name = CHANNEL_NAMES[panel]
    editor.channels[BACKGROUND_CHANNEL].name = "Background"


def picture_size(path: Path) -> tuple[int, int]:
    """Width and height of an image or a movie file. Raises `BadInputError` if the file is neither."""
    is_image = path.suffix == ".png"
    kind = bpy.data.images if is_image else bpy.data.movieclips
    try:
        loaded = kind.load(str(path))
    except RuntimeError:
        raise BadInputError(f"{path}: can't be read as a picture") from None
    size = (loaded.size[0], loaded.size[1])
    frames = 1 if is_image else loaded.frame_duration  # 0 for a file that is no movie
    kind.remove(loaded)
    if min(*size, frames) < 1:
        raise BadInputError(f"{path}: can't be read as a picture")
    return size


def configure(scene: Any, rate_hz: float, grid: Grid) -> None:
    """Set a scene's image size, frame rate and colour management, so that pixel values are shown unchanged."""
    render = scene.render
    render.resolution_x, render.resolution_y = grid.size_px
    render.resolution_percentage = 100
    rate = Fraction(rate_hz).limit_denominator(1001)
    whole = max(1, round(rate))
    render.fps, render.fps_base = whole, float(whole / rate)
    render.use_sequencer, render.dither_intensity = True, 0.0
    scene.display_settings.display_device = "sRGB"
    scene.sequencer_colorspace_settings.name = "sRGB"
    view = scene.view_settings
    view.view_transform, view.look = "Standard", "None"
    view.exposure, view.gamma = 0.0, 1.0


def read_reels(layout_file: Path) -> list[Reel]:
    """The reels of a review.json file. Raises `BadInputError` if the file is invalid or has no reels."""
    try:
        layout = json.loads(reading.read_text(layout_file))
    except (OSError, ValueError) as error:
        raise BadInputError(f"{layout_file}: can't be read ({error})") from None
    is_review = isinstance(layout, dict) and layout.get("format") == "stlfr-review"
    if not is_review or layout.get("version") != 1:
        raise BadInputError(f"{layout_file}: is no stlfr-review of version 1")
    try:
        reels = [
            _reel(entry, layout, layout_file.resolve().parent)
            for entry in layout["reels"]
        ]
    except KeyError as error:
        raise BadInputError(f"{layout_file}: has no {error.args[0]}") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise BadInputError(f"{layout_file}: is no such layout ({error})") from None
    if not reels:
        raise BadInputError(
            f"{layout_file}: reels is empty, so there is nothing to show"
        )
    return reels


def _reel(entry: dict[str, Any], layout: dict[str, Any], folder: Path) -> Reel:
    rate_hz = float(entry["rate_hz"])
    if not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
        raise ValueError(
            f"rate_hz is {rate_hz}, not between {MIN_RATE_HZ:g} and {MAX_RATE_HZ:g}"
        )
    gain = float(layout["difference_gain"])
    return Reel(str(entry["name"]), rate_hz, read_shots(entry["shots"], folder), gain)


def add_all(layout_file: Path, instead_of: Sequence[Any] = ()) -> list[Any]:
    """Add a scene for every reel of review.json, and return these scenes in the file's order.

    The scenes `instead_of` are removed. On an error, nothing is added or removed.
    """
    reels = read_reels(layout_file)
    added: list[Any] = []
    try:
        for reel in reels:
            added.append(bpy.data.scenes.new(reel.name))
            add_reel(added[-1], reel)
    except BaseException:
        for scene in added:
            bpy.data.scenes.remove(scene)
        raise
    for scene in instead_of:
        bpy.data.scenes.remove(scene)
    for scene, reel in zip(added, reels, strict=True):
        scene.name = reel.name  # a removed scene may have had this name
    return added
