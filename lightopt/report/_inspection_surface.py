"""The part with a ball at each of its defects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.inspection import KIND_COLOURS, FoundDefect, InspectionResult, Kind
from lightopt.report._page import SurfaceView
from lightopt.report._surface import ColouredSurface, SurfaceClass, SurfaceLayer, first_view

PART_COLOUR = "#c9ced6"
WORDS: Final[Mapping[Kind, str]] = {
    "shape": "shape",
    "stain": "stain",
    "unknown": "shape or stain: could not be told",
}

LEAST_SHARE = 0.015
"""A ball's radius is at least this share of the part's size, so that the smallest defect is seen from afar."""

RINGS, SECTORS = 8, 12


def marked_part(result: InspectionResult, name: str) -> SurfaceView:
    """The part as its file has it on the stage, to turn."""
    mesh, place = result.nominal.mesh, result.nominal.placement
    size = float(np.linalg.norm(mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)))
    vertices: list[Float64] = [np.asarray(mesh.vertices, np.float64)]
    triangles: list[Int32] = [np.asarray(mesh.faces, np.int32)]
    classes = [np.zeros(len(mesh.faces), np.uint8)]
    ball, faces = _ball()
    count = len(mesh.vertices)
    for defect in result.defects:
        middle = place.rotation @ np.array(defect.best.position) + place.translation
        radius = max(0.5 * defect.size[0], LEAST_SHARE * size)
        vertices.append(middle + radius * ball)
        triangles.append(faces + np.int32(count))
        classes.append(np.full(len(faces), 1 + list(WORDS).index(defect.best.kind), np.uint8))
        count += len(ball)
    layer = SurfaceLayer(name="defects", classes=_legend(result.defects), of_face=np.concatenate(classes))
    return SurfaceView(
        surface=ColouredSurface(
            vertices=np.concatenate(vertices),
            triangles=np.concatenate(triangles),
            layers=(layer,),
            up=np.array([0.0, 0.0, 1.0]),
            toward=first_view(result.nominal.camera),
        ),
        alt=f"{name} with a ball at each of its defects",
        caption=f"{name} as it stands at posture (0°, 0°), Z up. A ball has the length of its defect as diameter, but "
        f"at least {2.0 * LEAST_SHARE * size:.2g} mm.",
    )


def _legend(defects: Sequence[FoundDefect]) -> tuple[SurfaceClass, ...]:
    kinds = (
        SurfaceClass(
            label=WORDS[kind],
            colour="#{:02x}{:02x}{:02x}".format(*KIND_COLOURS[kind]),
            amount=str(sum(defect.best.kind == kind for defect in defects)),
        )
        for kind in WORDS
    )
    return (SurfaceClass(label="the part", colour=PART_COLOUR), *kinds)


def _ball() -> tuple[Float64, Int32]:
    # unit sphere of rings from pole to pole
    down = np.linspace(0.0, math.pi, RINGS + 1)[:, None]
    around = np.linspace(0.0, 2.0 * math.pi, SECTORS, endpoint=False)[None, :]
    points = np.stack(
        np.broadcast_arrays(np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)),
        axis=-1,
    ).reshape(-1, 3)
    ring, sector = (a.ravel() for a in np.meshgrid(np.arange(RINGS), np.arange(SECTORS), indexing="ij"))
    after = (sector + 1) % SECTORS
    a, b = ring * SECTORS + sector, ring * SECTORS + after
    c, d = a + SECTORS, b + SECTORS
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return points, faces.astype(np.int32)
