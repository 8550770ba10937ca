"""Blind spots as files: a table, and a coloured surface in the coordinates of the part's file.

Their colours and legend are the same in pictures, ``blind.csv``, ``blind.ply`` and report.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import UInt8
from lightopt.design.blind_spots import _blind_spots
from lightopt.design.objectives._objective import share_text
from lightopt.geometry import Patches
from lightopt.images import csv_text
from lightopt.scene import Placement

Colour = tuple[int, int, int]  # red, green and blue, 0 to 255


@dataclass(frozen=True, kw_only=True)
class BlindClass:
    """Patches of one colour: why defects are not seen there, and whether others are.

    :attr:`BlindReason.SATURATED` stands for every light.
    """

    code: _blind_spots.BlindReason
    some_seen: bool
    label: str
    colour: Colour


@dataclass(frozen=True)
class LegendRow:
    """A line of a legend: label, share in words, and the colours that stand for it.

    Shares are of the part's surface × defects; what is left out is a share of the whole surface.
    """

    label: str
    amount: str
    colours: tuple[Colour, ...]


# Okabe and Ito, Color Universal Design (2008): apart with any colour vision; in the order of the legend
_COLOURS = {
    _blind_spots.BlindReason.SEEN: (86, 180, 233),
    _blind_spots.BlindReason.CONTRAST: (240, 228, 66),
    _blind_spots.BlindReason.SATURATED: (213, 94, 0),
    _blind_spots.BlindReason.SHADOWED: (11, 60, 93),
    _blind_spots.BlindReason.GRAZING: (204, 121, 167),
    _blind_spots.BlindReason.CAMERA: (201, 206, 214),
}
_ONE_CLASS = (_blind_spots.BlindReason.SEEN, _blind_spots.BlindReason.GRAZING, _blind_spots.BlindReason.CAMERA)


def _classes_of(code: _blind_spots.BlindReason, colour: Colour) -> tuple[BlindClass, ...]:
    label = _blind_spots.blind_text(code, ["a light"])
    none_seen = BlindClass(code=code, some_seen=code == _blind_spots.BlindReason.SEEN, label=label, colour=colour)
    if code in _ONE_CLASS:
        return (none_seen,)
    red, green, blue = ((channel + 255) // 2 for channel in colour)
    label = f"{label}, other defects found"
    return none_seen, BlindClass(code=code, some_seen=True, label=label, colour=(red, green, blue))


BLIND_CLASSES = tuple(one for code, colour in _COLOURS.items() for one in _classes_of(code, colour))
"""Seen, and each reason: in its own colour where no defect is seen, pale where others are."""


def blind_class(code: int) -> BlindClass:
    """The class of a code where no defect is seen, or where all are."""
    return next(one for one in BLIND_CLASSES if one.code == min(code, _blind_spots.BlindReason.SATURATED))


def blind_classes(spots: _blind_spots.BlindSpots) -> UInt8:
    """Class of each patch, indices into :data:`BLIND_CLASSES`, shape (n,)."""
    codes, some = np.minimum(spots.codes, _blind_spots.BlindReason.SATURATED), spots.share > 0.0
    classes = np.zeros(len(codes), np.uint8)
    for index, one in enumerate(BLIND_CLASSES):
        classes[(codes == one.code) & ((some == one.some_seen) | (one.code in _ONE_CLASS))] = index
    return classes


def blind_colours(spots: _blind_spots.BlindSpots) -> UInt8:
    """Colour of each patch, shape (n, 3)."""
    return np.array([one.colour for one in BLIND_CLASSES], np.uint8)[blind_classes(spots)]


def blind_legend(spots: _blind_spots.BlindSpots) -> tuple[LegendRow, ...]:
    """What is seen, and every reason that occurs, with the colours that stand for it."""
    shares = dict.fromkeys(_blind_spots.BlindReason, 0.0)
    shares[_blind_spots.BlindReason.SEEN], shares[_blind_spots.BlindReason.GRAZING] = spots.seen, spots.left_out
    for code, share in spots.by_reason().items():
        shares[_blind_spots.BlindReason(min(code, _blind_spots.BlindReason.SATURATED))] += share
    rows: list[LegendRow] = []
    for code in _COLOURS:
        if shares[code] > 0.0 or code == _blind_spots.BlindReason.SEEN:
            colours = tuple(one.colour for one in BLIND_CLASSES if one.code == code)
            rows.append(LegendRow(blind_class(code).label, share_text(shares[code], spots.grain), colours))
    return tuple(rows)


BLIND_CSV, BLIND_PLY, BLIND_PNG = BLIND_NAMES = "blind.csv", "blind.ply", "blind.png"


def blind_files(
    summary: _blind_spots.BlindSpotSummary, patches: Patches, placement: Placement
) -> Mapping[str, str | bytes]:
    """``blind.csv`` and ``blind.ply``; `placement` is that of the mesh file in the part's frame."""
    return {BLIND_CSV: _csv(summary), BLIND_PLY: _ply(summary, patches, placement)}


def _csv(summary: _blind_spots.BlindSpotSummary) -> str:
    table: list[list[object]] = [["postures", "lights", "what", "share", "share_of", "area_mm2", "colour"]]
    names = dict(_blind_spots.reason_names(summary.lights))
    surface = float(summary.parts[0][1].areas.sum())
    counted, whole = "surface x defects without what is left out", "surface"
    for posture, chosen, possible in summary.parts:
        where = "all" if posture is None else f"{posture.elevation_deg:g},{posture.rotation_deg:g}"
        for lights, spots in zip(_blind_spots.BLIND_LIGHTS, (chosen, possible), strict=True):
            rows = [
                (code, share, counted, share * spots.counted)
                for code, share in {int(_blind_spots.BlindReason.SEEN): spots.seen, **spots.by_reason()}.items()
            ]
            if spots.left_out:
                rows.append((int(_blind_spots.BlindReason.GRAZING), spots.left_out, whole, spots.left_out * surface))
            for code, share, of, area in rows:
                colour = "#{:02x}{:02x}{:02x}".format(*blind_class(code).colour)
                table.append([where, lights, names[code], f"{share:.6f}", of, f"{area:.6g}", colour])
    return csv_text(table)


def _ply(summary: _blind_spots.BlindSpotSummary, patches: Patches, placement: Placement) -> bytes:
    _, chosen, possible = summary.parts[0]
    # corners in the coordinates of the mesh file: x_file = Rᵀ·(x − t)
    vertices = (patches.vertices - placement.translation) @ placement.rotation
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment lightopt blind spots; lengths in mm, coordinates of the part's own file (GLB: Z up)",
        "comment seen and code: found by the images of all postures under the chosen lights",
        "comment reachable and reachable_code: each light where it shows the defect, whatever the others",
        "comment seen, reachable: weighted share of the defects, 0 to 1",
        *(f"comment colour {' '.join(map(str, one.colour))}: {one.label}" for one in BLIND_CLASSES),
        *(f"comment code {code}: {name}" for code, name in _blind_spots.reason_names(summary.lights)),
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
    faces = np.zeros(len(patches), "u1, (3,)<i4, (3,)u1, <f4, u1, <f4, u1")
    columns = [3, patches.triangles, blind_colours(chosen)]
    columns += [column for one in (chosen, possible) for column in (one.share, np.minimum(one.codes, 255))]
    for number, column in enumerate(columns):
        faces[f"f{number}"] = column
    # a header is ASCII without control characters, whatever lights are called
    lines = ("".join(c if c.isascii() and c.isprintable() else "?" for c in line) for line in header)
    text = "".join(f"{line}\n" for line in lines)
    return text.encode("ascii") + vertices.astype("<f4").tobytes() + faces.tobytes()
