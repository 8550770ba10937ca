"""Faceted files (STL, PLY, OBJ, GLB) as triangles in the file's unit, and plain solids; all that calls trimesh.

trimesh reads the numbers, but for those of binary STL and of most binary PLY: they are arrays, and trimesh takes longer
to load than most commands have to compute. What it would pass over in silence (a file cut off, counts that disagree
with the header, an index out of range) is found here first, so that the message can say what is wrong with the file.
"""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lightopt.core.arrays import Float32, Float64, Int32, Int64
from lightopt.core.errors import InputError
from lightopt.geometry._glb import MeshPiece, glb_triangle_count, parse_glb, placed, split_glb
from lightopt.geometry._triangle_mesh import TriangleMesh, face_normals

_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attributes", "<u2")])

# a binary PLY file of vertices and faces alone, without comments
_PLAIN_PLY = re.compile(
    r"ply\s+format binary_(little|big)_endian 1\.0\s+element vertex ([1-9]\d*)\s+((?:property \w+ \w+\s+)+)"
    r"element face ([1-9]\d*)\s+property list (\w+) (\w+) \w+\s+end_header\s+"
)
_PLY_NAMES = (
    *("char i1", "uchar u1", "short i2", "ushort u2", "int i4", "uint u4", "float f4", "double f8"),
    *("int8 i1", "uint8 u1", "int16 i2", "uint16 u2", "int32 i4", "uint32 u4", "float32 f4", "float64 f8"),
)
_PLY_NUMBERS: dict[str, str] = dict(pair.split(maxsplit=1) for pair in _PLY_NAMES)
_SUBDIVISIONS = 6  # of a sphere: 81,920 triangles, whose middles are 0.004 % of the radius inside it

# Peak of loading and smoothing a binary STL of 1.3 million triangles: 700 bytes each, measured.
_BYTES_PER_TRIANGLE = 700


@dataclass(frozen=True, eq=False)
class RawMesh:
    """Triangles of a file in the file's unit."""

    vertices: Float32 | Float64  # positions [file unit], Z up, shape (n, 3); float32 where the file has no more
    faces: Int32 | Int64  # vertex indices as found in the file, shape (m, 3)
    normals: Float64 | None  # vertex normals carried by the file, not necessarily of unit length, shape (n, 3)
    format: str  # for messages, such as "binary STL"
    repeats_vertices: bool  # for each face or seam, so that coinciding vertices are nothing to report
    warnings: tuple[str, ...] = ()  # what was noticed while reading
    pieces: tuple[MeshPiece, ...] = ()  # where they were asked for
    piece: Int32 | None = None  # index of the piece of each face, shape (m,)
    texture: Float64 | None = None  # u, v of the corners of each face, NaN where it has none, (m, 3, 2); with pieces
    unnamed: tuple[str, ...] = ()  # why pieces have no names: some of the warnings


def check_budget(name: str, triangles: int, max_triangles: int) -> None:
    """Refuse a mesh of more than `max_triangles` before its data is loaded."""
    if triangles > max_triangles:
        gigabytes = triangles * _BYTES_PER_TRIANGLE / 1e9
        cost = f"loading them would take about {gigabytes:.1f} GB of memory. Export the part with a coarser tolerance"
        raise InputError(f"{name}: {triangles:,} triangles, at most {max_triangles:,} are accepted; {cost}")


def read_stl(name: str, data: bytes, max_triangles: int) -> RawMesh:
    claimed = int.from_bytes(data[80:84], "little") if len(data) >= 84 else 0
    is_binary = len(data) == 84 + 50 * claimed
    # the header of a binary file may begin with solid as well; text holds no zeros
    is_text = re.match(rb"\s*solid\b", data[:200], re.IGNORECASE) is not None and b"\0" not in data[:500]
    if not is_binary and not is_text:
        raise InputError(_no_binary_stl(name, data, claimed))
    if is_binary:
        check_budget(name, claimed, max_triangles)
        if not claimed:
            raise InputError(f"{name}: the binary STL file has no triangles")
        vertices = np.frombuffer(data, _STL_TRIANGLE, offset=84)["vertices"].reshape(-1, 3)
        faces = np.arange(3 * claimed, dtype=np.int32).reshape(-1, 3)
        return RawMesh(vertices.astype(np.float32, copy=False), faces, None, "binary STL", True)
    from trimesh.exchange.stl import load_stl

    claimed = _check_ascii_stl(name, data)
    check_budget(name, claimed, max_triangles)
    loaded = _trimesh(name, "STL", lambda: load_stl(io.BytesIO(data)))
    parts = list(loaded["geometry"].values()) if "geometry" in loaded else [loaded]
    raw = joined(name, parts, "ASCII STL", repeats_vertices=True)
    if len(raw.faces) != claimed:
        raise InputError(f"{name}: {claimed} triangles in the ASCII STL file, but only {len(raw.faces)} could be read")
    return raw


def _no_binary_stl(name: str, data: bytes, claimed: int) -> str:
    if len(data) < 84:
        return f"{name}: not an STL file: {len(data)} bytes, a binary STL has a header of 84"
    return (
        f"{name}: its header says {claimed:,} triangles ({84 + 50 * claimed:,} bytes), but the file has "
        f"{len(data):,} bytes: a binary STL file that is cut off, or none. Export or copy it again"
    )


def _check_ascii_stl(name: str, data: bytes) -> int:
    begun = len(re.findall(rb"^\s*facet\b", data, re.MULTILINE | re.IGNORECASE))
    ended = len(re.findall(rb"^\s*endfacet\b", data, re.MULTILINE | re.IGNORECASE))
    vertices = len(re.findall(rb"^\s*vertex\b", data, re.MULTILINE | re.IGNORECASE))
    closed = re.search(rb"^\s*endsolid\b[^\n]*\s*\Z", data[-1000:], re.MULTILINE | re.IGNORECASE)
    if begun != ended or vertices != 3 * begun or closed is None:
        raise InputError(
            f"{name}: the ASCII STL file is cut off or damaged: {begun} facets begin, {ended} end, "
            f"{vertices} vertices{'' if closed else ', no endsolid at the end'}. Export or copy it again"
        )
    if not begun:
        raise InputError(f"{name}: the ASCII STL file has no triangles")
    return begun


def read_ply(name: str, data: bytes, max_triangles: int, *, pieces: bool = False) -> RawMesh:
    """Triangles of an ASCII or binary PLY file; polygons are cut into fans, vertex normals kept.

    pieces: Whether to keep which triangles have which colour, by themselves or at two corners, and texture coordinates
    """
    end = re.search(rb"^end_header[ \t]*\r?\n", data, re.MULTILINE)
    if not data.startswith(b"ply") or end is None:
        raise InputError(f"{name}: not a PLY file, or cut off in its header: expected 'ply' … 'end_header'")
    header = data[: end.end()].decode("ascii", "replace")
    counts = {key: int(n) for key, n in re.findall(r"^element\s+(\w+)\s+(\d+)", header, re.MULTILINE)}
    check_budget(name, counts.get("face", 0), max_triangles)
    is_ascii = re.search(r"^format\s+ascii", header, re.MULTILINE) is not None
    if is_ascii:
        rows = len(data[end.end() :].splitlines())
        if rows < sum(counts.values()):
            announced = f"{sum(counts.values()):,} lines ({_listed(counts)})"
            found = f"the file has {rows:,}: cut off. Export or copy it again"
            raise InputError(f"{name}: the PLY header announces {announced}, {found}")
    if not pieces and (raw := _plain_ply(data, end.end(), header)) is not None:
        return raw
    from trimesh.exchange.ply import load_ply

    kind = "ASCII PLY" if is_ascii else "binary PLY"
    loaded = _trimesh(
        name, f"{kind} ({_listed(counts)})", lambda: load_ply(io.BytesIO(data), fix_texture=False, skip_materials=True)
    )
    if "faces" not in loaded:
        raise InputError(f"{name}: the {kind} file has no triangles ({_listed(counts)})")
    raw = joined(name, [loaded], kind, repeats_vertices=False)
    if len(raw.vertices) != counts.get("vertex", 0) or len(raw.faces) < counts.get("face", 0):
        found = f"{len(raw.vertices)} vertices and {len(raw.faces)} triangles. The file is damaged; export it again"
        raise InputError(f"{name}: the PLY header announces {_listed(counts)}; found {found}")
    if pieces and re.search(r"^property list \w+ \w+ texcoord\b", header, re.MULTILINE):
        # trimesh gives a vertex the coordinates of one of its corners
        of_faces = loaded["metadata"]["_ply_raw"]["face"]["data"]["texcoord"]
        corners = np.asarray(of_faces if is_ascii else of_faces["f1"], np.float64)
        raw = replace(raw, texture=corners.reshape(-1, 3, 2) if corners.shape == (len(raw.faces), 6) else None)
    return _coloured(raw, loaded) if pieces else raw


def _coloured(raw: RawMesh, loaded: dict[str, Any]) -> RawMesh:
    # with a piece of each colour; the files of paint programs have colours of vertices, others those of faces
    faces, vertices = (loaded.get(key) for key in ("face_colors", "vertex_colors"))
    if faces is not None and len(np.shape(faces)) == 2 and len(faces) == len(raw.faces):
        colours = np.asarray(faces)[:, :3]
    elif vertices is not None and len(np.shape(vertices)) == 2:
        a, b, c = (np.asarray(vertices)[raw.faces[:, k], :3] for k in range(3))
        # the colour of two corners, or of the first
        colours = np.where((b == c).all(axis=1)[:, None], b, a)
    else:
        return raw
    own, piece = np.unique(colours, axis=0, return_inverse=True)
    names = (MeshPiece(colour="#" + bytes(one.astype(np.uint8)).hex().upper()) for one in own)
    return replace(raw, pieces=tuple(names), piece=piece.ravel().astype(np.int32))


def _plain_ply(data: bytes, begin: int, header: str) -> RawMesh | None:
    """A binary PLY file of vertices and triangles alone, whose data begins at a byte; None of any other file."""
    found = _PLAIN_PLY.fullmatch(re.sub(r"^(?:comment|obj_info)\b.*\n", "", header, flags=re.MULTILINE))
    if found is None:
        return None
    order = "<" if found[1] == "little" else ">"
    properties = re.findall(r"property (\w+) (\w+)", found[3])
    names = [name for _, name in properties]
    kinds = [_PLY_NUMBERS.get(kind) for kind in (*(kind for kind, _ in properties), found[5], found[6])]
    if None in kinds or len(set(names)) < len(names) or not set("xyz") <= set(names):
        return None
    vertex = np.dtype([(name, f"{order}{kind}") for name, kind in zip(names, kinds, strict=False)])
    face = np.dtype([("count", f"{order}{kinds[-2]}"), ("corners", f"{order}{kinds[-1]}", 3)])
    vertex_count, face_count = int(found[2]), int(found[4])
    middle = begin + vertex_count * vertex.itemsize
    if len(data) != middle + face_count * face.itemsize or kinds[-1] in ("f4", "f8"):
        return None
    faces = np.frombuffer(data, face, offset=middle)
    if (faces["count"] != 3).any():
        return None
    vertices = np.frombuffer(data, vertex, vertex_count, begin)

    def rows(columns: tuple[str, str, str], kind: type[np.floating]) -> Any:
        return np.stack([vertices[name] for name in columns], axis=1).astype(kind, copy=False)

    of_float32 = all(vertex[name].kind == "f" and vertex[name].itemsize == 4 for name in "xyz")
    points = rows(("x", "y", "z"), np.float32 if of_float32 else np.float64)
    corners = faces["corners"].astype(np.int64) if kinds[-1] == "u4" else faces["corners"].astype(np.int32)
    normals = rows(("nx", "ny", "nz"), np.float64) if {"nx", "ny", "nz"} <= set(names) else None
    return RawMesh(points, corners, normals, "binary PLY", repeats_vertices=False)


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{key} {n:,}" for key, n in counts.items())


def read_obj(name: str, data: bytes, max_triangles: int, *, pieces: bool = False) -> RawMesh:
    """Triangles of a Wavefront OBJ file; polygons are cut into fans, vertex normals kept where all have them.

    pieces: Whether to keep which triangles are of which object, group and material, and texture coordinates
    """
    from trimesh.exchange.obj import load_obj

    check_budget(name, len(re.findall(rb"^f\s", data, re.MULTILINE)), max_triangles)
    checks = (
        (rb"^f(?:[ \t]+[\d/-]+){0,2}[ \t]*\r?$", "a face with fewer than three vertices"),
        (rb"^f\b[^\n]*[ \t]0+(?=[/\s]|\Z)", "a face that uses vertex 0, OBJ counts from 1"),
    )
    for pattern, what in checks:
        found = re.search(pattern, data, re.MULTILINE)
        if found is not None:
            line = data.count(b"\n", 0, found.start()) + 1
            text = found.group().decode("ascii", "replace").strip()
            advice = "The file is cut off or damaged; export or copy it again"
            raise InputError(f"{name}, line {line}: {what}: {text!r}. {advice}")
    text, named = _numbered_groups(data) if pieces else (data, {})
    how: dict[str, Any] = {"split_groups": True, "group_material": False} if pieces else {}
    loaded = _trimesh(name, "OBJ", lambda: load_obj(io.BytesIO(text), skip_materials=True, **how))
    geometry = loaded.get("geometry", {})
    parts = (
        [{**one, "piece": named.get(key, MeshPiece())} for key, one in geometry.items()]
        if pieces
        else list(geometry.values())
    )
    if not parts:
        raise InputError(f"{name}: the OBJ file has no triangles")
    seams = re.search(rb"^vt\s", data, re.MULTILINE) is not None
    return joined(name, parts, "OBJ", repeats_vertices=seams)


def _numbered_groups(data: bytes) -> tuple[bytes, dict[str, MeshPiece]]:
    # an OBJ file with a group of its own for each object, group and material in turn, and what the groups' names mean;
    # faces without texture coordinates at a corner are other groups, as trimesh reads all of a group's or none
    current: dict[bytes, str] = {}
    found: dict[tuple[MeshPiece, bool], str] = {}
    piece, bare = MeshPiece(), False

    def number(line: re.Match[bytes]) -> bytes:
        nonlocal piece, bare
        before, face = bare, b""
        if line[1] == b"f":
            bare = re.search(rb"\s-?\d+(?://|/?(?:\s|\Z))", line[2]) is not None
            face = re.sub(rb"(\d)/-?\d*(/-?\d+)?", rb"\1/\2", line[0]) if bare else line[0]
            if bare == before:
                return face
        else:
            current[line[1]] = line[2].strip().decode("utf-8", "replace")
            piece = MeshPiece(names=tuple(name for name in dict.fromkeys(current.values()) if name))
        return f"g {found.setdefault((piece, bare), f'piece-{len(found)}')}\n".encode() + face

    # looking at the first corners does not take long, at each face it does
    mixed = all(re.search(rb"^f\s+-?\d+" + one, data, re.MULTILINE) for one in (rb"/-?\d", rb"(?://|/?\s)"))
    text = re.sub(rb"^(o|g|usemtl%b)\b([^\r\n]*)" % (b"|f" if mixed else b""), number, data, flags=re.MULTILINE)
    return text, {key: piece for (piece, _), key in found.items()}


def read_glb(name: str, data: bytes, max_triangles: int, *, pieces: bool = False) -> RawMesh:
    """Triangles of a binary glTF 2.0 file [m], all nodes in place, from Y up, as glTF is, to Z up: (x, −z, y).

    pieces: Whether to keep which triangles are of which node, mesh and material, and texture coordinates
    """
    tree, _ = split_glb(name, data)
    count = glb_triangle_count(name, tree)
    check_budget(name, count, max_triangles)
    attributes = [p["attributes"] for mesh in tree.get("meshes", []) for p in mesh["primitives"]]
    seams = any(key.startswith("TEXCOORD") for a in attributes for key in a)
    parts = parse_glb(name, data) if pieces else _glb_parts(name, data, all("NORMAL" in a for a in attributes))
    if not parts:
        raise InputError(f"{name}: the GLB file has no triangles in its scene")
    raw = joined(name, parts, "GLB", repeats_vertices=seams)
    z_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    normals = None if raw.normals is None else raw.normals @ z_up.T
    return replace(raw, vertices=raw.vertices @ z_up.T, normals=normals)


def _glb_parts(name: str, data: bytes, has_normals: bool) -> list[dict[str, Any]]:
    import trimesh

    scene = _trimesh(
        name, "GLB", lambda: trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False, skip_materials=True)
    )
    parts: list[dict[str, Any]] = []
    for node in sorted(scene.graph.nodes_geometry):
        matrix, key = scene.graph[node]
        geometry = scene.geometry[key]
        if isinstance(geometry, trimesh.Trimesh):
            normals = np.asarray(geometry.vertex_normals) if has_normals else None
            parts.append(placed(matrix, np.asarray(geometry.vertices), np.asarray(geometry.faces), normals))
    return parts


def _trimesh(name: str, kind: str, read: Callable[[], Any]) -> Any:
    try:
        return read()
    except MemoryError:
        raise
    except Exception as error:  # a damaged file can make trimesh raise anything
        advice = "The file is cut off, damaged or of another format; export or copy it again"
        raise InputError(f"{name}: could not be read as {kind}: {error}. {advice}") from error


def joined(name: str, parts: list[dict[str, Any]], kind: str, *, repeats_vertices: bool) -> RawMesh:
    vertices = [np.asarray(part["vertices"], dtype=np.float64) for part in parts]
    for some in vertices:
        if some.ndim != 2 or some.shape[1] != 3:
            found = f"vertices of {some.shape[-1]} coordinates, expected 3"
            raise InputError(f"{name}: the {kind} file has {found}. The file is damaged; export or copy it again")
    starts = np.cumsum([0, *map(len, vertices)])
    faces = [_fans(np.asarray(part["faces"], np.int64)) + start for part, start in zip(parts, starts, strict=False)]
    normals = [np.asarray(n, np.float64) for part in parts if (n := part.get("vertex_normals")) is not None]
    complete = len(normals) == len(parts)
    warnings = ()
    if normals and not complete:
        warnings = (f"{len(normals)} of {len(parts)} pieces of the {kind} file carry vertex normals: not used",)
    carried = np.concatenate(normals) if complete else None
    pieces = tuple(part["piece"] for part in parts if "piece" in part)
    uvs = [getattr(part.get("visual"), "uv", part.get("texture")) for part in parts]
    texture = None
    if any(uv is not None for uv in uvs):
        rows = [np.full((len(v), 2), np.nan) if uv is None else uv[:, :2] for uv, v in zip(uvs, vertices, strict=True)]
        texture = np.concatenate(rows, dtype=np.float64)[np.concatenate(faces)]
    return RawMesh(
        np.concatenate(vertices),
        np.concatenate(faces),
        carried,
        kind,
        repeats_vertices,
        warnings,
        pieces,
        np.repeat(np.arange(len(parts), dtype=np.int32), [len(some) for some in faces]) if pieces else None,
        texture,
    )


def _fans(polygons: Int64) -> Int64:
    """Triangles (0, k, k+1) of polygons with the same number of corners, shape (m, 3)."""
    return np.stack([polygons[:, (0, k, k + 1)] for k in range(1, polygons.shape[1] - 1)], axis=1).reshape(-1, 3)


def stl_bytes(mesh: TriangleMesh) -> bytes:
    """A mesh [mm] as a binary STL file; normals are those of the facets."""
    triangles = np.zeros(len(mesh.faces), _STL_TRIANGLE)
    triangles["vertices"] = mesh.vertices[mesh.faces]
    triangles["normal"] = face_normals(mesh)
    return bytes(80) + len(triangles).to_bytes(4, "little") + triangles.tobytes()


def sphere_mesh(radius: float) -> TriangleMesh:
    """A sphere about the origin, with its own normals; radius [mm]."""
    from trimesh import creation

    unit = creation.icosphere(subdivisions=_SUBDIVISIONS)
    normals = np.asarray(unit.vertices, np.float64)
    return TriangleMesh(vertices=radius * normals, faces=np.asarray(unit.faces, np.int32), normals=normals)


def box_mesh(corners: Float64) -> TriangleMesh:
    """A box between two corners [mm], shape (2, 3)."""
    from trimesh import creation

    box = creation.box(bounds=corners)
    return TriangleMesh(vertices=np.asarray(box.vertices, np.float64), faces=np.asarray(box.faces, np.int32))
