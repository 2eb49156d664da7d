"""The check of a calibration: its result as JSON, and as a table for the user."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from . import model
from .capture import Camera, exported_model, lens_of, pose_of, read_json
from .frames import pictures_of_one_instant
from .mapping import poses_from_pixels
from .residuals import (
    MIN_POINTS,
    POSITION_TOLERANCE_MM,
    ROTATION_TOLERANCE_DEG,
    STANDARD_ERRORS,
    Residual,
    residuals,
)

PIXEL_FIELDS = (
    "rotation_deg",
    "rotation_std_err_deg",
    "position_mm",
    "position_std_err_mm",
    "points",
)
"""Names of a camera's fields in the result that come from its images: how far structure from motion places the camera
from its calibrated pose. They are None for a camera that can't be placed."""

FORMATS = ("landscape", "portrait", "square")
FITS = ("AUTO", "HORIZONTAL", "VERTICAL")


def check(
    folder: Path,
    capture: Any,
    project: model.Projector,
    pycolmap: Any,
    conversion: Any,
) -> dict[str, Any]:
    """Checks a capture's calibration: the projection models, and the poses against its images. Returns the JSON result.

    `capture` is a `stlfr.Capture`, `project` is `stlfr.project`, and `conversion` is the Blender extension's module
    `described`.
    """
    cameras: list[Camera] = read_json(folder / "capture.json")["cameras"]
    checked_model, off, own = check_model(
        folder, cameras, project, pycolmap, conversion
    )
    checked_pixels, found = check_pixels(folder, capture, cameras, pycolmap)
    missing = [c["id"] for c in cameras if c["id"] not in {r.id for r in found}]
    verdict, reason = judged(off, own, found, missing)
    return {
        "model": checked_model,
        **checked_pixels,
        "verdict": verdict,
        "ok": verdict == "right",
        "reason": reason,
    }


def judged(
    off: list[str], own: list[str], found: list[Residual], missing: list[str]
) -> tuple[str, str]:
    """The verdict (`right`, `off`, `unknown` or `inconsistent`), and the reason for it.

    `off` lists errors of the capture's projections, and `own` errors of the program itself. `found` are the cameras'
    residuals. `missing` are the ids of cameras that could not be placed by their images.
    """
    if own:
        return "inconsistent", "; ".join(own)
    if named := [r.id for r in found if r.is_off]:
        off = [
            *off,
            f"the images put {', '.join(named)} elsewhere than the capture does",
        ]
    if off:
        return "off", "; ".join(off)
    if missing:
        which = ", ".join(missing) if found else "any camera"
        return "unknown", f"pycolmap can't place {which} by the images' features"
    fewest = min(found, key=lambda r: r.points)
    if not fewest.is_told:
        return "unknown", (
            f"{fewest.id} sees {fewest.points} points, and {MIN_POINTS} are needed:"
            " a textured scene or larger images have more"
        )
    rotation_deg = max(r.rotation_limit_deg for r in found)
    position_mm = max(r.position_limit_mm for r in found)
    return "right", f"to {rotation_deg:.2f} deg and {position_mm:.1f} mm"


def check_model(
    folder: Path,
    cameras: list[Camera],
    project: model.Projector,
    pycolmap: Any,
    conversion: Any,
) -> tuple[dict[str, Any], list[str], list[str]]:
    """Compares projections of this capture's cameras, of every lens model, and of many settings of Blender's camera.

    Returns the differences as JSON, errors of the capture as sentences, and errors of the program as sentences.

    If the capture has a COLMAP model, pycolmap reads it, so that this model is also checked against capture.json.
    Otherwise, pycolmap uses the numbers of capture.json.
    """
    exported = exported_model(folder, cameras, pycolmap)
    own = exported or {
        c["id"]: (lens_of(c, pycolmap), pose_of(c, pycolmap)) for c in cameras
    }
    capture_px = max(model.difference_px(c, *own[c["id"]], project) for c in cameras)
    lenses_px = model.model_differences_px(project, pycolmap)
    blender = model.blender_differences_px(project, pycolmap, conversion)
    formats = [
        {
            "format": format_name,
            "fit": fit,
            "blender_px": finite(
                [
                    d.blender_px
                    for d in blender
                    if (d.camera.format, d.camera.fit) == (format_name, fit)
                ]
            ),
        }
        for format_name in FORMATS
        for fit in FITS
    ]
    found = {
        "capture_px": finite([capture_px]),
        "colmap_folder": exported is not None,
        "lenses": [
            {"model": name, "pycolmap_px": finite([px])}
            for name, px in lenses_px.items()
        ],
        "blender": formats,
        "blender_pycolmap_px": finite([d.pycolmap_px for d in blender]),
        "tolerance_px": model.TOLERANCE_PX,
        "blender_tolerance_px": model.BLENDER_TOLERANCE_PX,
    }
    off, inconsistent = [], []
    if not capture_px <= model.TOLERANCE_PX:
        off.append(f"its COLMAP model projects points {capture_px:.3g} px elsewhere")
    pycolmap_px = max(*lenses_px.values(), *(d.pycolmap_px for d in blender))
    if not pycolmap_px <= model.TOLERANCE_PX:
        inconsistent.append(f"pycolmap projects points {pycolmap_px:.3g} px elsewhere")
    blender_px = max(d.blender_px for d in blender)
    if not blender_px <= model.BLENDER_TOLERANCE_PX:
        inconsistent.append(f"Blender projects points {blender_px:.3g} px elsewhere")
    return found, off, inconsistent


def finite(distances_px: list[float]) -> float | None:
    """The largest distance in pixels; None if it is infinite, as some point has a pixel by only one projection."""
    largest = max(distances_px)
    return largest if np.isfinite(largest) else None


def check_pixels(
    folder: Path, capture: Any, cameras: list[Camera], pycolmap: Any
) -> tuple[dict[str, Any], list[Residual]]:
    """Compares each camera's calibrated pose with its pose by structure from motion from one image per camera.

    Returns the result's fields as JSON, and the residuals of the cameras that could be placed.
    """
    entries: list[dict[str, Any]] = [
        {"id": c["id"], **dict.fromkeys(PIXEL_FIELDS)} for c in cameras
    ]
    found: dict[str, Any] = {
        "image_source": None,
        "rotation_tolerance_deg": ROTATION_TOLERANCE_DEG,
        "position_tolerance_mm": POSITION_TOLERANCE_MM,
        "tolerance_std_errs": STANDARD_ERRORS,
        "cameras": entries,
    }
    if len(cameras) < 2:
        return found, []
    pictures, found["image_source"] = pictures_of_one_instant(
        folder, capture, cameras, pycolmap
    )
    estimated = poses_from_pixels(pictures, cameras, pycolmap)
    exported = {c["id"]: pose_of(c, pycolmap) for c in cameras}
    differing = residuals(exported, estimated) if len(estimated) > 1 else []
    by_id = {r.id: r for r in differing}
    for entry in entries:
        if entry["id"] in by_id:
            residual = by_id[entry["id"]]
            entry.update({name: getattr(residual, name) for name in PIXEL_FIELDS})
    return found, differing


# The table


VERDICTS = {
    "right": "the calibration is right",
    "off": "the calibration is off:",
    "unknown": "the check can't tell whether the calibration is right:",
    "inconsistent": "the program itself is inconsistent, which says nothing of the calibration:",
}


def closing(result: dict[str, Any]) -> str:
    """The check's verdict and its reason in one line."""
    return f"{VERDICTS[result['verdict']]} {result['reason']}"


def table(result: dict[str, Any]) -> str:
    """The check's result as a table: the capture's cameras, the projection models, and the verdict in the last line."""
    return "\n".join(
        [*pixels_table(result), "", *model_table(result["model"]), "", closing(result)]
    )


def pixels_table(result: dict[str, Any]) -> list[str]:
    """Lines of the table that compare the cameras' poses with their images: one per camera, then the tolerances."""
    lines = [
        f"{'camera':<12} {'rotation':>10} {'std. error':>10} {'position':>10} {'std. error':>10} {'points':>7}"
    ]
    for camera in result["cameras"]:
        values = [camera[name] for name in PIXEL_FIELDS]
        cells = [" " * 9 + "-"] * 4 + [" " * 6 + "-"]
        if values[0] is not None:
            cells = [f"{v:>6.3f} deg" for v in values[:2]]
            cells += [f"{v:>7.2f} mm" for v in values[2:4]] + [f"{values[4]:>7}"]
        lines.append(" ".join([f"{camera['id']:<12}", *cells]))
    lines += [
        f"{'tolerance':<12} {result['rotation_tolerance_deg']:>6.3f} deg {'':>10}"
        f" {result['position_tolerance_mm']:>7.2f} mm,"
        f" or {result['tolerance_std_errs']:g} standard errors if that is more",
        f"images: {result['image_source'] or 'none'}",
    ]
    return lines


def model_table(found: dict[str, Any]) -> list[str]:
    """Lines of the table with the largest differences of projections.

    The first line is about this capture's cameras, if it has a COLMAP model. The last line is about the program's lens
    models and Blender cameras, whatever the capture.
    """
    lines = []
    if found["colmap_folder"]:
        lines.append(
            f"colmap/ against capture.json: {shown(found['capture_px'])} at most"
        )
    lenses = [lens["pycolmap_px"] for lens in found["lenses"]]
    ours = [*lenses, found["blender_pycolmap_px"]]
    theirs = [kind["blender_px"] for kind in found["blender"]]
    lines.append(
        f"the program's own consistency: {largest(ours)} from pycolmap's projections"
        f" ({len(lenses)} lens models), {largest(theirs)} from Blender's ({len(theirs)} kinds of camera)"
    )
    return lines


def largest(distances_px: list[float | None]) -> str:
    """The largest distance as text; `not the same` if one of the distances is unknown (None)."""
    known = [px for px in distances_px if px is not None]
    return shown(max(known) if len(known) == len(distances_px) else None)


def shown(distance_px: float | None) -> str:
    """A distance in pixels as text; `not the same` for None."""
    return "not the same" if distance_px is None else f"{distance_px:.1e} px"
