"""How live the viewport is: pictures a second while orbiting and scrubbing, from stop to full picture, equal to F12's."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
from driver import Blender, Screen

F12 = 96
"""The key's number: by its name, it arrives with Alt held."""
STEPS = 200
"""How many moves of the pointer, 30 a second, a drag has. Longer takes longer; shorter, and the first picture counts more."""


def all_of_it(screen: Screen, blender: Blender, capture: Path) -> None:
    """Print it, and leave screenshots."""
    camera = blender.ask(f"prepare({str(capture)!r})")
    time.sleep(1.0)
    blender.press((1271, 60), "view()[1].shading.type == 'RENDERED'")
    screen.move(500, 500)
    screen.keys("KP_0")
    time.sleep(1.0)
    blender.ask("one_to_one()")
    time.sleep(1.0)
    blender.wait("counts()['final'] > 0 and not counts()['busy']")
    print(f"the view of {camera}, 640x480")
    worst = difference(screen, blender)
    print(f"largest difference from F12's picture: {worst:.0f} of 255")
    orbit(screen, blender)
    scrub(screen, blender)


def difference(screen: Screen, blender: Blender) -> float:
    """Between the viewport at rest and F12's picture, of 255."""
    left, top, width, height = blender.ask("frame()")
    shown = cv2.imread(str(screen.shot("at-rest")))
    blender.ask("setattr(bpy.context.preferences.view, 'render_display_type', 'NONE')")
    screen.keys(F12)
    blender.wait("bpy.app.is_job_running('RENDER') or has_render()")
    blender.wait("not bpy.app.is_job_running('RENDER') and has_render()")
    file = screen.scratch / "f12.png"
    blender.ask(f"bpy.data.images['Render Result'].save_render({str(file)!r})")
    expected = cv2.imread(str(file))
    assert shown is not None and expected is not None
    part = shown[top : top + height, left : left + width].astype(np.int32)
    assert part.shape == expected.shape, (part.shape, expected.shape)
    cv2.imwrite(str(screen.pictures / "f12-saved.png"), expected)
    return float(np.abs(part - expected).max())


def orbit(screen: Screen, blender: Blender) -> None:
    """With the camera locked to the view: its place changes, time doesn't."""
    blender.ask("setattr(view()[1], 'lock_camera', True)")
    moves = [(1, 0) if k % 60 < 30 else (-1, 0) for k in range(STEPS)]
    timed(screen, blender, "orbiting", ((500, 500), moves, 2))
    blender.ask("setattr(view()[1], 'lock_camera', False)")


def scrub(screen: Screen, blender: Blender) -> None:
    """On the timeline, at a tenth of the film's speed."""
    x, y = blender.spot("DOPESHEET_EDITOR", "WINDOW", 60, 10)
    screen.move(x, y + 15)
    screen.keys("Home")
    time.sleep(2.0)
    blender.wait("not counts()['busy']")
    timed(screen, blender, "scrubbing", ((x, y), [(5, 0)] * STEPS, 1))


Drag = tuple[tuple[float, float], list[tuple[int, int]], int]


def timed(screen: Screen, blender: Blender, what: str, drag: Drag) -> None:
    """Pictures a second during a drag, and how long after its last move the full picture is drawn."""
    before, start_s = blender.ask("counts()"), time.monotonic()
    screen.drag(*drag)
    after, end_s = blender.ask("counts()"), time.monotonic()
    screen.shot(what)
    blender.wait("not counts()['busy']")
    time.sleep(1.0)
    rest = blender.ask("counts()")
    screen.shot(f"{what}-at-rest")
    rate = (after["fast"] - before["fast"]) / (end_s - start_s)
    rendered = max(1, after["rendered"] - before["rendered"])
    each_ms = 1000 * (after["took_s"] - before["took_s"]) / rendered
    full_s = rest["final_drawn_s"] - rest["asked_s"]
    print(
        f"{what}: {rate:.1f} pictures a second, {each_ms:.0f} ms to render one; "
        f"{full_s:.2f} s from stop to the full picture"
    )
