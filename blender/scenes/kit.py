"""Building blocks of scenes: matt materials, printed sheets, simple bodies, animation, light.

All surfaces but those of `polished` are diffuse, so that a point has the same colour in all cameras. Textures are
images painted by `paint` and stored in the file, which render many times faster than procedural shader noise. Motion is
animated by drivers with expressions of the frame number. Blender evaluates these expressions without Python (so they
need no permission to run scripts), and exactly at sub-frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import bpy
import mathutils
import numpy as np
import numpy.typing as npt

from . import paint

Points = npt.NDArray[np.float64]

FPS = 30
SECONDS = f"((frame - 1) / {FPS})"
"""Expression for world time in seconds, for a driver."""


def ink(name: str, code: str) -> Any:
    """A matt material of one colour, given by an sRGB code such as `d0a040`."""
    material, diffuse = _matt(name)
    linear = (*_linear(paint.color(code)), 1.0)
    diffuse.inputs["Color"].default_value = linear
    material.diffuse_color = linear  # what Workbench shows
    return material


def printed(name: str, picture: paint.Image) -> Any:
    """A matt material that shows a picture over the unit square of the surface's UV coordinates."""
    height, width = picture.shape[:2]
    image = bpy.data.images.new(name, width, height)
    pixels = np.ones((height, width, 4), dtype=np.float32)
    pixels[..., :3] = picture
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    material, diffuse = _matt(name)
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image, texture.extension = image, "EXTEND"
    material.node_tree.nodes.active = texture  # what Workbench shows
    material.node_tree.links.new(texture.outputs["Color"], diffuse.inputs["Color"])
    return material


def _matt(name: str) -> tuple[Any, Any]:
    """A new material that has only a diffuse shader, and this shader's node."""
    material = bpy.data.materials.new(name)
    nodes = material.node_tree.nodes
    nodes.clear()
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    output = nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    return material, diffuse


def polished(name: str, code: str, roughness: float) -> Any:
    """A metal material of one colour, which looks different to each camera. Roughness 0 is a mirror, 0.3 is satin."""
    material = bpy.data.materials.new(name)
    nodes = material.node_tree.nodes
    nodes.clear()
    linear = (*_linear(paint.color(code)), 1.0)
    glossy = nodes.new("ShaderNodeBsdfAnisotropic")
    glossy.inputs["Color"].default_value = linear
    glossy.inputs["Roughness"].default_value = roughness
    output = nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(glossy.outputs[0], output.inputs["Surface"])
    material.diffuse_color = linear  # what Workbench shows
    return material


def _linear(srgb: paint.Image) -> list[float]:
    return [
        s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4
        for s in srgb.tolist()
    ]


class Letters(NamedTuple):
    """The flat outline of a text as polygons. Points are relative to the start or middle of its first baseline."""

    points_m: list[tuple[float, float]]
    faces: list[list[int]]


class Sheet:
    """A printed sheet: rectangles and text in page coordinates, metres.

    Seen from the front, x points right and y points up. The front faces -Y, and the page's y is the object's Z. Each
    print layer is 0.4 mm above the layer below, too little for the cameras to resolve.
    """

    LAYER_M = 0.0004

    def __init__(self) -> None:
        self.materials: list[Any] = []
        self.vertices: list[tuple[float, float, int]] = []
        self.uvs: list[tuple[float, float]] = []
        self.faces: list[tuple[list[int], int]] = []

    def _slot(self, material: Any) -> int:
        if material not in self.materials:
            self.materials.append(material)
        return self.materials.index(material)

    def rectangle(
        self,
        material: Any,
        corner_m: tuple[float, float],
        size_m: tuple[float, float],
        layer: int = 0,
    ) -> None:
        """Add a rectangle with this lower left corner and size, divided into columns so that it can be bent."""
        (x, y), (width, height) = corner_m, size_m
        columns = max(1, math.ceil(width / 0.012))
        first = len(self.vertices)
        for i in range(columns + 1):
            column_x = x + width * i / columns
            self.vertices += [(column_x, y, layer), (column_x, y + height, layer)]
            self.uvs += [(i / columns, 0.0), (i / columns, 1.0)]
        for i in range(columns):
            a = first + 2 * i
            self.faces.append(([a, a + 2, a + 3, a + 1], self._slot(material)))

    def text(
        self,
        material: Any,
        body: str,
        start_m: tuple[float, float],
        size_m: float,
        layer: int = 2,
    ) -> None:
        """Add left-aligned text in Blender's built-in font, starting at `start_m` on the first line's baseline.

        `size_m` is the font size.
        """
        self._print(material, _letters(body, size_m, "LEFT"), start_m, layer)

    def centred_text(
        self,
        material: Any,
        body: str,
        middle_m: tuple[float, float],
        size_m: float,
        layer: int = 2,
    ) -> None:
        """Add text with centred lines, in the font of `text`; `middle_m` is the middle of the first line's baseline."""
        self._print(material, _letters(body, size_m, "CENTER"), middle_m, layer)

    def _print(
        self, material: Any, letters: Letters, origin_m: tuple[float, float], layer: int
    ) -> None:
        (x, y), first = origin_m, len(self.vertices)
        self.vertices += [(x + dx, y + dy, layer) for dx, dy in letters.points_m]
        self.uvs += [(0.0, 0.0)] * len(letters.points_m)
        for face in letters.faces:
            self.faces.append(([first + v for v in face], self._slot(material)))

    def build(
        self, name: str, bend: Callable[[float, float], float] = lambda x, y: 0.0
    ) -> Any:
        """Create the sheet's object; `bend(x, y)` is the distance by which a point is moved forward, towards -Y."""
        points = [
            (x, -bend(x, y) - self.LAYER_M * layer, y) for x, y, layer in self.vertices
        ]
        faces = [indices for indices, _ in self.faces]
        mesh = _mesh(
            name, points, faces, [[self.uvs[v] for v in indices] for indices in faces]
        )
        for material in self.materials:
            mesh.materials.append(material)
        for polygon, (_, slot) in zip(mesh.polygons, self.faces, strict=True):
            polygon.material_index = slot
        mesh.shade_smooth()
        return add(bpy.data.objects.new(name, mesh))


def _letters(body: str, size_m: float, align: str) -> Letters:
    """The polygons of a text in Blender's built-in font; `align` is `LEFT` or `CENTER`."""
    curve = bpy.data.curves.new("text", "FONT")
    curve.body, curve.size, curve.align_x = body, size_m, align
    curve.resolution_u = 3
    text_object = bpy.data.objects.new("text", curve)
    mesh = text_object.to_mesh()
    letters = Letters(
        [(v.co.x, v.co.y) for v in mesh.vertices],
        [list(polygon.vertices) for polygon in mesh.polygons],
    )
    text_object.to_mesh_clear()
    bpy.data.objects.remove(text_object)
    bpy.data.curves.remove(curve)
    return letters


def _mesh(
    name: str,
    points: Sequence[Sequence[float]],
    faces: Sequence[Sequence[int]],
    face_uvs: Sequence[Sequence[tuple[float, float]]],
) -> Any:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    mesh.uv_layers.new().data.foreach_set(
        "uv", [c for uvs in face_uvs for uv in uvs for c in uv]
    )
    return mesh


def add(new_object: Any) -> Any:
    """Add an object to the scene, and return it."""
    bpy.context.scene.collection.objects.link(new_object)
    return new_object


def group(name: str) -> Any:
    """Add an invisible object, to be the parent of objects that move together."""
    return add(bpy.data.objects.new(name, None))


def print_in_front(body: Any, sheet: Sheet, name: str, depth_m: float) -> None:
    """Attach a sheet in front of a body made by `turned`, at `depth_m` along the body's Z axis.

    A picture on the body itself would be distorted, because its UV coordinates are angle and ring.
    """
    front = sheet.build(name)
    front.rotation_euler.x = -1.5707963
    front.location.z = depth_m
    front.parent = body


def box(
    name: str,
    material: Any,
    size_m: Sequence[float],
    base_m: Sequence[float],
    part: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0),
) -> Any:
    """An upright box; `base_m` is the middle of its underside.

    Each side shows the part `part` of the material's picture: left, bottom, right, top, from 0 to 1.
    """
    w, d, h = size_m[0] / 2, size_m[1] / 2, size_m[2]
    corners = [(x, y, z) for z in (0.0, h) for y in (-d, d) for x in (-w, w)]
    faces = [
        (0, 1, 5, 4),
        (1, 3, 7, 5),
        (3, 2, 6, 7),
        (2, 0, 4, 6),
        (4, 5, 7, 6),
        (0, 2, 3, 1),
    ]  # front first
    left, bottom, right, top = part
    square = [(left, bottom), (right, bottom), (right, top), (left, top)]
    mesh = _mesh(name, corners, faces, [square] * 6)
    mesh.materials.append(material)
    new_object = add(bpy.data.objects.new(name, mesh))
    new_object.location = base_m
    return new_object


def turned(
    name: str,
    material: Any,
    profile_m: Sequence[tuple[float, float]],
    segments: int = 48,
) -> Any:
    """A body of revolution about its own Z axis; the profile is pairs (radius, height) from bottom to top.

    UV coordinates are the angle and the index of the profile's point, both scaled to 0 to 1.
    """
    angles = np.arange(segments) * math.tau / segments
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(segments)], axis=1)
    rings = [r * circle + (0.0, 0.0, z) for r, z in profile_m]
    return lofted(name, material, np.array(rings))


def lofted(name: str, material: Any, rings_m: Points) -> Any:
    """A surface through closed rings of points (rings, segments, 3).

    UV coordinates are the position around the ring and the index of the ring, both scaled to 0 to 1.
    """
    return skinned(name, [(material, rings_m)])


def skinned(name: str, parts: Sequence[tuple[Any, Points]]) -> Any:
    """One object of several surfaces as in `lofted`, each given by its material and its rings."""
    points: list[list[float]] = []
    faces: list[tuple[int, ...]] = []
    face_uvs: list[list[tuple[float, float]]] = []
    slots: list[int] = []
    for slot, (_, rings_m) in enumerate(parts):
        rings, segments = rings_m.shape[:2]
        first = len(points)
        points += rings_m.reshape(-1, 3).tolist()
        for ring in range(rings - 1):
            low, high = ring / (rings - 1), (ring + 1) / (rings - 1)
            for s in range(segments):
                a = first + ring * segments + s
                b = first + ring * segments + (s + 1) % segments
                left, right = s / segments, (s + 1) / segments
                faces.append((a, b, b + segments, a + segments))
                face_uvs.append(
                    [(left, low), (right, low), (right, high), (left, high)]
                )
                slots.append(slot)
    mesh = _mesh(name, points, faces, face_uvs)
    for material, _ in parts:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", slots)
    mesh.shade_smooth()
    return add(bpy.data.objects.new(name, mesh))


def tube(
    centres_m: Sequence[Sequence[float]],
    radii_m: Sequence[Sequence[float]],
    upright: Sequence[float],
    segments: int = 16,
) -> Points:
    """The rings for `lofted` of a tube with elliptic cross sections around a path of centres.

    `radii_m` are the half-width and half-thickness at each centre; the thickness is measured along `upright`.
    """
    path = np.array(centres_m, dtype=np.float64)
    along = np.gradient(path, axis=0)
    across = np.cross(along, np.array(upright, dtype=np.float64))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    thick = np.cross(across, along)
    thick /= np.linalg.norm(thick, axis=1, keepdims=True)
    angles = np.arange(segments) * math.tau / segments
    width, thickness = np.array(radii_m, dtype=np.float64).T[:, :, None, None]
    rings: Points = (
        path[:, None]
        + width * np.cos(angles)[None, :, None] * across[:, None]
        + thickness * np.sin(angles)[None, :, None] * thick[:, None]
    )
    return rings


def bend(target: Any, name: str, points_m: Points, expression: str) -> None:
    """Add a shape key to an object's mesh, with new positions of all vertices in the mesh's order.

    `expression` is the driver expression of its weight, from 0 to 1, in which `{t}` is world time in seconds.
    """
    if target.data.shape_keys is None:
        target.shape_key_add(name="rest", from_mix=False)
    key = target.shape_key_add(name=name, from_mix=False)
    key.data.foreach_set("co", points_m.astype(np.float32).ravel())
    curve = key.driver_add("value")
    curve.driver.type = "SCRIPTED"
    curve.driver.expression = expression.replace("{t}", SECONDS)


def sphere_profile(
    radius_m: float, centre_height_m: float, rings: int = 24
) -> list[tuple[float, float]]:
    """The profile of a sphere for `turned`; `centre_height_m` is the height of its centre."""
    angles = [-math.pi / 2 + math.pi * i / rings for i in range(rings + 1)]
    return [
        (radius_m * math.cos(a) + 1e-5, centre_height_m + radius_m * math.sin(a))
        for a in angles
    ]


def drive(target: Any, path: str, axis: int, expression: str) -> None:
    """Animate one component of an object's property `path`; `{t}` in the expression is world time in seconds."""
    curve = target.driver_add(path, axis)
    curve.driver.type = "SCRIPTED"
    curve.driver.expression = expression.replace("{t}", SECONDS)


def sky(
    brightness: float,
    contrast: float,
    brightest: Sequence[float],
    seen_in_mirrors: bool = False,
) -> None:
    """Set the scene's light: a smooth sky with mean radiance `brightness`, brightest in the direction `brightest`.

    Its radiance varies from `1 - contrast` to `1 + contrast` times the mean. It gives shading and soft contact shadows
    in half the render time of a sun, with less noise. Light paths end at their second surface. So objects reflected in
    a mirror are dark, unless `seen_in_mirrors` makes Cycles sample the sky there, which takes half as long again.
    """
    world = bpy.data.worlds.new("sky")
    if not seen_in_mirrors:
        world.cycles.sampling_method = "NONE"  # diffuse rays sample it well enough
    nodes, links = world.node_tree.nodes, world.node_tree.links
    direction = nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    towards = nodes.new("ShaderNodeVectorMath")
    towards.operation = "DOT_PRODUCT"
    towards.inputs[1].default_value = mathutils.Vector(brightest).normalized()
    links.new(direction, towards.inputs[0])
    strength = nodes.new("ShaderNodeMath")
    strength.operation = "MULTIPLY_ADD"
    strength.inputs[1].default_value = brightness * contrast
    strength.inputs[2].default_value = brightness
    links.new(towards.outputs["Value"], strength.inputs[0])
    background = nodes["Background"]
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    links.new(strength.outputs["Value"], background.inputs["Strength"])
    bpy.context.scene.world = world


def sun(strength: float, direction: Sequence[float], angle_deg: float) -> None:
    """Add a distant light that shines in `direction`. A larger angular diameter `angle_deg` gives softer shadows."""
    light = bpy.data.lights.new("sun", "SUN")
    light.energy, light.angle = strength, math.radians(angle_deg)
    lamp = add(bpy.data.objects.new("sun", light))
    turn = mathutils.Vector(direction).to_track_quat("-Z", "Y")
    lamp.rotation_euler = turn.to_euler()


def place_rig(location_m: Sequence[float], target_m: Sequence[float]) -> None:
    """Add the object `rig`, whose pose is the camera rig's pose: at `location_m`, looking at `target_m`, upright."""
    rig = add(bpy.data.objects.new("rig", None))
    look = mathutils.Vector(target_m) - mathutils.Vector(location_m)
    rig.location = location_m
    rig.rotation_euler = look.to_track_quat("-Z", "Y").to_euler()
    rig.empty_display_size = 0.1


def start_scene() -> None:
    """Set the scene's frame rate (30 Hz; frame 1 is world time 0), its length (3 s), and one bounce of light."""
    scene = bpy.context.scene
    cycles = scene.cycles
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = 1
    cycles.transmission_bounces = 1
    scene.render.fps, scene.render.fps_base = FPS, 1.0
    scene.frame_start, scene.frame_end = 1, 1 + 3 * FPS
