"""Blind spots as files: a table, and a coloured surface in the coordinates of the part's file."""

import csv
import io
from collections.abc import Mapping

import numpy as np

from lightopt.design.blind_spots._blind_spots import BlindReason
from lightopt.design.blind_spots._legend import BLIND_CLASSES, blind_class, blind_colours
from lightopt.design.blind_spots._summary import BLIND_LIGHTS, BlindSpotSummary, reason_names
from lightopt.geometry import Patches
from lightopt.scene import Placement

BLIND_CSV, BLIND_PLY, BLIND_PNG = BLIND_NAMES = "blind.csv", "blind.ply", "blind.png"


def blind_files(summary: BlindSpotSummary, patches: Patches, placement: Placement) -> Mapping[str, str | bytes]:
    """``blind.csv`` and ``blind.ply``; `placement` is that of the mesh file in the part's frame."""
    return {BLIND_CSV: _csv(summary), BLIND_PLY: _ply(summary, patches, placement)}


def _csv(summary: BlindSpotSummary) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["postures", "lights", "what", "share", "share_of", "area_mm2", "colour"])
    names = dict(reason_names(summary.lights))
    surface = float(summary.chosen.areas.sum())
    counted, whole = "surface x defects without what is left out", "surface"
    for posture, chosen, possible in summary.parts():
        where = "all" if posture is None else f"{posture.elevation_deg:g},{posture.rotation_deg:g}"
        for lights, spots in zip(BLIND_LIGHTS, (chosen, possible), strict=True):
            rows = [
                (code, share, counted, share * spots.counted)
                for code, share in {int(BlindReason.SEEN): spots.seen, **spots.by_reason()}.items()
            ]
            if spots.left_out:
                rows.append((int(BlindReason.GRAZING), spots.left_out, whole, spots.left_out * surface))
            for code, share, of, area in rows:
                colour = "#{:02x}{:02x}{:02x}".format(*blind_class(code).colour)
                table.writerow([where, lights, names[code], f"{share:.6f}", of, f"{area:.6g}", colour])
    return text.getvalue()


def _ply(summary: BlindSpotSummary, patches: Patches, placement: Placement) -> bytes:
    # corners in the coordinates of the mesh file: x_file = Rᵀ·(x − t)
    vertices = (patches.vertices - placement.translation) @ placement.rotation
    codes = [f"comment code {code}: {name}" for code, name in reason_names(summary.lights)]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment lightopt blind spots; lengths in mm, coordinates of the part's own file (GLB: Z up)",
        f"comment seen and code: chosen lights; {summary.objective.min_images} or more images of all postures show it",
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
    faces["colour"] = blind_colours(summary.chosen)
    faces["seen"], faces["code"] = summary.chosen.share, np.minimum(summary.chosen.codes, 255)
    faces["reachable"] = summary.possible.share
    faces["reachable_code"] = np.minimum(summary.possible.codes, 255)
    text = "".join(f"{_printable(line)}\n" for line in header)
    return text.encode("ascii") + vertices.astype("<f4").tobytes() + faces.tobytes()


def _printable(line: str) -> str:
    # a header is ASCII without control characters, whatever lights are called
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in line)
