"""Names of the bodies of a STEP file (ISO 10303-21), which the CAD kernel leaves out, and the faces that are theirs.

The kernel gives the faces of a product one after the other, body by body. So that no name is guessed, a run of faces is
a body's only if it has as many faces, and all of the body's vertices are among the corners of its triangles.
"""

import re
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby, islice
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64

_INSTANCE = re.compile(rb"#(\d+)\s*=\s*(\w+)\s*\(((?:'[^']*'|[^';])*)\)\s*;")
_NAMED_BODY = re.compile(
    rb"(?:MANIFOLD_SOLID_BREP|BREP_WITH_VOIDS|FACETED_BREP|SHELL_BASED_SURFACE_MODEL)\s*\(\s*'[^']"
)
_BODIES = (b"MANIFOLD_SOLID_BREP", b"BREP_WITH_VOIDS", b"FACETED_BREP", b"SHELL_BASED_SURFACE_MODEL")
_FACES = (b"ADVANCED_FACE", b"FACE_SURFACE")
# what leads from a body to its faces and vertices; not to curves and surfaces, whose points are not on the body
_TOPOLOGY = re.compile(rb"\w*SHELL|FACE_(?:OUTER_)?BOUND|\w*EDGE\w*|VERTEX_\w+|POLY_LOOP|CARTESIAN_POINT")
_FIRST_TEXT = re.compile(rb"\s*'((?:[^']|'')*)'")
_MOST_BODIES = 500
_SAME_MM, _SAME_SHARE = 1e-3, 1e-6  # vertices and corners differ by less: in mm, and as a share of the part's size


@dataclass(frozen=True)
class StepBody:
    name: str
    faces: int
    points: Float64  # its vertices, in the frame of its product [mm], shape (k, 3)


def step_bodies(data: bytes, unit_mm: float) -> list[StepBody]:
    """The bodies of a STEP file; none where none of them has a name."""
    if _NAMED_BODY.search(data) is None:
        return []
    instances = {int(one[1]): (one[2], one[3]) for one in _INSTANCE.finditer(data)}
    return [_body(number, instances, unit_mm) for number, (kind, _) in instances.items() if kind in _BODIES]


def _body(number: int, instances: dict[int, tuple[bytes, bytes]], unit_mm: float) -> StepBody:
    todo, seen, faces, points = [number], {number}, 0, list[list[float]]()
    while todo:
        kind, text = instances[todo.pop()]
        faces += kind in _FACES
        if kind == b"CARTESIAN_POINT":
            points.append([unit_mm * float(x) for x in text.rpartition(b"(")[2].strip(b") \r\n").split(b",")])
        for reference in map(int, re.findall(rb"#(\d+)", text)):
            leads = instances.get(reference, (b"",))[0]
            if reference not in seen and (leads in _FACES or _TOPOLOGY.fullmatch(leads)):
                seen.add(reference)
                todo.append(reference)
    found = _FIRST_TEXT.match(instances[number][1])
    name = "" if found is None else _decoded(found[1].decode("utf-8", "replace"))
    return StepBody(name, faces, np.array(points, np.float64).reshape(-1, 3))


def _decoded(text: str) -> str:
    # ISO 10303-21, 6.4.3: '' is one quote, \X2\...\X0\ has 16 bits for each letter, \X\ has 8
    text = re.sub(
        r"\\X2\\((?:[0-9A-F]{4})+)\\X0\\", lambda one: bytes.fromhex(one[1]).decode("utf-16-be", "replace"), text
    )
    text = re.sub(r"\\X\\([0-9A-F]{2})", lambda one: chr(int(one[1], 16)), text)
    return "" if text in ("NONE", "None") else text.replace("''", "'").strip()


def name_bodies(parts: list[dict[str, Any]], bodies: list[StepBody], mm_per_unit: float) -> tuple[str, ...]:
    """Add the bodies' names to the pieces of a product's faces; warnings about products that do not match them.

    parts: As `parse_glb` returns them, a part for each face, lengths in units of `mm_per_unit` [mm]
    """
    unmatched: list[str] = []
    for _, own in groupby(parts, key=lambda part: part["node"]) if bodies else ():
        faces = list(own)
        names = _names([mm_per_unit * part["local"] for part in faces], bodies)
        if names is None:
            unmatched.append(faces[0]["piece"].names[0] if faces[0]["piece"].names else "a part without a name")
            continue
        for part, name in zip(faces, names, strict=True):
            if name and name not in part["piece"].names:
                part["piece"] = replace(part["piece"], names=(*part["piece"].names, name))
    text = "its named bodies do not match the faces that the CAD kernel finds, or not in one way only: names not read"
    return tuple(f"{name}: {text}" for name in dict.fromkeys(unmatched))


def _names(faces: list[Float64], bodies: list[StepBody]) -> tuple[str, ...] | None:
    # of each face, given its corners [mm]; None unless bodies make up all of the faces in one way
    low, high = np.array([one.min(axis=0) for one in faces]), np.array([one.max(axis=0) for one in faces])
    same = _SAME_MM + _SAME_SHARE * float((high.max(axis=0) - low.min(axis=0)).max())

    @cache
    def ways(begin: int) -> frozenset[tuple[str, ...]]:
        # of the faces from one on; no more than two
        found = set[tuple[str, ...]]() if begin < len(faces) else {()}
        for body in bodies:
            end = begin + body.faces
            if not begin < end <= len(faces) or not len(body.points):
                continue
            least, most = low[begin:end].min(axis=0) - same, high[begin:end].max(axis=0) + same
            if (body.points >= least).all() and (body.points <= most).all():
                corners = KDTree(np.concatenate(faces[begin:end]))
                if (corners.query(body.points)[0] <= same).all():
                    found |= {(body.name,) * body.faces + more for more in ways(end)}
        return frozenset(islice(found, 2))

    from scipy.spatial import KDTree  # takes long to load, and most commands do not need it

    found = ways(0) if len(bodies) <= _MOST_BODIES else ()
    return next(iter(found)) if len(found) == 1 else None
