"""Ground truth point tracks, computed in Blender: positions and visibility of surface points at every frame.

A point has fixed barycentric weights on a triangle of an evaluated mesh, and follows this triangle as the mesh moves
and deforms. Points are sampled through random pixels of the cameras, so that they lie on visible surfaces. Half of them
are on moving surfaces, if there are enough.

Limits: there are no points on instances, or on meshes whose number of vertices or faces changes. Mirrors and glass
count as opaque surfaces. Objects that are visible only to some kinds of rays count as visible.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt
from mathutils import Vector
from mathutils.geometry import intersect_point_tri

from . import film, rolling, scenes, truth
from . import rig as rigs
from .camera import Array
from .described import Camera, centre_of, direction_of, project
from .folder import write_json

CANDIDATES = 4
"""Number of sampled points per written point, so that enough of them move. If larger, sampling takes longer; if
smaller, a scene with little motion may get only static points."""

MOVING_M = 0.002
"""Minimum extent of a moving point's trajectory: the diagonal of its bounding box. If larger, slow points count as
static; if smaller, rounding errors of single precision count as motion."""

SAME_DEPTH = 5e-5
"""Tolerance of the visibility test: a ray to a visible point may hit a surface that is nearer by this fraction of the
point's distance. If larger than 0.4 mm at 2 m, the distance between layers of a printed sheet, points under a layer
count as visible; if smaller than single precision, points are occluded by their own surface."""


@dataclass(frozen=True)
class Exposure:
    """The exposure of one frame of one camera. Its time is given as world time, and on the reference camera's clock."""

    camera_id: str
    frame: int
    world_time_s: float
    clock_time_s: float
    readout_s: float = 0.0
    """The readout time of a rolling shutter, otherwise 0. The frame's time is then that of its middle row."""


@dataclass(frozen=True)
class SurfacePoint:
    """A point on a triangle of an object's evaluated mesh: three vertex indices with barycentric weights.

    `vertex_count` is the number of vertices of this mesh; if it changes, the point can't be followed.
    """

    object_name: str
    vertices: tuple[int, int, int]
    weights: tuple[float, float, float]
    vertex_count: int


@dataclass(frozen=True)
class CameraTracks:
    """The tracks of all points at the frames of one camera."""

    camera_id: str
    times_s: list[float]
    """Times of the frames, on the reference camera's clock. With a rolling shutter, the positions of a point are those
    when its row is exposed."""
    arrays: dict[str, npt.NDArray[Any]]
    """Arrays by name, over frames and points: `world` positions in metres, image `pixels`, and `visible` (0 or 1)."""


@dataclass(frozen=True)
class Tracks:
    """The tracks of points: the points themselves, and their tracks for each camera, in the rig's order."""

    points: list[SurfacePoint]
    cameras: list[CameraTracks]


def follow(
    studio: film.Studio, exposures: list[Exposure], count: int, seed: int
) -> Tracks:
    """Track up to `count` points of the scene's surfaces at all exposures."""
    evaluate_as_rendered(studio.scene)
    described = {e.camera_id: studio.describe(e.camera_id) for e in exposures}
    exposures = sorted(exposures, key=lambda e: (e.world_time_s, e.camera_id))
    candidates = draw(studio, exposures, CANDIDATES * count, seed)
    trajectories_m = np.empty((len(exposures), len(candidates), 3))
    for k, exposure in enumerate(exposures):
        camera = described[exposure.camera_id]
        trajectories_m[k] = exposed_positions(
            studio.scene, exposure, camera, candidates
        )
    chosen = choose(trajectories_m, count)
    trajectories_m = trajectories_m[:, chosen]
    points = [candidates[i] for i in chosen]
    pixels, visible = images_of(
        studio.scene, exposures, described, points, trajectories_m
    )
    cameras = []
    for view_id in studio.views:
        if view_id not in described:
            continue
        rows = sorted(
            (k for k, e in enumerate(exposures) if e.camera_id == view_id),
            key=lambda k: exposures[k].frame,
        )
        arrays = {
            "world": trajectories_m[rows],
            "pixels": np.array([pixels[k] for k in rows]),
            "visible": np.array([visible[k] for k in rows], dtype=np.uint8),
        }
        times_s = [exposures[k].clock_time_s for k in rows]
        cameras.append(CameraTracks(view_id, times_s, arrays))
    return Tracks(points, cameras)


def write(tracks: Tracks, folder: Path, scratch: Path) -> None:
    """Write tracks.json and its arrays into `folder`; src/capture/tracks.rs describes the format."""
    entries: list[dict[str, Any]] = []
    for camera in tracks.cameras:
        files = {name: f"{camera.camera_id}.{name}.npy" for name in camera.arrays}
        for name, array in camera.arrays.items():
            film.save_whole(array, folder / files[name], scratch)
        entries.append({"id": camera.camera_id, "times_s": camera.times_s, **files})
    names = sorted({point.object_name for point in tracks.points})
    content = {
        "format": "stlfr-tracks",
        "version": 1,
        "objects": names,
        "object": [names.index(point.object_name) for point in tracks.points],
        "cameras": entries,
    }
    write_json(folder / "tracks.json", content)


def images_of(
    scene: Any,
    exposures: list[Exposure],
    described: dict[str, Camera],
    points: list[SurfacePoint],
    trajectories_m: Array,
) -> tuple[list[Array], list[npt.NDArray[np.bool_]]]:
    """The points' image positions (N, 2) and visibility (N) at each exposure.

    `described` has the camera objects by id. `trajectories_m` (exposures, points, 3) are the points' world positions.
    """
    pixels: list[Array] = []
    visible: list[npt.NDArray[np.bool_]] = []
    for k, exposure in enumerate(exposures):
        camera = described[exposure.camera_id]
        seen_px = project(camera, trajectories_m[k])
        inside = (
            (seen_px >= 0).all(axis=1)
            & (seen_px[:, 0] <= camera["width"])
            & (seen_px[:, 1] <= camera["height"])
        )
        pixels.append(seen_px)
        visible.append(
            inside
            & exposed_unoccluded(scene, exposure, camera, points, trajectories_m[k])
        )
    return pixels, visible


def exposed_positions(
    scene: Any, exposure: Exposure, camera: Camera, points: list[SurfacePoint]
) -> Array:
    """The points' world positions (N, 3), metres, each when the image row that shows the point is exposed."""
    places_m, when = _during(scene, exposure, camera, points)
    return when.between(places_m)


def exposed_unoccluded(
    scene: Any,
    exposure: Exposure,
    camera: Camera,
    points: list[SurfacePoint],
    places_m: Array,
) -> npt.NDArray[np.bool_]:
    """Whether each point is unoccluded when the image row that shows it is exposed.

    The time of this test is rounded to the nearest node of the readout, at most half of `rolling.NODE_S` away.
    """
    centre = centre_of(camera)
    offsets_s = rolling.nodes_s(exposure.readout_s)
    if len(offsets_s) == 1:
        graph = evaluated_at(scene, exposure)
        return unoccluded(scene, graph, centre, places_m)
    nodes_m, when = _during(scene, exposure, camera, points)
    result = np.zeros(len(points), dtype=bool)
    for node, offset_s in enumerate(offsets_s):
        of_node = when.nearest == node
        graph = evaluated_at(scene, exposure, float(offset_s))
        result[of_node] = unoccluded(scene, graph, centre, nodes_m[node, of_node])
    return result


def _during(
    scene: Any, exposure: Exposure, camera: Camera, points: list[SurfacePoint]
) -> tuple[Array, rolling.Exposed]:
    """The points' world positions at the nodes of a readout (nodes, points, 3), and when each point is exposed."""
    places_m = np.array(
        [
            positions(evaluated_at(scene, exposure, float(offset_s)), points)
            for offset_s in rolling.nodes_s(exposure.readout_s)
        ]
    )
    y_px = np.array([project(camera, at_m)[:, 1] for at_m in places_m])
    return places_m, rolling.exposed(y_px, camera["height"], exposure.readout_s)


def exposures(rig: rigs.Rig, frame_count: int) -> list[Exposure]:
    """The exposures of all frames of all cameras. The reference camera takes `frame_count` frames."""
    shutters = rigs.shutters(rig, frame_count)
    zero_s = truth.reference_zero_s(rig, shutters)
    return [
        Exposure(shutter.id, k, time_s, time_s - zero_s, camera.readout_s)
        for camera, shutter in zip(rig.cameras, shutters, strict=True)
        for k, time_s in enumerate(shutter.world_times_s)
    ]


def evaluate_as_rendered(scene: Any) -> None:
    """Make the viewport show what a render shows, because ray casts use the geometry of the viewport."""
    for scene_object in scene.objects:
        scene_object.hide_viewport = scene_object.hide_render
        for modifier in scene_object.modifiers:
            modifier.show_viewport = modifier.show_render
            if hasattr(modifier, "render_levels"):
                modifier.levels = modifier.render_levels
    scene.render.use_simplify = False


def evaluated_at(scene: Any, exposure: Exposure, offset_s: float = 0.0) -> Any:
    """Set the scene to the exposure's time plus `offset_s`. Returns its evaluated dependency graph."""
    frame, subframe = scenes.frame_at(scene, exposure.world_time_s + offset_s)
    scene.frame_set(frame, subframe=subframe)
    return bpy.context.evaluated_depsgraph_get()


def draw(
    studio: film.Studio, exposures: list[Exposure], count: int, seed: int
) -> list[SurfacePoint]:
    """Sample up to `count` surface points, each behind a random pixel, at up to 16 exposures spread over time."""
    generator = random.Random(f"{seed}/tracks")
    groups = min(16, len(exposures))
    points: list[SurfacePoint] = []
    for group in range(groups):
        exposure = exposures[(2 * group + 1) * len(exposures) // (2 * groups)]
        camera = studio.describe(exposure.camera_id)
        graph = evaluated_at(studio.scene, exposure)
        wanted = (group + 1) * count // groups
        for _ in range(2 * (wanted - len(points))):
            x_px = generator.uniform(0, camera["width"])
            y_px = generator.uniform(0, camera["height"])
            point = _behind(studio.scene, graph, camera, x_px, y_px)
            if point is not None and len(points) < wanted:
                points.append(point)
    return points


def _behind(
    scene: Any, graph: Any, camera: Camera, x_px: float, y_px: float
) -> SurfacePoint | None:
    direction = direction_of(camera, (x_px, y_px))
    hit, place, _normal, face, hit_object, matrix = scene.ray_cast(
        graph, Vector(centre_of(camera)), Vector(direction)
    )
    if not hit or hit_object.type != "MESH":
        return None
    evaluated = hit_object.evaluated_get(graph)
    if matrix != evaluated.matrix_world:
        return None  # an instance
    mesh = evaluated.data
    local = matrix.inverted() @ place
    for triangle in _triangles(mesh, face):
        corners = [mesh.vertices[v].co for v in triangle]
        if intersect_point_tri(local, *corners):
            weights = barycentric(np.array(local), np.array(corners))
            if weights is not None:
                return SurfacePoint(
                    hit_object.name, triangle, weights, len(mesh.vertices)
                )
    return None


def _triangles(mesh: Any, face: int) -> list[tuple[int, int, int]]:
    """The vertex indices of a face's triangles, in the triangulation that is rendered."""
    polygon = mesh.polygons[face]
    if len(polygon.vertices) == 3:
        return [tuple(polygon.vertices)]
    # Blender stores the triangles in the polygons' order; a polygon has two triangles fewer than corners.
    first = polygon.loop_start - 2 * face
    return [
        tuple(mesh.loop_triangles[i].vertices)
        for i in range(first, first + len(polygon.vertices) - 2)
    ]


def barycentric(place: Array, corners: Array) -> tuple[float, float, float] | None:
    """The barycentric weights of a point on a triangle with these corners (3, 3); None for a triangle without area."""
    edges = (corners[1:] - corners[0]).T
    gram = edges.T @ edges
    determinant = gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2
    if not determinant > 1e-14 * gram[0, 0] * gram[1, 1]:
        return None
    u, v = np.linalg.solve(gram, edges.T @ (place - corners[0]))
    return (float(1 - u - v), float(u), float(v))


def positions(graph: Any, points: list[SurfacePoint]) -> Array:
    """The points' world positions (N, 3) in an evaluated scene, metres.

    NaN for points on a mesh whose number of vertices has changed.
    """
    result = np.full((len(points), 3), np.nan)
    by_object: dict[str, list[int]] = {}
    for i, point in enumerate(points):
        by_object.setdefault(point.object_name, []).append(i)
    for name, indices in by_object.items():
        evaluated = bpy.data.objects[name].evaluated_get(graph)
        mesh = evaluated.data
        if any(points[i].vertex_count != len(mesh.vertices) for i in indices):
            continue
        coordinates = np.empty(3 * len(mesh.vertices), dtype=np.float32)
        mesh.vertices.foreach_get("co", coordinates)
        corners = coordinates.reshape(-1, 3)[[points[i].vertices for i in indices]]
        weights = np.array([points[i].weights for i in indices])
        local = np.einsum("nc,nci->ni", weights, corners.astype(np.float64))
        matrix = np.array(evaluated.matrix_world, dtype=np.float64)
        result[indices] = local @ matrix[:3, :3].T + matrix[:3, 3]
    return result


def choose(trajectories_m: Array, count: int) -> list[int]:
    """Choose up to `count` points with complete trajectories, half of them moving if there are enough.

    Returns their indices in increasing order. `trajectories_m` is (exposures, points, 3).
    """
    whole = np.isfinite(trajectories_m).all(axis=(0, 2))
    reach_m = np.zeros(trajectories_m.shape[1])
    reach_m[whole] = np.linalg.norm(np.ptp(trajectories_m[:, whole], axis=0), axis=1)
    moving = [i for i in np.flatnonzero(whole) if reach_m[i] >= MOVING_M]
    still = [i for i in np.flatnonzero(whole) if reach_m[i] < MOVING_M]
    max_moving = max(count - count // 2, count - len(still))
    chosen = moving[:max_moving]
    return sorted(int(i) for i in chosen + still[: count - len(chosen)])


def unoccluded(
    scene: Any, graph: Any, centre: Array, points_m: Array
) -> npt.NDArray[np.bool_]:
    """Whether each point (N, 3) is unoccluded as seen from a camera's centre."""
    origin = Vector(centre)
    result = np.zeros(len(points_m), dtype=bool)
    for i, point in enumerate(points_m):
        way = Vector(point) - origin
        hit, place, *_ = scene.ray_cast(graph, origin, way, distance=2 * way.length)
        result[i] = not hit or (place - origin).length > way.length * (1 - SAME_DEPTH)
    return result
