"""The extension's open capture: it is opened in a background thread, for which Blender's main thread doesn't wait."""

from __future__ import annotations

import importlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import filming  # noqa: F401 - loads the modules under test
import pytest

fields = importlib.import_module("stlfr_extension.fields")
spans = importlib.import_module("stlfr_extension.spans")
timing = importlib.import_module("stlfr_extension.timing")


class Module:
    """A fake of the module `stlfr`, whose `open` returns only when the test allows it."""

    def __init__(self) -> None:
        self.opened: list[Path] = []
        self.go_on = threading.Event()
        self.go_on.set()
        self.error: BaseException | None = None

    def open(self, folder: Path) -> Any:
        self.opened.append(folder)
        assert self.go_on.wait(10)
        if self.error is not None:
            raise self.error
        return SimpleNamespace(reference="cam0", times=lambda _: [0.5, 1.0, 1.5])


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Iterator[Module]:
    fake = Module()
    monkeypatch.setitem(sys.modules, "stlfr", fake)
    fields.close()
    yield fake
    fake.go_on.set()
    fields.close(10.0)
    spans.forget()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "capture.json").write_text("{}")
    return tmp_path


@pytest.fixture
def redrawn(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of redrawn areas, in a fake Blender with a window, whose timers the test calls."""
    drawn: list[str] = []
    areas = [
        SimpleNamespace(type=kind, tag_redraw=lambda kind=kind: drawn.append(kind))
        for kind in ("PROPERTIES", "VIEW_3D")
    ]
    window = SimpleNamespace(screen=SimpleNamespace(areas=areas))
    timers = SimpleNamespace(
        is_registered=lambda _: False, register=lambda *_, **__: None
    )
    app = SimpleNamespace(background=False, timers=timers)
    manager = SimpleNamespace(windows=[window])
    context = SimpleNamespace(window_manager=manager)
    monkeypatch.setattr(spans, "bpy", SimpleNamespace(app=app, context=context))
    return drawn


def until(is_done: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 5
    while not is_done():
        assert time.monotonic() < end_s, "it takes too long"
        time.sleep(0.005)


def test_it_is_opened_once_until_it_changes(module: Module, folder: Path) -> None:
    assert not fields.knows_span(folder)
    for _ in range(3):
        assert fields.span_s(folder) == (0.5, 1.5)
    assert module.opened == [folder] and fields.knows_span(folder)
    (folder / "offsets.json").write_text("{}")
    assert not fields.knows_span(folder) and fields.span_s(folder) == (0.5, 1.5)
    assert module.opened == [folder, folder]


def test_closing_doesnt_wait_for_what_is_being_opened(
    module: Module, folder: Path
) -> None:
    """A capture whose opening ends after `close` isn't cached."""
    module.go_on.clear()
    fields.read_span(folder)
    until(lambda: bool(module.opened))
    fields.read_span(folder)
    start_s = time.monotonic()
    fields.close()
    assert time.monotonic() - start_s < 1.0 and fields.is_reading()
    module.go_on.set()
    until(lambda: not fields.is_reading())
    assert len(module.opened) == 1 and not fields.knows_span(folder)
    assert fields.span_s(folder) == (0.5, 1.5) and len(module.opened) == 2


def test_two_threads_open_it_once(module: Module, folder: Path) -> None:
    module.go_on.clear()
    fields.read_span(folder)
    until(lambda: bool(module.opened))
    threading.Timer(0.05, module.go_on.set).start()
    assert fields.span_s(folder) == (0.5, 1.5) and len(module.opened) == 1


@pytest.mark.parametrize("error", [ValueError("mine"), ZeroDivisionError("mine")])
def test_what_cant_be_opened_isnt_tried_again(
    module: Module, folder: Path, error: Exception
) -> None:
    module.error = error
    for _ in range(2):
        fields.read_span(folder)
        until(lambda: not fields.is_reading())
    assert fields.knows_span(folder) and fields.span_s(folder) is None
    assert len(module.opened) == 1


def test_panels_wait_for_nothing_and_are_drawn_anew(
    module: Module, folder: Path, redrawn: list[str]
) -> None:
    """A newly chosen capture's time offset is set when the capture has been read."""
    module.go_on.clear()
    settings = SimpleNamespace(time_offset_s=0.0)
    start_s = time.monotonic()
    assert not spans.is_known(folder) and not spans.is_known(folder)
    spans.when_known(folder, lambda: timing.adopt_start(settings, folder))
    assert spans._poll() == spans.POLL_S
    assert time.monotonic() - start_s < 1.0 and not redrawn
    module.go_on.set()
    until(lambda: not fields.is_reading())
    assert spans._poll() is None
    assert redrawn == ["PROPERTIES"] and settings.time_offset_s == 0.5
    assert spans.is_known(folder) and len(module.opened) == 1


def test_another_file_ends_what_was_to_be_done(
    module: Module, folder: Path, redrawn: list[str]
) -> None:
    done: list[bool] = []
    module.go_on.clear()
    spans.when_known(folder, lambda: done.append(True))
    spans.forget()
    fields.close()
    module.go_on.set()
    until(lambda: not fields.is_reading())
    assert spans._poll() is None and not done and not redrawn


def test_a_script_goes_on_with_what_it_asked_for(module: Module, folder: Path) -> None:
    settings = SimpleNamespace(time_offset_s=0.0)
    spans.when_known(folder, lambda: timing.adopt_start(settings, folder))
    assert settings.time_offset_s == 0.5
