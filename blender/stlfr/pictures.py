"""The arguments of `stlfr render` for quilts and stereo pairs, from the settings of the render tab.

F12 can't render them, because an image that Blender renders has the size of one view.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from . import camera_path, view
from .described import describe_object
from .errors import BadInputError
from .rig_objects import shortest

STILLS = (".png", ".jpg", ".jpeg")
VIDEOS = (".mp4", ".webm", ".mkv", ".gif")


def words(scene: Any, scratch: Path, animation: bool) -> list[str]:
    """The command line arguments for the view, or for the path of an animation, and for the options and the layout.

    The camera or path and the options are written as files into the folder `scratch`.
    """
    if animation:
        path = scratch / "path.json"
        path.write_text(json.dumps(camera_path.path(scene)), encoding="utf-8")
        seen = ["--path", str(path)]
    else:
        view.require_perspective(scene.camera)
        camera = scratch / "view.json"
        described = describe_object(scene.camera, scene)
        camera.write_text(json.dumps(described), encoding="utf-8")
        seen = ["--camera", str(camera), "--time", repr(view.capture_time_s(scene))]
    options = scratch / "options.json"
    options.write_text(json.dumps(view.options(scene.stlfr)), encoding="utf-8")
    return [*seen, "--options", str(options), *layout_words(scene.stlfr)]


def layout_words(settings: Any) -> list[str]:
    """The command line arguments for the layout: a quilt or a stereo pair, and where its views are placed."""
    if settings.layout == "STEREO":
        found = ["--stereo", repr(shortest(settings.eye_distance_m))]
    else:
        found = ["--quilt", settings.quilt_display]
        if settings.use_cone:
            found += ["--cone", repr(shortest(settings.cone_deg))]
    if settings.use_convergence:
        found += ["--convergence", repr(shortest(settings.convergence_m))]
    return found


def output(wanted: Path, animation: bool) -> Path:
    """The path for `-o`, from the path that the user has set. An animation that isn't a video is a numbered sequence.

    Raises `BadInputError` if the suffix is unsupported, or if it is that of a video, but there is no animation.
    """
    suffix = wanted.suffix.lower()
    if suffix not in (*STILLS, *VIDEOS):
        raise BadInputError(
            f"{wanted.name} must end in {', '.join(STILLS)} or, for an animation, in {', '.join(VIDEOS)}"
        )
    if suffix in VIDEOS:
        if not animation:
            raise BadInputError(
                f"{wanted.name} is a video: name a {STILLS[0]} for one picture"
            )
        return wanted
    # A % would start the placeholder of a frame number.
    stem = wanted.stem.replace("%", "_")
    return wanted.with_name(f"{stem}-%04d{suffix}" if animation else f"{stem}{suffix}")


def written(settings: Any, given: Path, suffixes: dict[str, str]) -> Path:
    """The path of the file that the command writes for `-o GIVEN`; of a sequence, the first file.

    `suffixes` has the suffix of a quilt's name for each display.
    """
    end = "" if settings.layout == "STEREO" else suffixes[settings.quilt_display]
    stem = given.stem if given.stem.endswith(end) else given.stem + end
    return given.with_name(stem.replace("%04d", "0000") + given.suffix)
