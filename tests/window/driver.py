"""Blender on a screen that nobody sees: keys, clicks, screenshots, and questions to inside.py."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
PATIENCE_S = 240.0
"""How long a step may take. Larger, and a step that hangs is noticed late; smaller, and a busy machine fails it."""


class Screen:
    """The screen that nobody sees: keys, clicks, pictures."""

    def __init__(self, root: Path, scratch: Path, pictures: Path) -> None:
        """Screenshots are taken into `scratch`, which the screen's programs see, and go to `pictures`."""
        self.root, self.scratch, self.pictures = root, scratch, pictures
        self.count = 0
        scratch.mkdir(exist_ok=True)
        pictures.mkdir(parents=True, exist_ok=True)
        for old in pictures.glob("[0-9]*.png"):
            old.unlink()

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

    def drag(
        self, start: tuple[float, float], moves: list[tuple[int, int]], button: int = 1
    ) -> None:
        """Press, move in steps of 1/30 s, let go."""
        steps: list[object] = []
        for x, y in moves:
            steps += ["mousemove_relative", "--", x, y, "sleep", 1 / 30]
        x, y = (round(value) for value in start)
        self.do(
            "xdotool",
            "mousemove",
            x,
            y,
            "sleep",
            0.3,
            "mousedown",
            button,
            *steps,
            "mouseup",
            button,
        )

    def shot(self, name: str) -> Path:
        self.count += 1
        file = self.scratch / f"{self.count:02d}-{name}.png"
        self.do("import", "-window", "root", file)
        return Path(shutil.move(file, self.pictures / file.name))


class Blender:
    """Blender on that screen."""

    def __init__(self, screen: Screen, work: Path) -> None:
        self.screen, self.work = screen, work
        self.home, self.log = work / "home", work / "blender.log"
        self.home.mkdir()
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, *arguments: object) -> None:
        script = shutil.copy(HERE / "inside.py", self.work)
        command = [
            HERE / "blender.sh",
            "run",
            self.screen.root,
            self.home,
            *arguments,
        ]
        command += ["--python", script, "--", self.work]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                list(map(str, command)), stdout=log, stderr=log
            )
        self.wait("True")
        time.sleep(5.0)

    def stop(self) -> None:
        """Ask it to quit, as a user does."""
        if self.process is None:
            return
        (self.work / "ask").write_text(
            "bpy.app.timers.register(lambda: bpy.ops.wm.quit_blender() and None)"
        )
        try:
            self.process.wait(30.0)
        except subprocess.TimeoutExpired:
            self.process.kill()

    def ask(self, question: str) -> Any:
        """What an expression is, inside."""
        asked, answer = self.work / "ask", self.work / "answer"
        answer.unlink(missing_ok=True)
        partial = self.work / "ask.partial"
        partial.write_text(question)
        partial.replace(asked)
        until(lambda: self.must_run() and answer.exists(), f"an answer to {question}")
        reply = json.loads(answer.read_text())
        if "error" in reply:
            raise RuntimeError(f"{question}: {reply['error']}")
        return reply["value"]

    def must_run(self) -> bool:
        """An error where it has ended."""
        if self.process is not None and self.process.poll() is not None:
            raise RuntimeError(f"Blender has ended: {self.log.read_text()[-500:]}")
        return True

    def wait(self, question: str) -> None:
        """Until an expression is true, inside."""
        until(lambda: bool(self.ask(question)), question)

    def spot(self, area: str, region: str, x: float, y: float) -> tuple[float, float]:
        """A place on the screen, from a region's top left; negative numbers count from its right or bottom."""
        left, top, width, height = self.ask(f"regions('{area}')")[region]
        return left + x + (width if x < 0 else 0), top + y + (height if y < 0 else 0)

    def click(self, area: str, region: str, x: float, y: float) -> None:
        self.screen.click(*self.spot(area, region, x, y))

    def press(self, place: tuple[float, float], question: str) -> None:
        """Click until it has done what it does: a busy window may not have heard the first click."""
        for _ in range(5):
            self.screen.click(*place)
            for _ in range(15):
                if self.ask(question):
                    return
                time.sleep(0.3)
        raise TimeoutError(f"clicked at {place}, and not: {question}")

    def choose_file(self, name: str) -> None:
        """In Blender's file view."""
        self.wait("'FILE_BROWSER' in all_areas()")
        time.sleep(1.0)
        for _ in range(5):
            self.click("FILE_BROWSER", "EXECUTE", 200, 20)
            self.screen.keys("ctrl+a")
            self.screen.type(name)
            self.screen.keys("Return")
            time.sleep(1.0)
            if self.ask(f"file_name() in ('', {name!r})"):
                break
        for _ in range(5):
            if not self.ask("'FILE_BROWSER' in all_areas()"):
                return
            self.click("FILE_BROWSER", "EXECUTE", -60, 20)
            time.sleep(2.0)


def until(is_done: Callable[[], bool], what: str) -> None:
    """Wait for it."""
    end_s = time.monotonic() + PATIENCE_S
    while not is_done():
        if time.monotonic() > end_s:
            raise TimeoutError(f"waited {PATIENCE_S:g} s for {what}")
        time.sleep(0.1)
