"""Viewport shading `Rendered` with the engine `STLFR`: requests pictures for a region's viewpoint, and draws them."""

from __future__ import annotations

import contextlib
import functools
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import blf
import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.batch import batch_for_shader

from . import fields, live, spans, view, viewpoint, words
from .errors import BadInputError
from .viewpoint import Rect

POLL_S = 1 / 60
"""Time between two checks for a new picture. If larger, fewer pictures per second are shown; if smaller, Blender is
woken more often than needed."""

TEXT_PX = 12
"""Text size at interface scale 1. If larger, the text covers the picture; if smaller, it can't be read."""

_all: weakref.WeakSet[live.Live] = weakref.WeakSet()


@dataclass(frozen=True)
class Wish:
    """The picture that a region needs, its place in the region, and the visible part of it.

    `border` is the visible part as fractions of the picture: left, right, bottom, top.
    """

    request: view.Request
    place: Rect
    border: tuple[float, float, float, float]


class Viewport:
    """The display of one viewport region. All methods are called in Blender's main thread."""

    def __init__(self) -> None:
        self.live = live.Live()
        self._texture: tuple[live.Picture, Any] | None = None
        _all.add(self.live)

    def draw(self, engine: Any, context: Any, scene: Any, capture: Path) -> None:
        """Request a picture of the region's view, and draw the latest picture, or a message if there is none."""
        if self.live.is_closed:  # opening another file has closed it, and then failed
            self.live = live.Live()
            _all.add(self.live)
        try:
            wanted = wish(context, scene, capture)
        except BadInputError as error:
            self.live.refuse()
            self._texture = None
            _say(context.region, str(error))
            return
        if self.live.want(wanted.request):
            _follow()
        picture = self.live.picture
        if picture is None:
            self._texture = None
            _say(
                context.region,
                self.live.error or "Light field: preparing the first picture",
            )
            return
        if self._texture is None or self._texture[0] is not picture:
            self._texture = (picture, _texture(picture.pixels))
            self.live.counts.drawn(picture.is_final)
        with _display_space(engine, context.scene):
            _draw(self._texture[1], wanted)
        _say(context.region, status(picture, self.live))

    def refuse(self, region: Any, sentence: str) -> None:
        """Drop the picture, and draw only a message."""
        self.live.refuse()
        self._texture = None
        _say(region, sentence)

    def close(self) -> None:
        """Stop rendering, because the region, the file or the engine is closed."""
        self.live.close()
        self._texture = None


def wish(context: Any, scene: Any, capture: Path) -> Wish:
    """The picture that a region needs at the scene's current frame, through a camera or from a free viewpoint.

    Raises `BadInputError` if the light field can't show this view.
    """
    region, space, shown = context.region, context.space_data, context.region_data
    size_px = (region.width, region.height)
    if shown.view_perspective == "CAMERA":
        through = space.camera
        if through is not None:
            through = through.evaluated_get(context.evaluated_depsgraph_get())
        request = view.request(scene, through, capture)
        corners = np.array(through.data.view_frame(scene=context.scene))
        matrix = np.array(through.matrix_world.normalized())
        corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
        place = viewpoint.frame_rect(
            np.array(shown.perspective_matrix), corners, size_px
        )
        factor = viewpoint.factor_for(request.camera, place)
        camera = viewpoint.scaled(request.camera, factor)
        border = _border(scene.render, scene.render.use_border)
    else:
        camera = viewpoint.camera_of_view(
            np.array(shown.view_matrix), np.array(shown.window_matrix), size_px
        )
        place = Rect(0.0, 0.0, *size_px)
        border = _border(space, space.use_render_border)
    request = view.Request(
        capture,
        view.capture_time_s(scene),
        camera,
        view.options(scene.stlfr),
        fields.stamp_of(capture),
    )
    return Wish(request, place, border)


def _border(of: Any, is_used: bool) -> tuple[float, float, float, float]:
    """The render border as fractions: left, right, bottom, top; the whole picture if the border isn't used.

    `of` is the render settings for a camera's view, or the 3D view's settings for a free view.
    """
    if not is_used:
        return 0.0, 1.0, 0.0, 1.0
    names = ("min_x", "max_x", "min_y", "max_y")
    prefix = "border" if hasattr(of, "border_min_x") else "render_border"
    left, right, bottom, top = (getattr(of, f"{prefix}_{name}") for name in names)
    return left, right, bottom, top


def status(picture: live.Picture, by: live.Live) -> str:
    """The status line of a picture: its methods, its size, and its rendering time or rate."""
    height, width = picture.pixels.shape[:2]
    if picture.is_final:
        took = f"{by.counts.final_took_s:.1f} s"
        return f"Light field: chosen methods, {width} x {height}, {took}"
    rate = f", {by.counts.rate_hz:.0f} a second" if by.counts.rate_hz else ""
    return f"Light field: fast method, {width} x {height}{rate}"


def _texture(pixels: view.Linear) -> Any:
    height, width = pixels.shape[:2]
    buffer = gpu.types.Buffer(
        "FLOAT", pixels.size, np.ascontiguousarray(pixels).ravel()
    )
    return gpu.types.GPUTexture((width, height), format="RGBA16F", data=buffer)


@contextlib.contextmanager
def _display_space(engine: Any, scene: Any) -> Iterator[None]:
    """Within this context, scene-linear values are drawn by the scene's colour management."""
    gpu.state.blend_set("ALPHA_PREMULT")
    engine.bind_display_space_shader(scene)
    try:
        yield
    finally:
        engine.unbind_display_space_shader()
        gpu.state.blend_set("NONE")


def _draw(texture: Any, wanted: Wish) -> None:
    """Draw the part of the picture within the border, at its place in the region."""
    place = wanted.place.snapped(texture.width, texture.height)
    is_exact = place is not wanted.place
    part = place.part(wanted.border)
    left, right, bottom, top = wanted.border
    x, y = part.x + part.width, part.y + part.height
    shader = _exact() if is_exact else gpu.shader.from_builtin("IMAGE")
    batch = batch_for_shader(
        shader,
        "TRI_FAN",
        {
            "pos": ((part.x, part.y), (x, part.y), (x, y), (part.x, y)),
            "texCoord": ((left, bottom), (right, bottom), (right, top), (left, top)),
        },
    )
    shader.bind()
    shader.uniform_sampler("image", texture)
    if is_exact:
        matrix = gpu.matrix.get_projection_matrix() @ gpu.matrix.get_model_view_matrix()
        shader.uniform_float("ModelViewProjectionMatrix", matrix)
    batch.draw(shader)


@functools.cache
def _exact() -> Any:
    """A shader that draws texels unchanged. Blender's own shader interpolates, with an offset of 0.01 pixels."""
    info = gpu.types.GPUShaderCreateInfo()
    interface = gpu.types.GPUStageInterfaceInfo("stlfr_exact")
    interface.smooth("VEC2", "uv")
    info.push_constant("MAT4", "ModelViewProjectionMatrix")
    info.sampler(0, "FLOAT_2D", "image")
    info.vertex_in(0, "VEC2", "pos")
    info.vertex_in(1, "VEC2", "texCoord")
    info.vertex_out(interface)
    info.fragment_out(0, "VEC4", "fragColor")
    info.vertex_source(
        "void main() { uv = texCoord; gl_Position = ModelViewProjectionMatrix * vec4(pos, 0.0, 1.0); }"
    )
    info.fragment_source(
        "void main() { fragColor = texelFetch(image, ivec2(uv * vec2(textureSize(image, 0))), 0); }"
    )
    return gpu.shader.create_from_info(info)


def _say(region: Any, text: str) -> None:
    """Draw a text at the region's lower left, broken into lines."""
    scale = bpy.context.preferences.system.ui_scale
    height = TEXT_PX * scale
    blf.size(0, height)
    advance = blf.dimensions(0, "n")[0]
    columns = max(10, int((region.width - 4 * height) / max(1.0, advance)))
    lines = list(words.wrapped(text[:1].upper() + text[1:], columns))
    gpu.state.blend_set("ALPHA")
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 3, 0.0, 0.0, 0.0, 1.0)
    blf.color(0, 1.0, 1.0, 1.0, 1.0)
    for row, line in enumerate(reversed(lines)):
        blf.position(0, 2 * height, height * (1.5 + 1.5 * row), 0)
        blf.draw(0, line)
    blf.disable(0, blf.SHADOW)
    gpu.state.blend_set("NONE")


def redraw() -> None:
    """Redraw all 3D views with `Rendered` shading."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D" and area.spaces.active.shading.type == "RENDERED":
                for region in area.regions:  # redrawing the sidebars would be slow
                    if region.type == "WINDOW":
                        region.tag_redraw()


def _follow() -> None:
    """Start a timer that checks for new pictures, as long as any may come."""
    if not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=POLL_S)


def _poll() -> float | None:
    shown = list(_all)
    # `is_busy` is read before `take_news`, so that the last picture isn't missed.
    busy = any(one.is_busy for one in shown)
    if True in {one.take_news() for one in shown}:
        redraw()
    return POLL_S if busy else None


@persistent
def end_all(*_: Any) -> None:
    """Stop rendering in all viewports, and close the capture: another file is opened, or the extension is disabled."""
    for one in list(_all):
        one.close()
    spans.forget()
    fields.close()


def register() -> None:
    """Register the handler that stops rendering before another file is opened."""
    bpy.app.handlers.load_pre.append(end_all)


def unregister() -> None:
    """Stop rendering in all viewports, and remove the handler and the timer."""
    _exact.cache_clear()
    with contextlib.suppress(ValueError):
        bpy.app.handlers.load_pre.remove(end_all)
    end_all()
    for one in list(_all):
        one.close(live.PATIENCE_S)  # Python may exit afterwards, when no thread may run
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
