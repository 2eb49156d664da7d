"""The render engine `STLFR`: F12 renders the scene camera's view of the light field, `Rendered` shading the viewport's."""

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
"""How long Escape may go unnoticed. Larger, and Blender seems to hang; smaller, and asking takes time from rendering."""


said: dict[str, tuple[int, str]] = {}
"""Why the last picture of a scene couldn't be rendered, and at which frame."""


class StlfrEngine(bpy.types.RenderEngine):
    """Renders the chosen capture's light field from the scene's camera, at the scene's time.

    The picture is scene-linear: under the view transform `Standard`, without a look and without
    dither, it is what `stlfr render` writes. Pixels that no camera sees are transparent.
    Known limits: perspective cameras and views, one eye, no depth of field.
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
            # Not `__del__`: Blender has taken what it would read by then.
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
            # Nothing is written then. With `error_set` the sentence would be said twice. In a small window
            # of a render it is cut off: the render properties show all of it.
            said[scene.name] = (scene.frame_current, str(error))
            self.report({"ERROR"}, str(error))
            return
        assert work.samples is not None
        self._show(view.scene_linear(work.samples), depsgraph)

    def _wait(self, work: _Work) -> None:
        """Until the work has ended, or the user has had enough of it.

        What is being rendered then ends at its next step, unseen.
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
        # Blender gives no result where rendering was cancelled meanwhile.
        if result is not None:
            result.layers[0].passes["Combined"].rect.foreach_set(shown.ravel())
            self.end_result(result)


class _Work(threading.Thread):
    """One image in a thread of its own: the module works without Python's lock."""

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
    """The chosen capture."""
    if not scene.stlfr.capture:
        raise BadInputError(
            "no capture is chosen: name its folder in the render properties, under Light Field"
        )
    return absolute(scene.stlfr.capture)


def _camera(engine: StlfrEngine, scene: Any) -> Any:
    return engine.camera_override or scene.camera


def _panels() -> list[Any]:
    """Blender's own panels that serve any engine: output, lens, colour management."""
    return [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ())
    ]


@persistent
def _show_time(*_: Any) -> None:
    """After an animation, show the scene's frame in the properties again."""

    def redraw() -> None:
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type in ("PROPERTIES", "VIEW_3D"):
                    area.tag_redraw()

    # Blender sets the frame back after it has called this.
    bpy.app.timers.register(redraw, first_interval=0.1)


@persistent
def _forget(*_: Any) -> None:
    """Forget the open capture when another file is loaded."""
    said.clear()


HANDLERS = {
    "render_complete": _show_time,
    "render_cancel": _show_time,
    "load_post": _forget,
}


def register() -> None:
    """Make it known to Blender."""
    viewport.register()
    for name, handler in HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)
    bpy.utils.register_class(StlfrEngine)
    for panel in _panels():
        panel.COMPAT_ENGINES.add(StlfrEngine.bl_idname)


def unregister() -> None:
    """Leave nothing behind."""
    for panel in _panels():
        panel.COMPAT_ENGINES.discard(StlfrEngine.bl_idname)
    bpy.utils.unregister_class(StlfrEngine)
    for name, handler in HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(handler)
    viewport.unregister()
