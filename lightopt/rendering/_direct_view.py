"""What a camera sees of a light itself, such as a backlight behind the part: levels of the pixels that look at it."""

from collections.abc import Iterator

import numpy as np

from lightopt.core.arrays import Float64, Int64
from lightopt.core.threads import in_threads
from lightopt.geometry import RayCaster, TriangleMesh
from lightopt.lights import SurfaceLight, pattern_at, plane_places
from lightopt.rendering._surface import hidden_by, trace_hits
from lightopt.scene import PartView, area_in_view, pixel_directions

RAYS = 4  # along each side of a pixel, which shows their mean
_BLOCK_ROWS = 16
_NEARER = 1.0 - 1e-6  # so that a light does not hide itself


def direct_levels(
    view: PartView, mesh: TriangleMesh, caster: RayCaster, *, threads: int | None = None
) -> Iterator[tuple[int, Float64]]:
    """Number of each light that the camera sees directly, and what it adds to the pixels [grey level], shape (H, W)."""
    sights: dict[int, _Sight] = {}
    for number, light in enumerate(view.lights):
        if not isinstance(light, SurfaceLight) or not light.direct_level or not area_in_view(view.camera, light):
            continue
        if light.entry not in sights:
            sights[light.entry] = _look(view, light, mesh, caster, threads)
        pixel, u, v = sights[light.entry]
        camera = view.camera
        level = light.gain * light.direct_level * pattern_at(light.pattern, u, v) / RAYS**2
        levels = np.zeros(camera.width * camera.height)
        np.add.at(levels, pixel, level)
        yield number, levels.reshape(camera.height, camera.width)


_Sight = tuple[Int64, Float64, Float64]  # of the rays that meet a light: pixel, and place on the light [mm]


def _look(view: PartView, light: SurfaceLight, mesh: TriangleMesh, caster: RayCaster, threads: int | None) -> _Sight:
    camera = view.camera

    def block(top: int) -> _Sight:
        rows = np.arange(top * RAYS, min(top + _BLOCK_ROWS, camera.height) * RAYS, dtype=np.int64)
        column, row = (a.ravel() for a in np.meshgrid(np.arange(camera.width * RAYS, dtype=np.int64), rows))
        x, y = (column + 0.5) / RAYS, (row + 0.5) / RAYS
        directions = pixel_directions(camera, x, y)
        u, v, distance = plane_places(light, camera.position, directions)
        shines = directions @ light.outward > 0.0  # against `outward`
        met = np.flatnonzero(shines & (np.abs(u) <= 0.5 * light.size[0]) & (np.abs(v) <= 0.5 * light.size[1]))
        towards = distance[met, None] * directions[met]
        # the part, or another light, may be before it
        hits = trace_hits(caster, mesh, camera, x[met], y[met])
        hidden = np.zeros(len(met), np.bool_)
        hidden[hits.ray] = hits.distance < np.linalg.norm(towards[hits.ray], axis=1)
        if camera.obstructions is not None and len(met):
            hidden |= hidden_by(camera.obstructions, camera.position, camera.position + _NEARER * towards)
        met = met[~hidden]
        return (row // RAYS * camera.width + column // RAYS)[met], u[met], v[met]

    blocks = in_threads(block, range(0, camera.height, _BLOCK_ROWS), threads)
    pixel, u, v = zip(*blocks, strict=True)
    return np.concatenate(pixel), np.concatenate(u), np.concatenate(v)
