"""Binary glTF 2.0 (GLB): its structure, and the triangles of the GLB files that the STEP worker writes."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float64, Int64
from lightopt.core.errors import InputError

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_POINTS_OR_LINES = (0, 1, 2, 3)
_COMPONENTS = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


@dataclass(frozen=True)
class MeshPiece:
    """Triangles of a file that belong together: a group, a solid, a CAD face, those of one colour."""

    names: tuple[str, ...] = ()  # of the group, object, solid or material, as the file has them
    colour: str | None = None  # #RRGGBB as CAD programs show it; None where the file says none


def split_glb(name: str, data: bytes) -> tuple[dict[str, Any], bytes]:
    if len(data) < 20 or data[:4] != b"glTF":
        raise InputError(f"{name}: not a GLB file: expected it to begin with 'glTF', found {data[:4]!r}")
    version, total, json_size = (int.from_bytes(data[k : k + 4], "little") for k in (4, 8, 12))
    if version != 2:
        raise InputError(f"{name}: glTF version {version}, expected 2")
    if total != len(data) or 20 + json_size > total:
        cut = f"the file has {len(data):,}: cut off. Export or copy it again"
        raise InputError(f"{name}: its header says {total:,} bytes, but {cut}")
    try:
        tree = json.loads(data[20 : 20 + json_size])
    except ValueError as error:
        raise InputError(f"{name}: the JSON part of the GLB file is damaged: {error}") from error
    if not isinstance(tree, dict):
        raise InputError(f"{name}: the JSON part of the GLB file is not an object")
    start = 28 + json_size
    size = int.from_bytes(data[20 + json_size : 24 + json_size], "little")
    if data[24 + json_size : start] not in (b"BIN\0", b"") or start + size > max(total, start):
        raise InputError(f"{name}: the binary part of the GLB file is missing or cut off")
    return tree, data[start : start + size]


def glb_triangle_count(name: str, tree: dict[str, Any]) -> int:
    """Count the triangles that the accessors of all meshes announce (each mesh once)."""
    try:
        total = 0
        for primitive in (p for mesh in tree.get("meshes", []) for p in mesh["primitives"]):
            which = primitive.get("indices", primitive["attributes"]["POSITION"])
            count = int(tree["accessors"][which]["count"])
            mode = primitive.get("mode", _TRIANGLES)
            total += count // 3 if mode == _TRIANGLES else max(0, count - 2) if mode in (_STRIP, _FAN) else 0
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"{name}: the GLB file refers to something it does not have: {error!r}") from error
    return total


def placed(matrix: Float64, vertices: Float64, faces: Int64, normals: Float64 | None) -> dict[str, NDArray[Any]]:
    """Vertices, faces and normals after an affine transform, shape (4, 4); a mirror turns the winding."""
    linear = np.asarray(matrix, dtype=np.float64)[:3, :3]
    part: dict[str, NDArray[Any]] = {
        "vertices": vertices @ linear.T + matrix[:3, 3],
        "faces": faces[:, ::-1] if np.linalg.det(linear) < 0 else faces,
    }
    if normals is not None:
        # normals go with the inverse transpose; the cofactor matrix is that without dividing by the determinant
        cofactor = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])
        part["vertex_normals"] = normals @ (cofactor * np.sign(np.linalg.det(linear))).T
    return part


def parse_glb(name: str, data: bytes) -> list[dict[str, Any]]:
    """Meshes of a GLB file, placed by their nodes, axes as stored: positions, normals, indexed triangles.

    Returns: ``vertices`` [file unit] (n, 3), ``faces`` (m, 3), ``vertex_normals`` (n, 3) and ``texture``
        (n, 2) where the file has them, ``piece``, a :class:`MeshPiece`, ``node``, its number, and ``local``, vertices
        in the node's frame.
    """
    tree, blob = split_glb(name, data)
    parts: list[dict[str, Any]] = []
    try:
        nodes = tree.get("nodes", [])
        roots = tree["scenes"][tree.get("scene", 0)]["nodes"]
        stack = [(int(root), np.eye(4)) for root in reversed(roots)]
        while stack:
            index, above = stack.pop()
            matrix = above @ _local(nodes[index])
            stack.extend((int(child), matrix) for child in reversed(nodes[index].get("children", [])))
            if "mesh" not in nodes[index]:
                continue
            mesh = tree["meshes"][nodes[index]["mesh"]]
            for primitive in mesh["primitives"]:
                if (mode := primitive.get("mode", _TRIANGLES)) in _POINTS_OR_LINES:
                    continue
                if mode != _TRIANGLES:
                    raise ValueError(f"{mesh.get('name', 'a mesh')} has strips or fans; expected triangles")
                attributes = primitive["attributes"]
                vertices = _accessor(tree, blob, attributes["POSITION"]).astype(np.float64)
                normals = None
                if "NORMAL" in attributes:
                    normals = _accessor(tree, blob, attributes["NORMAL"]).astype(np.float64)
                which = primitive.get("indices")
                corners = np.arange(len(vertices)) if which is None else _accessor(tree, blob, which).astype(np.int64)
                faces = corners.reshape(-1, 3)
                part: dict[str, Any] = placed(matrix, vertices, faces, normals)
                if "TEXCOORD_0" in attributes:
                    part["texture"] = _accessor(tree, blob, attributes["TEXCOORD_0"])
                material = tree["materials"][primitive["material"]] if "material" in primitive else {}
                names = (one.get("name") for one in (nodes[index], mesh, material))
                part["piece"] = MeshPiece(tuple(dict.fromkeys(str(n) for n in names if n)), _colour(material))
                part["node"], part["local"] = index, vertices
                parts.append(part)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"{name}: the GLB data is damaged: {error!r}") from error
    return parts


def _colour(material: dict[str, Any]) -> str | None:
    # glTF has linear colours, programs show them in sRGB (IEC 61966-2-1)
    linear = material.get("pbrMetallicRoughness", {}).get("baseColorFactor")
    if linear is None:
        return None
    c = np.clip(np.array(linear[:3], np.float64), 0.0, 1.0)
    shown = np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1.0 / 2.4) - 0.055)
    return "#" + bytes(np.rint(255.0 * shown).astype(np.uint8)).hex().upper()


def _local(node: dict[str, Any]) -> Float64:
    """Transform of a node into its parent's frame, shape (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    result = np.eye(4)
    result[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    result[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    result[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return result


def _accessor(tree: dict[str, Any], blob: bytes, index: int) -> NDArray[Any]:
    """Numbers of an accessor, shape (count,), (count, 2) or (count, 3)."""
    accessor = tree["accessors"][index]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise ValueError(f"accessor {index} is sparse or compressed")
    view = tree["bufferViews"][accessor["bufferView"]]
    dtype = np.dtype(_COMPONENTS[accessor["componentType"]])
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
    offset = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", dtype.itemsize * width)
    count = int(accessor["count"])
    if offset + stride * (count - 1) + dtype.itemsize * width > len(blob):
        raise ValueError(f"accessor {index} reads past the end of the data")
    values = np.ndarray((count, width), dtype, blob, offset, (stride, dtype.itemsize))
    if accessor.get("normalized"):
        values = values / np.iinfo(dtype).max
    return values[:, 0] if width == 1 else values
