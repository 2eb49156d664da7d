"""Finds the procedural textures of a scene, which Workbench doesn't show."""

from __future__ import annotations

from typing import Any

import bpy


def lost_textures(scene: Any) -> list[str]:
    """A list with one sentence that names the materials with procedural textures; empty if there are none."""
    materials = {
        slot.material
        for obj in scene.objects
        if not obj.hide_render
        for slot in obj.material_slots
        if slot.material is not None
    }
    lost = sorted(
        str(material.name) for material in materials if _is_procedural(material)
    )
    if not lost:
        return []
    noun = "material" if len(lost) == 1 else "materials"
    return [
        f"Workbench films the {noun} {', '.join(lost)} in a plain colour: procedural textures need "
        "--engine cycles. Clocks stay unknown where too little is textured."
    ]


def _is_procedural(material: bpy.types.Material) -> bool:
    """Whether a material has textures, but no image texture."""
    if material.node_tree is None:
        return False
    kinds = {
        node.type
        for node in material.node_tree.nodes
        if node.type.startswith("TEX_") and node.type != "TEX_COORD"
    }
    return bool(kinds) and "TEX_IMAGE" not in kinds
