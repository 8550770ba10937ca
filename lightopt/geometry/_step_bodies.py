"""Names of the bodies of a STEP file (ISO 10303-21), which the CAD kernel leaves out, and the faces that are theirs.

The kernel gives the faces of a product one after the other, body by body. So that no name is guessed, a run of faces is
a body's only if it has as many faces, and all of the body's vertices are among the corners of its triangles.
"""

import re
from dataclasses import dataclass, replace
from itertools import groupby, islice
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.units import step_units_mm

_COMMENT = re.compile(rb"('[^']*')|/\*.*?\*/", re.DOTALL)  # or a string, which may have one in it
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


def _bodies(data: bytes) -> list[StepBody] | str:
    # or why their names are not read; none where none of them has a name
    data = _COMMENT.sub(rb"\1", data) if b"/*" in data else data
    if _NAMED_BODY.search(data) is None:
        return []
    units = step_units_mm(data)
    if len(units) != 1:
        return f"the file declares {'several units' if units else 'no known unit'} of length"
    instances = {int(one[1]): (one[2], one[3]) for one in _INSTANCE.finditer(data)}
    own = [number for number, (kind, _) in instances.items() if kind in _BODIES]
    if len(own) > _MOST_BODIES:
        return f"the file has {len(own):,} bodies, names are read of at most {_MOST_BODIES}"
    return [_body(number, instances, *units) for number in own]


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


def name_bodies(parts: list[dict[str, Any]], data: bytes, mm_per_unit: float) -> tuple[str, ...]:
    """Add the names of a STEP file's bodies to the pieces of its faces; warnings that say why some have none.

    parts: As `parse_glb` returns them, a part for each face, lengths in units of `mm_per_unit` [mm]
    """
    bodies = _bodies(data)
    if isinstance(bodies, str):
        return (f"names of bodies not read: {bodies}",)
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
    from scipy.spatial import KDTree  # takes long to load, and most commands do not need it

    bodies = [one for one in bodies if one.faces and len(one.points)]
    counts = np.array([one.faces for one in bodies], np.intp)
    boxes = np.array([(one.points.min(axis=0), one.points.max(axis=0)) for one in bodies]).reshape(-1, 2, 3)
    # of the faces before one, no more than two ways
    ways: dict[int, set[tuple[str, ...]]] = {0: {()}}
    for begin in range(len(faces)):
        if not (before := ways.pop(begin, ())):
            continue
        last = np.minimum(counts, len(faces) - begin) - 1
        least = np.minimum.accumulate(low[begin:])[last] - same
        most = np.maximum.accumulate(high[begin:])[last] + same
        within = ((boxes[:, 0] >= least) & (boxes[:, 1] <= most)).all(axis=1) & (counts == last + 1)
        for body in (bodies[i] for i in np.flatnonzero(within)):
            end = begin + body.faces
            if (KDTree(np.concatenate(faces[begin:end])).query(body.points)[0] <= same).all():
                more = {names + (body.name,) * body.faces for names in before}
                ways[end] = set(islice(ways.get(end, set()) | more, 2))
    found = ways.get(len(faces), ())
    return next(iter(found)) if len(found) == 1 else None
