"""Walk through the READMEs' steps in a Blender with a window, by clicks and keys, with a screenshot of each.

As root: `.venv/bin/python tests/window/walk.py ROOT STLFR.zip CAPTURE [-o FOLDER]`. ROOT is where
`blender.sh install` puts Blender; STLFR.zip is what `stlfr setup --extension` writes; CAPTURE is a film of
640x480 (it is copied). FOLDER (`.captures/window`) gets the screenshots, and must lie where `blender.sh`
shows it to Blender: below the folder for temporary files, or below a folder that SHARE names. The last lines
are what was measured. It is run by hand: clicks have the places that widgets have in Blender 5.2 with a window
of 1600x1000.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
PATIENCE_S = 240.0
"""How long a step may take. Larger, and a step that hangs is noticed late; smaller, and a busy machine fails it."""


class Screen:
    """The screen that nobody sees: keys, clicks, pictures."""

    def __init__(self, root: Path, pictures: Path) -> None:
        self.root, self.pictures = root, pictures
        self.count = 0

    def do(self, *command: object) -> str:
        whole = [str(HERE / "blender.sh"), "do", str(self.root), *map(str, command)]
        return subprocess.run(whole, check=True, capture_output=True, text=True).stdout

    def keys(self, *names: object) -> None:
        """By name or number: `F12` by its name arrives with Alt held, so it is 96."""
        for name in names:
            self.do("xdotool", "key", name)
            time.sleep(0.2)

    def type(self, text: str) -> None:
        self.do("xdotool", "type", "--delay", 30, text)

    def move(self, x: float, y: float) -> None:
        self.do("xdotool", "mousemove", round(x), round(y))

    def click(self, x: float, y: float, button: int = 1) -> None:
        # A widget has to see the pointer before it hears the button.
        self.do(
            *("xdotool", "mousemove", round(x), round(y), "sleep", 0.3),
            *("mousedown", button, "sleep", 0.1, "mouseup", button),
        )
        time.sleep(0.5)

    def enter(self, x: float, y: float, text: str) -> None:
        """Into a field, over what it holds."""
        self.do(
            *("xdotool", "mousemove", round(x), round(y), "sleep", 0.3),
            *("click", "--repeat", 2, "--delay", 60, 1),
        )
        time.sleep(0.4)
        self.keys("ctrl+a")
        self.type(text)
        self.keys("Return")
        time.sleep(0.3)

    def drag(self, start: tuple[float, float], moves: list[tuple[int, int]], button: int = 1) -> None:
        """Press, move in steps of 1/60 s, let go."""
        steps: list[object] = []
        for x, y in moves:
            steps += ["mousemove_relative", "--", x, y, "sleep", 1 / 60]
        x, y = (round(value) for value in start)
        self.do("xdotool", "mousemove", x, y, "sleep", 0.3, "mousedown", button, *steps, "mouseup", button)

    def shot(self, name: str) -> Path:
        self.count += 1
        file = self.pictures / f"{self.count:02d}-{name}.png"
        self.do("import", "-window", "root", file)
        return file


class Blender:
    """Blender on that screen."""

    def __init__(self, screen: Screen, work: Path) -> None:
        self.screen, self.work = screen, work
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, *arguments: object) -> None:
        script = shutil.copy(HERE / "inside.py", self.work)
        command = [HERE / "blender.sh", "run", self.screen.root, self.work / "home", *arguments]
        command += ["--python", script, "--", self.work]
        with (self.work / "blender.log").open("ab") as log:
            self.process = subprocess.Popen(list(map(str, command)), stdout=log, stderr=log)
        self.wait("True")
        time.sleep(2.0)

    def ask(self, question: str) -> Any:
        """What an expression is, inside."""
        asked, answer = self.work / "ask", self.work / "answer"
        answer.unlink(missing_ok=True)
        partial = self.work / "ask.partial"
        partial.write_text(question)
        partial.replace(asked)
        until(answer.exists, f"an answer to {question}")
        reply = json.loads(answer.read_text())
        if "error" in reply:
            raise RuntimeError(f"{question}: {reply['error']}")
        return reply["value"]

    def wait(self, question: str) -> None:
        """Until an expression is true, inside."""
        until(lambda: bool(self.ask(question)), question)

    def spot(self, area: str, region: str, x: float, y: float) -> tuple[float, float]:
        """A place on the screen, from a region's top left; negative numbers count from its right or bottom."""
        left, top, width, height = self.ask(f"regions('{area}')")[region]
        return left + x + (width if x < 0 else 0), top + y + (height if y < 0 else 0)

    def click(self, area: str, region: str, x: float, y: float) -> None:
        self.screen.click(*self.spot(area, region, x, y))

    def choose_file(self, name: str) -> None:
        """In Blender's file view."""
        self.wait("'FILE_BROWSER' in [a.type for w in bpy.context.window_manager.windows for a in w.screen.areas]")
        time.sleep(1.0)
        self.click("FILE_BROWSER", "EXECUTE", 200, 20)
        self.screen.keys("ctrl+a")
        self.screen.type(name)
        self.screen.keys("Return")
        time.sleep(1.0)
        self.click("FILE_BROWSER", "EXECUTE", -60, 20)
        time.sleep(2.0)


def until(is_done: Callable[[], bool], what: str) -> None:
    """Wait for it."""
    end_s = time.monotonic() + PATIENCE_S
    while not is_done():
        if time.monotonic() > end_s:
            raise TimeoutError(f"waited {PATIENCE_S:g} s for {what}")
        time.sleep(0.1)


SCENE = """
import importlib, sys
sys.path.insert(0, sys.argv[1])
import bpy
import capture
scenes = importlib.import_module("stlfr_extension.scenes")
scene = scenes.open_scene("magazine", None)
stand = scene.objects.get("rig")
camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
scene.collection.objects.link(camera)
bpy.context.view_layer.update()
if stand is not None:
    camera.matrix_world = stand.matrix_world.copy()
    bpy.data.objects.remove(stand)
elif scene.camera is not None:
    camera.matrix_world = scene.camera.matrix_world.copy()
scene.camera = camera
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[2])
"""
"""A scene as a user has one: textured, something moves, a camera looks at it, no rig."""


def make_scene(file: Path) -> None:
    """Write it."""
    command = [sys.executable, "-c", SCENE, str(HERE.parents[1] / "blender"), str(file)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
