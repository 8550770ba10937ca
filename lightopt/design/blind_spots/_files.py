"""Blind spots as files: a table, a coloured surface in the coordinates of the part's file, a picture per posture."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lightopt.design.blind_spots._blind_spots import Blind, BlindSpots
from lightopt.design.blind_spots._classes import (
    BLIND_CLASSES,
    Legend,
    blind_class,
    blind_classes,
    blind_legend,
)
from lightopt.design.blind_spots._summary import BLIND_LIGHTS, BlindReport, reason_names
from lightopt.geometry import Patches, RayCaster
from lightopt.images import posture_folder
from lightopt.rendering import trace_samples
from lightopt.scene import Placement, Scene, view_from_part

BLIND_CSV, BLIND_PLY, BLIND_PNG = BLIND_NAMES = "blind.csv", "blind.ply", "blind.png"

BACKGROUND = (255, 255, 255)

LEAST_SHADE = 0.8
"""Brightness of a surface that is seen edge on; one that faces the camera has its legend's colour."""

BLOCK_ROWS = 64
"""Of a picture, traced at once."""


def blind_files(report: BlindReport, patches: Patches, placement: Placement) -> Mapping[str, str | bytes]:
    """``blind.csv`` and ``blind.ply``.

    Parameters
    ----------
    report
        The blind spots.
    patches
        That they are of.
    placement
        Of the mesh file in the part's frame.
    """
    return {BLIND_CSV: _csv(report), BLIND_PLY: _ply(report, patches, placement)}


def blind_pictures(
    report: BlindReport, patches: Patches, scene: Scene, caster: RayCaster, legend: Legend | None = None
) -> Mapping[str, NDArray[np.uint8]]:
    """What the camera sees in each posture, coloured by what the chosen lights show of the defects, by file name.

    Parameters
    ----------
    report, patches
        The blind spots, and the patches that they are of.
    scene, caster
        The part in its postures.
    legend
        Adds a legend to a picture; None for pictures without.
    """
    pictures: dict[str, NDArray[np.uint8]] = {}
    for posture, spots in zip(report.postures, report.chosen_in, strict=True):
        camera = view_from_part(scene, posture).camera
        colours = _colours(spots).astype(np.float64)
        picture = np.full((camera.height, camera.width, 3), BACKGROUND, np.uint8)
        for top in range(0, camera.height, BLOCK_ROWS):
            rows = picture[top : top + BLOCK_ROWS]
            y, x = np.divmod(np.arange(len(rows) * camera.width), camera.width)
            hits, surface = trace_samples(caster, scene.mesh, camera, x + 0.5, top + y + 0.5)
            # the shape is told by how much the surface faces the camera
            facing = np.abs(np.einsum("ij,ij->i", surface.normals, surface.views))
            shade = LEAST_SHADE + (1.0 - LEAST_SHADE) * facing[:, None]
            shaded = colours[patches.patch_at(hits.face, hits.u, hits.v)] * shade
            rows.reshape(-1, 3)[hits.ray] = np.rint(shaded).astype(np.uint8)
        if legend is not None:
            title = (
                f"posture {posture}: shares of the surface × defects without what is left out; pale where other "
                "defects are seen"
            )
            picture = legend(picture, title, blind_legend(spots))
        pictures[f"{posture_folder(posture)}/{BLIND_PNG}"] = picture
    return pictures


def _colours(spots: BlindSpots) -> NDArray[np.uint8]:
    # of each patch, shape (n, 3)
    return np.array([one.colour for one in BLIND_CLASSES], np.uint8)[blind_classes(spots)]


def _csv(report: BlindReport) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["postures", "lights", "what", "share", "share_of", "area_mm2", "colour"])
    names = dict(reason_names(report.lights))
    surface = float(report.chosen.areas.sum())
    counted, whole = "surface x defects without what is left out", "surface"
    for posture, chosen, possible in report.parts():
        where = "all" if posture is None else f"{posture.elevation_deg:g},{posture.rotation_deg:g}"
        for lights, spots in zip(BLIND_LIGHTS, (chosen, possible), strict=True):
            rows = [
                (code, share, counted, share * spots.counted)
                for code, share in {int(Blind.SEEN): spots.seen, **spots.by_reason()}.items()
            ]
            if spots.left_out:
                rows.append((int(Blind.GRAZING), spots.left_out, whole, spots.left_out * surface))
            for code, share, of, area in rows:
                colour = "#{:02x}{:02x}{:02x}".format(*blind_class(code).colour)
                table.writerow([where, lights, names[code], f"{share:.6f}", of, f"{area:.6g}", colour])
    return text.getvalue()


def _ply(report: BlindReport, patches: Patches, placement: Placement) -> bytes:
    # corners in the coordinates of the mesh file: x_file = Rᵀ·(x − t)
    vertices = (patches.vertices - placement.translation) @ placement.rotation
    codes = [f"comment code {code}: {name}" for code, name in reason_names(report.lights)]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment lightopt blind spots; lengths in mm, coordinates of the part's own file (GLB: Z up)",
        f"comment seen and code: chosen lights; {report.objective.seen_in} or more images of all postures show it",
        "comment reachable and reachable_code: each light where it shows the defect, whatever the others",
        "comment seen, reachable: weighted share of the defects, 0 to 1",
        *(f"comment colour {' '.join(map(str, one.colour))}: {one.label}" for one in BLIND_CLASSES),
        *codes,
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(patches)}",
        "property list uchar int vertex_indices",
        *(f"property uchar {channel}" for channel in ("red", "green", "blue")),
        "property float seen",
        "property uchar code",
        "property float reachable",
        "property uchar reachable_code",
        "end_header",
    ]
    faces = np.zeros(
        len(patches),
        np.dtype(
            [
                ("count", "u1"),
                ("corners", "<i4", 3),
                ("colour", "u1", 3),
                ("seen", "<f4"),
                ("code", "u1"),
                ("reachable", "<f4"),
                ("reachable_code", "u1"),
            ]
        ),
    )
    faces["count"] = 3
    faces["corners"] = patches.triangles
    faces["colour"] = _colours(report.chosen)
    faces["seen"], faces["code"] = report.chosen.share, np.minimum(report.chosen.codes, 255)
    faces["reachable"] = report.possible.share
    faces["reachable_code"] = np.minimum(report.possible.codes, 255)
    text = "".join(f"{_printable(line)}\n" for line in header)
    return text.encode("ascii") + vertices.astype("<f4").tobytes() + faces.tobytes()


def _printable(line: str) -> str:
    # a header is ASCII without control characters, whatever lights are called
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in line)
