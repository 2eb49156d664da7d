"""The note about textures that Workbench doesn't show: one sentence with all affected materials."""

from __future__ import annotations

import importlib
from typing import Any

import filming
import pytest


@pytest.fixture
def scene() -> Any:
    """A scene with cubes: two with procedural textures, one with an image, one plain, and a hidden one with bricks."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    kinds = ("TexNoise", "TexWave", "TexImage", None, "TexBrick")
    for kind in kinds:
        bpy.ops.mesh.primitive_cube_add()
        cube = bpy.context.object
        material = bpy.data.materials.new(kind or "Plain")
        if kind is not None:
            material.node_tree.nodes.new(f"ShaderNode{kind}")
        cube.data.materials.append(material)
        cube.hide_render = kind == "TexBrick"
    return bpy.context.scene


def test_lost_textures_are_one_sentence(scene: Any) -> None:
    """Materials are listed in the order of their names; without procedural textures, there is no note."""
    workbench = importlib.import_module(f"{filming.rig.__package__}.workbench")
    [sentence] = workbench.lost_textures(scene)
    assert sentence.startswith(
        "Workbench films the materials TexNoise, TexWave in a plain colour: "
    )
    for obj in list(scene.objects):
        obj.hide_render = obj.hide_render or "Image" not in obj.data.materials[0].name
    assert workbench.lost_textures(scene) == []
