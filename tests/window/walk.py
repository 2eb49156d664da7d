"""Walk through the READMEs' steps in a Blender with a window, by clicks and keys, with a screenshot of each.

As root: `.venv/bin/python tests/window/walk.py ROOT STLFR.zip CAPTURE [-o FOLDER]`. ROOT is where
`blender.sh install` puts Blender. STLFR.zip is what `stlfr setup --extension` writes. CAPTURE is a film of
640x480; it is copied. The screenshots go to FOLDER, `.captures/window`. The last lines are what was
measured. It is run by hand: clicks have the places that widgets have in Blender 5.2 with a window of
1600x1000.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import measure
from driver import HERE, Blender, Screen

OVER_VIEW = (500, 500)
"""A place over the 3D view, that keys go to."""
SIDEBAR_TAB, SIDEBAR_TAB_LOWER = (1298, 297), (1298, 343)
"""Lower where an object is selected."""
CREATE_RIG, SHOW_RIG = (1105, 148), (1089, 174)
SAMPLES, FILM, CANCEL = (1204, 380), (1165, 479), (1263, 479)
OFFSETS, COMPARE = (1165, 570), (1165, 792)
LAYOUT, RENDER_TAB, ENGINE, OUR_ENGINE = (
    (300, 34),
    (1331, 304),
    (1480, 300),
    (1491, 394),
)
SET_RANGE, RENDERED = (1480, 532), (1271, 60)

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


class Walk:
    """The steps, one after the other."""

    def __init__(self, screen: Screen, blender: Blender) -> None:
        self.screen, self.blender = screen, blender

    def install(self, extension: Path) -> None:
        """Edit, Preferences, Get Extensions, Install from Disk."""
        screen, blender = self.screen, self.blender
        shutil.copy(extension, blender.home / "stlfr.zip")
        blender.start("--factory-startup")
        screen.click(800, 900)  # the splash screen goes
        screen.keys("Escape")
        screen.click(80, 34)
        time.sleep(1.0)
        screen.click(132, 303)
        time.sleep(3.0)
        blender.wait("'PREFERENCES' in str(all_areas())")
        time.sleep(2.0)
        blender.press(
            blender.spot("PREFERENCES", "UI", 60, 206),
            "bpy.context.preferences.active_section == 'EXTENSIONS'",
        )
        time.sleep(2.0)
        blender.click("PREFERENCES", "WINDOW", -20, 25)
        time.sleep(1.5)
        blender.click("PREFERENCES", "WINDOW", -130, 147)
        blender.choose_file("stlfr.zip")
        blender.wait(
            "'bl_ext.user_default.stlfr' in bpy.context.preferences.addons.keys()"
        )
        screen.shot("installed")
        screen.click(970, 72)

    def all_steps(self) -> None:
        """After the installation."""
        self.open_scene()
        self.create_rig()
        self.film()
        self.compare()
        self.render()
        self.look_around()
        self.refusals()
        self.another_file()

    def open_scene(self) -> None:
        """Of one's own; the sidebar's tab."""
        screen, blender = self.screen, self.blender
        make_scene(blender.home / "mine.blend")
        screen.move(*OVER_VIEW)
        screen.keys("ctrl+o")
        blender.choose_file("mine.blend")
        blender.wait("bpy.data.filepath.endswith('mine.blend')")
        time.sleep(2.0)
        screen.move(*OVER_VIEW)
        screen.keys("n")
        time.sleep(1.0)
        screen.click(*SIDEBAR_TAB)
        time.sleep(1.0)
        screen.shot("sidebar")

    def create_rig(self) -> None:
        """Four small cameras."""
        screen, blender = self.screen, self.blender
        screen.click(*CREATE_RIG)
        time.sleep(2.0)
        for y, text in ((184, "4"), (262, "160"), (288, "120")):
            screen.enter(1045, y, text)
        screen.shot("create-rig")
        screen.click(1060, 449)
        blender.wait(
            "len(part('rig_objects').members(bpy.context.scene, 'CAMERA')) == 4"
        )
        screen.shot("rig")
        blender.press(SHOW_RIG, "last_operator() == 'STLFR_OT_rig_show'")
        time.sleep(2.0)
        screen.shot("rig-shown")
        screen.keys("ctrl+z")
        time.sleep(1.0)

    def film(self) -> None:
        """Cancelled and resumed."""
        screen, blender = self.screen, self.blender
        screen.enter(*SAMPLES, "8")
        blender.press(FILM, "job() == 'Filming'")
        blender.wait("part('jobs').running().progress.done > 0")
        blender.press(CANCEL, "not job()")
        time.sleep(1.0)
        screen.shot("cancelled")
        if blender.ask("part('filming').is_begun(part('paths').absolute('//capture'))"):
            resume = (FILM[0] + 50, FILM[1])  # at the right
            blender.press(resume, "job() == 'Filming'")
            screen.shot("filming")
        blender.wait("not job()")
        time.sleep(1.5)
        screen.shot("filmed")

    def compare(self) -> None:
        """Offsets, the comparison, and back."""
        screen, blender = self.screen, self.blender
        known = "len(bpy.context.scene.stlfr.offsets) == 4"
        blender.press(OFFSETS, f"job() or {known}")
        blender.wait(f"not job() and {known}")
        time.sleep(1.0)
        screen.shot("offsets")
        blender.press(COMPARE, "job() == 'Comparing'")
        screen.shot("comparing")
        blender.wait("not job() and len(bpy.data.scenes) == 3")
        time.sleep(4.0)
        screen.shot("comparison")
        blender.press(
            LAYOUT, "bpy.context.window_manager.windows[0].workspace.name == 'Layout'"
        )
        time.sleep(1.0)

    def render(self) -> None:
        """The engine, F12 at the first frame, the range, an animation."""
        screen, blender = self.screen, self.blender
        screen.click(*RENDER_TAB)
        time.sleep(1.0)
        screen.click(*ENGINE)
        time.sleep(1.0)
        screen.click(*OUR_ENGINE)
        blender.wait("bpy.context.scene.render.engine == 'STLFR'")
        screen.shot("engine")
        screen.move(*OVER_VIEW)
        screen.keys(measure.F12)
        self.rendered("f12")
        blender.press(SET_RANGE, "bpy.context.scene.frame_end < 20")
        screen.move(*OVER_VIEW)
        screen.shot("range")
        blender.ask("setattr(bpy.context.scene.render, 'filepath', '//animation/')")
        screen.keys(f"ctrl+{measure.F12}")
        self.rendered("animation")
        screen.move(*OVER_VIEW)
        time.sleep(1.0)
        screen.shot("after-animation")

    def rendered(self, name: str) -> None:
        """Until a render has ended; a screenshot of its window, which goes."""
        blender = self.blender
        blender.wait("len(bpy.context.window_manager.windows) == 2")
        blender.wait("not bpy.app.is_job_running('RENDER')")
        time.sleep(2.0)
        self.screen.shot(name)
        self.screen.click(1588, 8)
        blender.wait("len(bpy.context.window_manager.windows) == 1")

    def look_around(self) -> None:
        """Rendered shading: through the camera, scrubbed, freely, refused, outside of the film, with a border."""
        screen, blender = self.screen, self.blender
        blender.press(RENDERED, "view()[1].shading.type == 'RENDERED'")
        screen.move(*OVER_VIEW)
        screen.keys("KP_0")
        self.at_rest("camera-view")
        screen.keys("Right", "Right", "Right")
        self.at_rest("three-frames-on")
        screen.keys("space")
        time.sleep(4.0)
        screen.shot("playing")
        screen.keys("space")
        screen.drag(OVER_VIEW, [(2, 1)] * 15, button=2)
        self.at_rest("free-view")
        screen.keys("KP_5")
        time.sleep(1.0)
        screen.shot("orthographic")
        screen.keys("KP_5", "KP_0")
        blender.ask("bpy.context.scene.frame_set(50)")
        time.sleep(3.0)
        screen.shot("outside")
        screen.keys(measure.F12)
        self.rendered("outside-f12")
        screen.shot("outside-properties")
        blender.ask("bpy.context.scene.frame_set(2)")
        screen.move(*OVER_VIEW)
        screen.keys("ctrl+b")
        time.sleep(0.5)
        screen.drag((450, 400), [(8, 6)] * 25)
        self.at_rest("border")
        screen.keys("ctrl+alt+b")

    def at_rest(self, name: str) -> None:
        """Until the full picture is there."""
        time.sleep(0.5)
        self.blender.wait("not counts()['busy']")
        time.sleep(0.5)
        self.screen.shot(name)

    def refusals(self) -> None:
        """An unknown clock, an orthographic camera of the rig, a folder without a capture."""
        screen, blender = self.screen, self.blender
        blender.ask("lose_a_clock()")
        screen.move(*SIDEBAR_TAB)
        time.sleep(1.0)
        screen.shot("unknown-clock")
        blender.ask("setattr(bpy.data.cameras['cam0'], 'type', 'ORTHO')")
        blender.ask("setattr(bpy.context.scene.stlfr, 'film_folder', '//again')")
        screen.click(*FILM)
        time.sleep(2.0)
        screen.shot("orthographic-rig-camera")
        screen.keys("Escape")
        blender.ask("setattr(bpy.data.cameras['cam0'], 'type', 'PERSP')")
        blender.ask("setattr(bpy.context.scene.stlfr, 'capture', '//')")
        time.sleep(2.0)
        screen.shot("no-capture")
        blender.ask("setattr(bpy.context.scene.stlfr, 'capture', '//capture')")

    def another_file(self) -> None:
        """A new file while filming: the film goes on, and its end is said."""
        screen, blender = self.screen, self.blender
        blender.press(FILM, "job() == 'Filming'")
        screen.move(*OVER_VIEW)
        screen.keys("ctrl+s")
        time.sleep(2.0)
        screen.keys("ctrl+n")
        time.sleep(1.0)
        screen.keys("Return")
        blender.wait("not bpy.data.filepath")
        time.sleep(1.0)
        screen.move(*OVER_VIEW)
        screen.keys("n")
        time.sleep(1.0)
        screen.click(*SIDEBAR_TAB_LOWER)
        time.sleep(1.0)
        screen.shot("new-file-while-filming")
        blender.wait("not job() and part('jobs').ended")
        time.sleep(1.0)
        screen.shot("film-ended")
        screen.keys("n")


def main() -> int:
    """All of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name in ("root", "extension", "capture"):
        parser.add_argument(name, type=Path)
    output = HERE.parents[1] / ".captures" / "window"
    parser.add_argument("-o", dest="output", type=Path, default=output)
    parser.add_argument("--measure", action="store_true", help="leave the steps out")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="stlfr-window-") as scratch:
        work = Path(scratch)
        screen = Screen(given.root, work / "shots", given.output)
        blender = Blender(screen, work)
        walk = Walk(screen, blender)
        try:
            walk.install(given.extension)
            if not given.measure:
                walk.all_steps()
            shutil.copytree(given.capture, work / "measured")
            measure.all_of_it(screen, blender, work / "measured")
        finally:
            screen.shot("last")
            blender.stop()
            (given.output / "blender.log").write_bytes(blender.log.read_bytes())
    return 0


if __name__ == "__main__":
    sys.exit(main())
