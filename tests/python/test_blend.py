"""Filming a user's .blend file: its animation is filmed, the file isn't changed, its render settings have no effect."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import ROOT, by_script, rig_camera, write_rig


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig file with one camera and tiny images."""
    folder = tmp_path_factory.mktemp("rig")
    return write_rig(folder / "rig.json", rig_camera("only", delay_s=0.01), name="one")


def own_scene() -> Any:
    """A scene with a keyframed cube and its driver-animated child, in front of a plane; the camera is 4 m away."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = 25, 11, 60
    scene.render.engine = "CYCLES"

    def added(name: str, data: Any) -> Any:
        new = bpy.data.objects.new(name, data)
        scene.collection.objects.link(new)
        return new

    scene.camera = added("camera", bpy.data.cameras.new("camera"))
    scene.camera.location.z = 4.0
    lamp = added("lamp", bpy.data.lights.new("lamp", "SUN"))
    lamp.data.energy, lamp.rotation_euler.x = 3.0, 0.5
    bpy.ops.mesh.primitive_plane_add(size=12)
    bpy.ops.mesh.primitive_cube_add(size=0.8, location=(0, 0, 1))
    cube = bpy.context.object
    for frame, x in ((11, -1.0), (31, 1.0)):
        cube.location.x = x
        cube.keyframe_insert("location", index=0, frame=frame)
    bpy.ops.mesh.primitive_cube_add(size=0.4)
    held = bpy.context.object
    held.parent, held.location.y = cube, 0.8
    held.driver_add("rotation_euler", 2).driver.expression = "frame * 0.1"
    return scene


def saved(path: Path) -> Path:
    """Save the open .blend file at `path`; returns `path`."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def pictures(folder: Path) -> list[bytes]:
    """The contents of the camera's image files, in order."""
    return [file.read_bytes() for file in sorted((folder / "only").glob("*.png"))]


def test_a_blend_is_left_as_it_was_and_its_render_settings_do_not_show(
    rig_file: Path, tmp_path: Path
) -> None:
    bpy = pytest.importorskip("bpy")
    cv2 = pytest.importorskip("cv2")
    scene = own_scene()
    plain = saved(tmp_path / "plain.blend")

    render, view, cycles = scene.render, scene.view_settings, scene.cycles
    render.engine = "BLENDER_WORKBENCH"
    render.resolution_x, render.resolution_percentage = 1920, 37
    render.pixel_aspect_x = 2.0
    render.use_stamp = render.use_border = render.use_crop_to_border = True
    render.border_max_x = 0.3
    render.use_motion_blur = render.use_freestyle = render.film_transparent = True
    render.dither_intensity = 2.0
    render.image_settings.file_format = "JPEG"
    render.image_settings.color_mode = "BW"
    view.view_transform, view.look = "AgX", "AgX - High Contrast"
    view.exposure, view.gamma = 1.5, 2.0
    cycles.samples, cycles.seed, cycles.use_animated_seed = 1, 99, True
    cycles.use_denoising = cycles.use_adaptive_sampling = True
    cycles.film_exposure, cycles.filter_width = 3.0, 5.0
    bpy.context.view_layer.samples = 3
    other = bpy.data.objects.new("other", bpy.data.cameras.new("other"))
    scene.collection.objects.link(other)
    other.location = (5.0, 5.0, 1.0)
    # The rig's pose is that of the active camera at the scene's start; later camera cuts have no effect.
    for name, frame, camera in (("begin", 11, scene.camera), ("cut", 12, other)):
        scene.timeline_markers.new(name, frame=frame).camera = camera
    scene.frame_current = 40
    hostile = saved(tmp_path / "hostile.blend")

    before = hostile.read_bytes(), hostile.stat().st_mtime_ns
    for file in (plain, hostile):
        result = by_script(
            rig_file,
            *("--blend", file, "-o", tmp_path / file.stem),
            *("--frames", 4, "--samples", 4, "--instants", 1, "--tracks", 20),
        )
        assert result.returncode == 0, result.stderr
    assert (hostile.read_bytes(), hostile.stat().st_mtime_ns) == before
    assert not list(tmp_path.glob("*.blend1"))
    frames = pictures(tmp_path / "hostile")
    assert len(frames) == 4 and frames == pictures(tmp_path / "plain")

    # The expected animation: the cube moves by 2 m from frame 11 to frame 31, with easing.
    tracks = tmp_path / "plain" / "truth" / "tracks"
    content = json.loads((tracks / "tracks.json").read_text())
    assert {"Cube", "Plane"} <= set(content["objects"])
    world = np.load(tracks / "only.world.npy")
    of_cube = np.array(content["object"]) == content["objects"].index("Cube")
    steps_m = np.diff(world[:, of_cube, 0], axis=0)
    assert (steps_m > 0).all() and np.ptp(steps_m, axis=1) == pytest.approx(0, abs=1e-5)
    shown = cv2.imread(str(tmp_path / "plain" / "only" / "0000.png"))
    assert shown.shape == (48, 64, 3) and shown.std() > 5


def missing_picture(bpy: Any, _scene: Any, _folder: Path) -> None:
    image = bpy.data.images.new("wood", 4, 4)
    image.source, image.filepath = "FILE", "//wood.png"
    material = bpy.data.materials.new("wooden")
    material.node_tree.nodes.new("ShaderNodeTexImage").image = image
    bpy.data.objects["Cube"].data.materials.append(material)


def python_driver(bpy: Any, _scene: Any, _folder: Path) -> None:
    driver = bpy.data.objects["Cube"].driver_add("location", 1).driver
    driver.expression = "bpy.context.scene.frame_current * 0.01"


def missing_library(bpy: Any, scene: Any, folder: Path) -> None:
    block = bpy.data.objects.new("linked", bpy.data.meshes.new("linked"))
    library = folder / "library.blend"
    bpy.data.libraries.write(str(library), {block})
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = ["linked"]
    scene.collection.objects.link(wanted.objects[0])
    library.unlink()


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (missing_picture, "its image wood isn't at //wood.png"),
        (python_driver, "it runs Python"),
        (missing_library, "library.blend, isn't there"),
    ],
)
def test_what_a_blend_lacks_is_one_sentence(
    rig_file: Path, tmp_path: Path, spoil: Any, complaint: str
) -> None:
    bpy = pytest.importorskip("bpy")
    spoil(bpy, own_scene(), tmp_path)
    file = saved(tmp_path / "own.blend")
    result = by_script(rig_file, "--blend", file, "-o", tmp_path / "film", "--no-truth")
    assert result.returncode == 2
    assert complaint in result.stderr and result.stderr.count("\n") == 1
    assert not (tmp_path / "film" / "capture.json").exists()


def wallpaper(bpy: Any, name: str, seed: int) -> Any:
    """A material with a texture of random blots, an image that is packed into the file."""
    generator = np.random.default_rng(seed)
    y, x = np.mgrid[:256, :256]
    pixels = np.ones((256, 256, 4), dtype=np.float32)
    for _ in range(300):
        at_x, at_y, radius = generator.uniform((0, 0, 3), (256, 256, 14))
        blot = (x - at_x) ** 2 + (y - at_y) ** 2 < radius**2
        pixels[blot, :3] = generator.uniform(0.05, 0.95, 3)
    image = bpy.data.images.new(name, 256, 256)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    material = bpy.data.materials.new(name)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture = nodes.new("ShaderNodeTexImage")
    texture.image, nodes.active = image, texture  # Workbench shows the active one
    links.new(texture.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    return material


def test_by_readmes_commands_alone(program: Path, tmp_path: Path) -> None:
    """A user's .blend file is filmed, checked and rendered; a small size and Workbench make it fast."""
    bpy = pytest.importorskip("bpy")
    cv2 = pytest.importorskip("cv2")
    own_scene()
    bpy.data.objects["camera"].location.z = 3.0
    for name, seed in (("Plane", 1), ("Cube", 2)):
        bpy.data.objects[name].data.materials.append(wallpaper(bpy, name, seed))
    cube = bpy.data.objects["Cube"]  # slides along the rig; it must also move up
    for frame, y in ((11, -0.5), (21, 0.4), (31, -0.5)):  # and down, to find offsets
        cube.location.y = y
        cube.keyframe_insert("location", index=1, frame=frame)
    saved(tmp_path / "my.blend")
    shutil.copytree(ROOT / "rigs", tmp_path / "rigs")
    section = (ROOT / "README.md").read_text().split("A scene of your own")[1]
    commands = [line.split() for line in section.split("```")[1].strip().splitlines()]
    assert [command[1] for command in commands] == [
        *("capture", "check", "offsets", "render", "compare")
    ]
    for name, first, *rest in commands:
        assert name == "stlfr"
        arguments = ["240x180" if word == "320x240" else word for word in rest]
        if first == "capture":
            arguments += ["--engine", "workbench", "--samples", "8", "--instants", "1"]
        ended = subprocess.run(
            [program, "-q", first, *arguments],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ended.returncode == 0, (first, ended.stdout, ended.stderr)
    truth = json.loads((tmp_path / ".captures/mine/truth/truth.json").read_text())
    found = json.loads((tmp_path / ".captures/mine/offsets.json").read_text())
    true_s = {o["id"]: o["offset_s"] for o in truth["offsets"]}
    assert len(found["cameras"]) == 8
    for camera in found["cameras"]:
        assert camera["offset_s"] == pytest.approx(true_s[camera["id"]], abs=0.03 / 30)
    shown = cv2.imread(str(tmp_path / "between.png"))
    assert shown.shape == (180, 240, 3) and shown.std() > 20
    assert (tmp_path / ".captures/mine/review/report.html").is_file()


def test_what_is_no_blend_is_refused(rig_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "own.blend"
    file.write_bytes(b"BLENDER of something else")
    result = by_script(rig_file, "--blend", file, "-o", tmp_path / "film", "--no-truth")
    assert result.returncode == 2
    assert f"{file}: Blender can't open it" in result.stderr
    assert result.stderr.count("\n") == 1
