"""The whole check as one result, as it is printed in JSON, and as a table for people."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from . import model
from .capture import Camera, exported_model, lens_of, pose_of, read_json
from .frames import pictures_of_one_instant
from .mapping import poses_from_pixels
from .residuals import (
    POSITION_TOLERANCE_MM,
    ROTATION_TOLERANCE_DEG,
    STANDARD_ERRORS,
    residuals,
)

PIXEL_FIELDS = (
    "rotation_deg",
    "rotation_std_err_deg",
    "position_mm",
    "position_std_err_mm",
)
"""What the pixels say of a camera."""

FORMATS = ("landscape", "portrait", "square")
FITS = ("AUTO", "HORIZONTAL", "VERTICAL")


def check(
    folder: Path,
    capture: Any,
    project: model.Projector,
    pycolmap: Any,
    conversion: Any,
) -> dict[str, Any]:
    """Model and pixels. `capture` is the `stlfr` module's, `conversion` the extension's module `described`."""
    cameras: list[Camera] = read_json(folder / "capture.json")["cameras"]
    checked_model, problems = check_model(
        folder, cameras, project, pycolmap, conversion
    )
    checked_pixels, more = check_pixels(folder, capture, cameras, pycolmap)
    problems += more
    return {
        "model": checked_model,
        **checked_pixels,
        "ok": not problems,
        "reason": "; ".join(problems) or None,
    }


def check_model(
    folder: Path,
    cameras: list[Camera],
    project: model.Projector,
    pycolmap: Any,
    conversion: Any,
) -> tuple[dict[str, Any], list[str]]:
    """Projections of this capture's cameras, of every lens model, and of every kind of Blender camera.

    pycolmap reads the capture's COLMAP model where it has one, so that both exports are checked
    against each other; else capture.json's numbers.
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
    pycolmap_px = max(
        capture_px, *lenses_px.values(), *(d.pycolmap_px for d in blender)
    )
    problems = []
    if not pycolmap_px <= model.TOLERANCE_PX:
        problems.append(
            f"pycolmap and stlfr project points up to {pycolmap_px:.3g} px apart"
        )
    blender_px = max(d.blender_px for d in blender)
    if not blender_px <= model.BLENDER_TOLERANCE_PX:
        problems.append(
            f"Blender and stlfr project points up to {blender_px:.3g} px apart"
        )
    return found, problems


def finite(distances_px: list[float]) -> float | None:
    """The largest distance; None if only one of the two sees some points."""
    largest = max(distances_px)
    return largest if np.isfinite(largest) else None


def check_pixels(
    folder: Path, capture: Any, cameras: list[Camera], pycolmap: Any
) -> tuple[dict[str, Any], list[str]]:
    """Where the images of one instant put each camera, against where the capture does."""
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
    by_id = {}
    if len(estimated) > 1:
        by_id = {r.id: r for r in residuals(exported, estimated)}
    for entry in entries:
        if entry["id"] in by_id:
            residual = by_id[entry["id"]]
            entry.update({name: getattr(residual, name) for name in PIXEL_FIELDS})
    problems = []
    missing = [c["id"] for c in cameras if c["id"] not in by_id]
    if missing:
        problems.append(
            f"pycolmap could not place {', '.join(missing)} from the images"
        )
    off = [r.id for r in by_id.values() if r.is_off]
    if off:
        problems.append(
            f"the images put {', '.join(off)} elsewhere than the capture does"
        )
    return found, problems


# For people


def table(result: dict[str, Any]) -> str:
    """Pixels first, because they differ from capture to capture; then the models."""
    return "\n".join([*pixels_table(result), "", *model_table(result["model"])])


def pixels_table(result: dict[str, Any]) -> list[str]:
    """One line for each camera."""
    lines = [
        f"{'camera':<12} {'rotation':>10} {'std. error':>10} {'position':>10} {'std. error':>10}"
    ]
    for camera in result["cameras"]:
        values = [camera[name] for name in PIXEL_FIELDS]
        cells = [" " * 9 + "-"] * 4
        if values[0] is not None:
            cells = [f"{v:>6.3f} deg" for v in values[:2]]
            cells += [f"{v:>7.2f} mm" for v in values[2:]]
        lines.append(" ".join([f"{camera['id']:<12}", *cells]))
    lines += [
        f"{'tolerance':<12} {result['rotation_tolerance_deg']:>6.3f} deg {'':>10}"
        f" {result['position_tolerance_mm']:>7.2f} mm,"
        f" or {result['tolerance_std_errs']:g} standard errors if that is more",
        f"images: {result['image_source'] or 'none'}",
    ]
    return lines


def model_table(found: dict[str, Any]) -> list[str]:
    """The largest difference of a projection: by lens model, and by image format and sensor fit."""
    source = "its COLMAP model" if found["colmap_folder"] else "its numbers"
    lines = [
        f"{'stlfr against pycolmap':<36} tolerance {found['tolerance_px']:.0e} px",
        f"  {f'this capture, by {source}':<34} {shown(found['capture_px'])}",
    ]
    for lens in found["lenses"]:
        lines.append(f"  {lens['model']:<34} {shown(lens['pycolmap_px'])}")
    lines += [
        f"  {'Blender cameras':<34} {shown(found['blender_pycolmap_px'])}",
        f"{'stlfr against Blender':<36} tolerance {found['blender_tolerance_px']:.0e} px",
        f"  {'':<10}" + "".join(f" {fit:>12}" for fit in FITS),
    ]
    by_kind = {(d["format"], d["fit"]): d["blender_px"] for d in found["blender"]}
    for name in FORMATS:
        cells = "".join(f" {shown(by_kind[name, fit]):>12}" for fit in FITS)
        lines.append(f"  {name:<10}{cells}")
    return lines


def shown(distance_px: float | None) -> str:
    """A distance as text."""
    return "not the same" if distance_px is None else f"{distance_px:.1e} px"
