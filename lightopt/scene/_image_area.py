"""Where lights are: how much of the image they cover in front of the camera, and whether they touch each other."""

from collections.abc import Iterable

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, SurfaceLight, outlines, rectangles_meet, surface_mesh
from lightopt.scene._camera import PinholeCamera, pixel_directions, project

_NEAR_MM = 1e-3

_CHORDS = 32  # of an edge that a lens bends, each drawn as a straight line
_LEAST_AREA = 1e-6  # bent outlines that run along the image's border leave less than this by rounding [px²]


def image_area(camera: PinholeCamera, polygon: Float64) -> float:
    """How much of the image a flat convex polygon covers [px²].

    polygon: Corners in order [mm], shape (k, 3), frame of the camera's vectors
    """
    offset = polygon - camera.position
    # right, down, forward; the viewing pyramid then is left·z ≤ x ≤ right·z, top·z ≤ y ≤ bottom·z
    local = np.stack([offset @ camera.right, -(offset @ camera.up), offset @ camera.forward], axis=1)
    scale = camera.image_distance / camera.pixel_size
    local = _in_view(_clip(local, np.array([0.0, 0.0, 1.0]), _NEAR_MM), _view_at_depth_1(camera))
    if len(local) and not camera.distortion.is_zero:
        return _bent_area(camera, local)
    return camera.aspect * _area(local[:, :2] / local[:, 2:] * scale)


def area_in_view(camera: PinholeCamera, light: PanelLight) -> float:
    """How much of the image a light covers, wherever the part is [px²]; what is behind another piece counts twice.

    light: In the frame of the camera's vectors; a coaxial light covers nothing, as the camera looks past its mirror
    """
    if isinstance(light, SurfaceLight) and light.kind == "coaxial":
        return 0.0
    area = sum(image_area(camera, piece) for piece in outlines(light))
    return min(area, float(camera.width * camera.height))


def obstructions(
    camera: PinholeCamera, lights: Iterable[PanelLight], housings: Iterable[Float64] = ()
) -> Float64 | None:
    """Corners of the triangles of the lights in the camera's view [mm], shape (t, 3, 3); None where there are none.

    housings: Corners of each in order around it [mm], shape (4, 3)
    """
    meshes = [surface_mesh(light) for light in lights if area_in_view(camera, light) > 0.0]
    triangles = [vertices[faces] for vertices, faces in meshes]
    triangles += [corners[[[0, 1, 2], [0, 2, 3]]] for corners in housings if image_area(camera, corners) > 0.0]
    return np.concatenate(triangles) if triangles else None


def _view_at_depth_1(camera: PinholeCamera) -> tuple[float, float, float, float]:
    # left, top, right, bottom of the least rectangle at depth 1 that has all that the lens shows
    scale = camera.image_distance / camera.pixel_size
    column, row = camera.axis_px
    if camera.distortion.is_zero:
        down = scale * camera.aspect
        return -column / scale, -row / down, (camera.width - column) / scale, (camera.height - row) / down
    across, down = np.linspace(0.0, camera.width, 65), np.linspace(0.0, camera.height, 65)
    columns = np.concatenate([across, across, np.zeros(65), np.full(65, float(camera.width))])
    rows = np.concatenate([np.zeros(65), np.full(65, float(camera.height)), down, down])
    rays = pixel_directions(camera, columns, rows)
    depth = rays @ camera.forward
    margin = 1.01  # between the samples
    w = margin * float(np.abs(rays @ camera.right / depth).max())
    h = margin * float(np.abs(rays @ camera.up / depth).max())
    return -w, -h, w, h


def _bent_area(camera: PinholeCamera, local: Float64) -> float:
    # the outline in short chords through the lens, cut by the image's border
    steps = np.arange(_CHORDS)[:, None] / _CHORDS
    outline = np.concatenate([a + steps * (b - a) for a, b in zip(local, np.roll(local, -1, axis=0), strict=True)])
    world = camera.position + outline @ np.array([camera.right, -camera.up, camera.forward])
    columns, rows, _ = project(camera, world)
    flat = np.stack([columns, rows, np.ones(len(columns))], axis=1)
    area = _area(_in_view(flat, (0.0, 0.0, float(camera.width), float(camera.height)))[:, :2])
    return area if area > _LEAST_AREA else 0.0


def _in_view(polygon: Float64, view: tuple[float, float, float, float]) -> Float64:
    # the part of a polygon in a pyramid, as `_view_at_depth_1`; none of it where less than a triangle is left
    left, top, right, bottom = view
    for plane in ((1.0, 0.0, -left), (-1.0, 0.0, right), (0.0, 1.0, -top), (0.0, -1.0, bottom)):
        if len(polygon) < 3:
            return np.zeros((0, 3))
        polygon = _clip(polygon, np.array(plane), 0.0)
    return polygon if len(polygon) >= 3 else np.zeros((0, 3))


def _area(polygon: Float64) -> float:
    # shoelace formula
    x, y = polygon.T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def _clip(polygon: Float64, plane: Float64, least: float) -> Float64:
    # the part of a polygon where plane·x ≥ least (Sutherland and Hodgman 1974, doi:10.1145/360767.360802); parts of one
    # that is not convex stay joined along the plane, which does not change the area
    height = polygon @ plane - least
    clipped: list[Float64] = []
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        if height[i] >= 0.0:
            clipped.append(polygon[i])
        if (height[i] >= 0.0) != (height[j] >= 0.0):
            clipped.append(polygon[i] + height[i] / (height[i] - height[j]) * (polygon[j] - polygon[i]))
    return np.array(clipped).reshape(-1, 3)


def lights_meet(a: PanelLight, b: PanelLight) -> bool:
    """Whether the surfaces of two lights touch or cross; one that surrounds the other does not."""
    if all(not isinstance(light, SurfaceLight) or light.is_flat for light in (a, b)):
        return rectangles_meet(a, b)
    (points, faces), (others, other_faces) = surface_mesh(a), surface_mesh(b)
    return _edges_cross(points, faces, others, other_faces) or _edges_cross(others, other_faces, points, faces)


def _edges_cross(points: Float64, faces: Int32, others: Float64, other_faces: Int32) -> bool:
    # whether edges of some triangles go through others
    ends = [np.ascontiguousarray(faces[:, [k, (k + 1) % 3]].ravel().reshape(-1, 2)) for k in range(3)]
    start, end = np.concatenate(ends).T.astype(np.int32)
    caster = RayCaster(others, other_faces, rays=len(start))
    return bool(caster.occluded(points, np.zeros_like(points), points, point_index=start, target_index=end).any())
