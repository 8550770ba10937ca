"""The lights and the part in each other's way."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lightopt.mesh import face_normals
from lightopt.preflight._rectangles import segments_blocked
from lightopt.preflight._report import Finding, percent
from lightopt.preflight._subject import SceneSubject
from lightopt.scene import panel_grid

__all__ = ["check_hidden_part", "check_lights_in_part"]

GRID = 25
"""Points of a panel that are tried."""


def check_hidden_part(subject: SceneSubject) -> Iterator[Finding]:
    """How much of the part's image a panel hides, standing between camera and part."""
    for (index, look), (at, light) in itertools.product(
        enumerate(subject.looks), enumerate(subject.scene.lights)
    ):
        hidden = segments_blocked(look.view.lights[at], look.view.camera.position, look.hits.points)
        count = int(np.count_nonzero(hidden))
        if not count:
            continue
        pixels, share = count * look.step**2, count / len(hidden)
        yield Finding(
            "warning",
            "light in view",
            f"posture {look.posture}: {light.name} stands between camera and part and hides about {pixels:,} px "
            f"({percent(share)}) of it. Renderings leave it out, a camera cannot",
            subject.rig.source.at("lights", at),
            {
                "light": light.name,
                "posture": subject.scene.postures[index].as_dict(),
                "pixels": pixels,
                "share": share,
            },
        )


def check_lights_in_part(subject: SceneSubject) -> Iterator[Finding]:
    """Panels that are inside the part, wholly or in places."""
    normals: NDArray[np.float64] | None = None
    low, high = subject.scene.mesh.bounds
    for look, (at, light) in itertools.product(subject.looks, enumerate(subject.scene.lights)):
        points = panel_grid(look.view.lights[at], GRID)
        points = points[np.all((points >= low) & (points <= high), axis=1)]
        if not len(points):
            continue
        normals = face_normals(subject.scene.mesh) if normals is None else normals
        inside = sum(_enclosed(subject, point, normals) for point in points)
        if inside:
            yield Finding(
                "error",
                "light in part",
                f"posture {look.posture}: {inside} of {GRID} points all over {light.name}'s panel are inside the part; "
                f"check the mesh's units, its placement, and the light's distance of {light.distance:g} mm",
                subject.rig.source.at("lights", at),
                {"light": light.name, "posture": look.posture.as_dict(), "share": inside / GRID},
            )


def _enclosed(subject: SceneSubject, point: NDArray[np.float64], normals: NDArray[np.float64]) -> bool:
    # inside a surface that faces outwards, every way out meets a back; directions that are not along the axes pass
    # less often exactly through edges
    directions = np.array([[x, y, z] for x in (-1.0, 1.1) for y in (-1.2, 1.3) for z in (-1.4, 1.5)])
    face = subject.caster.first_hit(point, directions)
    return bool(np.all(face >= 0) and np.all(np.einsum("ij,ij->i", normals[face], directions) > 0.0))
