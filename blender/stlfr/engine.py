"""The render engine `STLFR`: renders the light field from the scene's camera (F12), or in viewports."""

from __future__ import annotations

import threading
import weakref
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from . import fields, view, viewport
from .errors import BadInputError, FailureError
from .paths import absolute

POLL_S = 0.05
"""Time between two checks for the Escape key. If larger, Blender seems to hang; if smaller, the checks slow
rendering."""


said: dict[str, tuple[int, str]] = {}
"""Errors of the last rendering by scene name: the frame, and why it couldn't be rendered. The panel shows them."""


class StlfrEngine(bpy.types.RenderEngine):
    """Renders the chosen capture's light field from the scene's camera, at the scene's time.

    The rendered image is scene-linear. With the view transform `Standard`, no look and no dither, it is displayed and
    saved exactly as `stlfr render` writes it. Pixels that no camera sees are transparent. Known limits: only
    perspective cameras and views, only one eye, no depth of field.
    """

    bl_idname = "STLFR"
    bl_label = "Light Field (stlfr)"
    bl_use_preview = False
    bl_use_eevee_viewport = True

    _viewport: viewport.Viewport | None = None

    def view_update(self, context: Any, depsgraph: Any) -> None:
        """Required by Blender; changes are read when drawing."""

    def view_draw(self, context: Any, depsgraph: Any) -> None:
        if self._viewport is None:
            self._viewport = viewport.Viewport()
            # Not `__del__`: by then, Blender has freed the data that it would read.
            weakref.finalize(self, self._viewport.close).atexit = False
        try:
            capture = capture_folder(depsgraph.scene)
        except BadInputError as error:
            self._viewport.refuse(context.region, str(error))
            return
        self._viewport.draw(self, context, depsgraph.scene, capture)

    def render(self, depsgraph: Any) -> None:
        scene = depsgraph.scene
        said.pop(scene.name, None)
        try:
            work = _Work(
                view.request(scene, _camera(self, scene), capture_folder(scene))
            )
            self._wait(work)
            if work.error is not None:
                raise work.error
        except fields.StoppedError:
            return
        except (BadInputError, FailureError) as error:
            # No image is written then. `error_set` would report the error twice. A small render window cuts the
            # sentence off, so the render properties show it too.
            said[scene.name] = (scene.frame_current, str(error))
            self.report({"ERROR"}, str(error))
            return
        assert work.samples is not None
        self._show(view.scene_linear(work.samples), depsgraph)

    def _wait(self, work: _Work) -> None:
        """Wait until the image is rendered, and show the progress.

        If the user cancels, raises `StoppedError`; the thread ends at its next step, and its image is discarded.
        """
        work.start()
        while not work.ended.wait(POLL_S):
            if self.test_break():
                work.stop.set()
                raise fields.StoppedError
            done, total = work.progress
            self.update_stats(
                "", f"Light field, instant {min(done + 1, total)} of {total}"
            )
            self.update_progress(done / total)

    def _show(self, pixels: Any, depsgraph: Any) -> None:
        height, width = pixels.shape[:2]
        left, right, bottom, top = view.border_px(depsgraph.scene.render, width, height)
        shown = pixels[bottom:top, left:right]
        result = self.begin_result(
            0, 0, right - left, top - bottom, layer=depsgraph.view_layer.name
        )
        # Blender returns no result if rendering was cancelled in the meantime.
        if result is not None:
            result.layers[0].passes["Combined"].rect.foreach_set(shown.ravel())
            self.end_result(result)


class _Work(threading.Thread):
    """A thread that renders one image. Blender stays responsive, because the module `stlfr` releases the GIL."""

    def __init__(self, request: view.Request) -> None:
        super().__init__(daemon=True)
        self.request = request
        self.stop = threading.Event()
        self.ended = threading.Event()
        self.progress = (0, 1)
        self.samples: view.Samples | None = None
        self.error: Exception | None = None

    def run(self) -> None:
        try:
            self.samples = fields.render(self.request, self._proceed)
        except (BadInputError, FailureError, fields.StoppedError) as error:
            self.error = error
        except BaseException as error:  # noqa: BLE001 - a panic of the module is no Exception
            self.error = FailureError(
                f"rendering failed: {error} ({type(error).__name__})"
            )
        finally:
            self.ended.set()

    def _proceed(self, done: int, total: int) -> bool:
        self.progress = (done, total)
        return not self.stop.is_set()


def capture_folder(scene: Any) -> Path:
    """The folder of the capture that is chosen in the scene. Raises `BadInputError` if none is chosen."""
    if not scene.stlfr.capture:
        raise BadInputError(
            "no capture is chosen: name its folder in the render properties, under Light Field"
        )
    return absolute(scene.stlfr.capture)


def _camera(engine: StlfrEngine, scene: Any) -> Any:
    return engine.camera_override or scene.camera


def _panels() -> list[Any]:
    """Blender's own panels that suit any render engine, such as output, lens and colour management."""
    return [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ())
    ]


@persistent
def _show_time(*_: Any) -> None:
    """Handler after rendering an animation: redraws the properties, as Blender has set the scene's frame back."""

    def redraw() -> None:
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type in ("PROPERTIES", "VIEW_3D"):
                    area.tag_redraw()

    # Blender sets the frame back only after it has called this handler.
    bpy.app.timers.register(redraw, first_interval=0.1)


@persistent
def _forget(*_: Any) -> None:
    """Handler after another file is loaded: forgets the errors of renderings of the previous file."""
    said.clear()


HANDLERS = {
    "render_complete": _show_time,
    "render_cancel": _show_time,
    "load_post": _forget,
}


def register() -> None:
    """Register the engine, its handlers and Blender's own panels for it."""
    viewport.register()
    for name, handler in HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)
    bpy.utils.register_class(StlfrEngine)
    for panel in _panels():
        panel.COMPAT_ENGINES.add(StlfrEngine.bl_idname)


def unregister() -> None:
    """Unregister the engine, its handlers and Blender's own panels for it."""
    for panel in _panels():
        panel.COMPAT_ENGINES.discard(StlfrEngine.bl_idname)
    bpy.utils.unregister_class(StlfrEngine)
    for name, handler in HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(handler)
    viewport.unregister()
