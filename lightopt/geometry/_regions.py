"""Regions of a part's surface: which faces of a mesh belong to one, cut where its border crosses them.

Everything is in the frame of the part's file [mm].
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index, Int32
from lightopt.core.errors import InputError
from lightopt.geometry._load_mesh import LoadedMesh
from lightopt.geometry._texture import TextureBrushing
from lightopt.geometry._topology import merge_rows
from lightopt.geometry._triangle_mesh import SurfaceFinder, TriangleMesh, face_normals

Result = TypeVar("Result")

FARTHEST_MM = 0.5  # A point that names a face is no farther from it than this [mm]
_SAME_COLOUR = 4  # of 255: colours differ by less when programs round them
_SAME_NORMAL = 1e-5  # components of the normals of flat facets that are one plane
_ON_PLANE = 1e-9  # of the part's size: a vertex nearer to a plane lies on it

# faces that a face with so many cut sides becomes: corners 0 to 2, and points 3 to 5 on the sides that begin there
_CUT_FACES = {
    1: ((0, 3, 2), (3, 1, 2)),
    2: ((3, 1, 4), (0, 3, 4), (0, 4, 2)),
    3: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
}


@dataclass(frozen=True)
class NamedRegion:
    """Faces of a group, object, solid or material of the file."""

    name: str

    def faces(self, loaded: LoadedMesh) -> Bool:
        own = [self.name in piece.names for piece in loaded.pieces]
        if not any(own):
            names = sorted({name for piece in loaded.pieces for name in piece.names})
            text = f'no group "{self.name}" in the mesh file; it has {_listed(names, "no named groups")}'
            raise InputError("; ".join((text, *loaded.unnamed)))
        return np.array(own, np.bool_)[loaded.piece]


@dataclass(frozen=True)
class ColouredRegion:
    colour: str

    def faces(self, loaded: LoadedMesh) -> Bool:
        wanted = _channels(self.colour)
        own = [
            piece.colour is not None and int(np.abs(_channels(piece.colour) - wanted).max()) <= _SAME_COLOUR
            for piece in loaded.pieces
        ]
        if not any(own):
            colours = sorted({piece.colour for piece in loaded.pieces if piece.colour is not None})
            raise InputError(f"no faces of colour {self.colour} in the mesh file; it has {_listed(colours, 'none')}")
        return np.array(own, np.bool_)[loaded.piece]


@dataclass(frozen=True)
class RegionAtPoints:
    """CAD faces at some points; of meshes, the surface around each up to its creases."""

    points: tuple[tuple[float, float, float], ...]  # [mm], each on its face
    cad: bool  # whether the pieces of the file are CAD faces

    def faces(self, loaded: LoadedMesh) -> Bool:
        mesh = loaded.mesh
        label = loaded.piece if self.cad and loaded.piece is not None else _smooth_surfaces(mesh)
        finder = SurfaceFinder(mesh)
        found = np.zeros(len(mesh.faces), np.bool_)
        for point in self.points:
            place = finder.nearest(np.array(point, np.float64))
            off = float(np.linalg.norm(place.point - point))
            if off > FARTHEST_MM:
                nearest = ", ".join(f"{x:.4g}" for x in place.point)
                raise InputError(
                    f"the point {list(point)} is {off:.3g} mm from the surface, at most {FARTHEST_MM:g} mm are "
                    f"accepted; the nearest place of the surface is [{nearest}], in the mesh file's coordinates in mm"
                )
            found |= label == label[place.face]
        return found


@dataclass(frozen=True)
class BoxRegion:
    low: tuple[float, float, float]  # corner of the least coordinates [mm]
    high: tuple[float, float, float]  # corner of the greatest coordinates [mm]

    def cut(self, loaded: LoadedMesh, *, most: int) -> LoadedMesh:
        """With edges along the sides of the box, where these cut faces; `most` faces are not exceeded."""
        for axis in range(3):
            for at in (self.low[axis], self.high[axis]):
                loaded = _cut_at_plane(loaded, axis, at)
        if len(loaded.mesh.faces) > most:
            raise InputError(f"the box cuts the mesh into more than {most:,} triangles")
        return loaded

    def faces(self, loaded: LoadedMesh) -> Bool:
        middles = loaded.mesh.vertices[loaded.mesh.faces].mean(axis=1)
        return ((middles >= self.low) & (middles <= self.high)).all(axis=1)


@dataclass(frozen=True, eq=False)
class MaskRegion:
    """The surface that a mask marks, which is projected onto the part along an axis.

    Columns go along the first of the other two axes, rows from the last one along the second.
    """

    mask: Bool  # shape (height, width)
    axis: int  # of projection: 0, 1 or 2 for X, Y or Z
    positive: bool  # whether it falls on what faces the axis's positive end, or on what faces the negative one
    # coordinates of the first column's and the last row's outer sides along the other two axes [mm]
    corner: tuple[float, float]
    pixel: float  # side of the mask's pixels [mm]
    depth: tuple[float, float] = (-math.inf, math.inf)  # least and greatest coordinate along the axis [mm]

    def cut(self, loaded: LoadedMesh, *, most: int) -> LoadedMesh:
        """With faces no larger than the mask's pixels along its border; `most` faces are not exceeded."""
        height, width = self.mask.shape
        # of all pixels before a column and a row
        marked = np.zeros((height + 1, width + 1), np.int64)
        marked[1:, 1:] = self.mask[::-1].cumsum(axis=0).cumsum(axis=1)
        while True:
            mesh = loaded.mesh
            corners = mesh.vertices[mesh.faces]
            column, row = self._pixels(corners)
            first, end = (np.stack([f(column, axis=1), f(row, axis=1)]) for f in (np.min, np.max))
            end += 1
            whole = np.prod(end - first, axis=0)
            left, bottom = np.clip(first, 0, [[width], [height]])
            right, top = np.clip(end, 0, [[width], [height]])
            count = marked[top, right] - marked[bottom, right] - marked[top, left] + marked[bottom, left]
            sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
            at_border = self._facing(mesh) & (count > 0) & (count < whole)
            wanted = at_border[:, None] & (sides > self.pixel)
            if not wanted.any():
                return loaded
            if len(mesh.faces) + 2 * np.count_nonzero(wanted) > most:
                raise InputError(
                    f"the mask's border cuts the mesh into more than {most:,} triangles; use a mask of larger pixels"
                )
            loaded = _cut_sides(loaded, wanted, lambda ends: np.full(len(ends), 0.5))

    def faces(self, loaded: LoadedMesh) -> Bool:
        mesh = loaded.mesh
        middles = mesh.vertices[mesh.faces].mean(axis=1)
        column, row = self._pixels(middles)
        height, width = self.mask.shape
        found = self._facing(mesh) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        found &= (middles[:, self.axis] >= self.depth[0]) & (middles[:, self.axis] <= self.depth[1])
        found[found] = self.mask[::-1][row[found], column[found]]
        return found

    def _facing(self, mesh: TriangleMesh) -> Bool:
        along = face_normals(mesh)[:, self.axis]
        return along > 0.0 if self.positive else along < 0.0

    def _pixels(self, points: Float64) -> tuple[Index, Index]:
        # column and row from below
        across, up = (axis for axis in range(3) if axis != self.axis)
        column = np.floor((points[..., across] - self.corner[0]) / self.pixel).astype(np.intp)
        row = np.floor((points[..., up] - self.corner[1]) / self.pixel).astype(np.intp)
        return column, row


Region = NamedRegion | ColouredRegion | RegionAtPoints | BoxRegion | MaskRegion


def mesh_with_regions(
    loaded: LoadedMesh, regions: Sequence[Region], *, most: int, place: Callable[[int], str]
) -> TriangleMesh:
    """The mesh with each face's material: 1 for the first region, and so on; 0 outside of all.

    What several regions have belongs to the first of them. Faces are cut along the borders of boxes and masks; so
    light at a place does not depend on the border, but for that of interpolated normals of cut faces.

    most: Number of faces that is not exceeded
    place: Beginning of a message about a region, by its index
    Raises InputError: Of all regions without surface, or without any that is not in another one before; see the kinds
        of region
    """
    problems: list[str] = []

    def tried(number: int, step: Callable[[], Result]) -> Result | None:
        try:
            return step()
        except InputError as error:
            problems.extend(f"{place(number)}: {text}" for text in error.args)
            return None

    for number, region in enumerate(regions):
        if isinstance(region, BoxRegion | MaskRegion):
            loaded = tried(number, partial(region.cut, loaded, most=most)) or loaded
    material = np.zeros(len(loaded.mesh.faces), np.uint8)
    for number, region in enumerate(regions):
        own = tried(number, partial(region.faces, loaded))
        if own is None:
            continue
        free = own & (material == 0)
        if not own.any():
            problems.append(f"{place(number)}: no surface of the part is in this region")
        elif not free.any():
            problems.append(f"{place(number)}: all of its surface is in regions before it; place it before them")
        material[free] = number + 1
    if problems:
        raise InputError(*dict.fromkeys(problems))
    return replace(loaded.mesh, material=material)


def _smooth_surfaces(mesh: TriangleMesh) -> Int32:
    # number of the surface of each face; faces that share a vertex share its normal
    count = len(mesh.faces)
    rows = np.repeat(np.arange(count), 3)
    corners = mesh.faces.ravel()
    if mesh.normals is None:
        flat = np.rint(np.repeat(face_normals(mesh), 3, axis=0) / _SAME_NORMAL) + 0.0
        corners = merge_rows(np.concatenate([mesh.vertices[corners], flat], axis=1))[1]
    size = count + int(corners.max()) + 1
    from scipy.sparse import coo_array  # takes long to load, and most commands do not need it
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(3 * count, np.bool_), (rows, count + corners)), shape=(size, size))
    return connected_components(links, directed=False)[1][:count].astype(np.int32)


def _cut_at_plane(loaded: LoadedMesh, axis: int, at: float) -> LoadedMesh:
    mesh = loaded.mesh
    off = mesh.vertices[:, axis] - at
    off[np.abs(off) <= _ON_PLANE * float(np.ptp(mesh.vertices, axis=0).max())] = 0.0
    side = np.sign(off)[mesh.faces]
    wanted = side * np.roll(side, -1, axis=1) < 0.0
    if not wanted.any():
        return loaded
    return _cut_sides(loaded, wanted, lambda ends: (at - ends[:, 0, axis]) / (ends[:, 1, axis] - ends[:, 0, axis]))


def _cut_sides(loaded: LoadedMesh, wanted: Bool, share: Callable[[Float64], Float64]) -> LoadedMesh:
    # cut some sides of faces, shape (m, 3), each side from its corner to the next, and those of faces beside them;
    # `share`: at which share of the way from the first of two ends, shape (e, 2, 3), to the second
    mesh, count = loaded.mesh, len(loaded.mesh.vertices)
    # faces on both sides of a crease have vertices of their own in the same places
    place = merge_rows(mesh.vertices)[1].astype(np.int64)
    ends = np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    turned = place[ends[:, 0]] > place[ends[:, 1]]
    ends[turned] = ends[turned][:, ::-1]
    lines = place[ends] @ [count, 1]
    cut = np.isin(lines, lines[wanted.ravel()])
    own, which = np.unique(ends[cut] @ [count, 1], return_inverse=True)
    own_ends = np.stack(np.divmod(own, count), axis=1)
    point = np.full(len(lines), -1, np.int64)
    point[cut] = count + which.ravel()
    s = share(mesh.vertices[own_ends])[:, None]
    a, b = mesh.vertices[own_ends[:, 0]], mesh.vertices[own_ends[:, 1]]
    vertices = np.concatenate([mesh.vertices, a + s * (b - a)])
    normals = None
    if mesh.normals is not None:
        mixed = (1.0 - s) * mesh.normals[own_ends[:, 0]] + s * mesh.normals[own_ends[:, 1]]
        normals = np.concatenate([mesh.normals, mixed / np.linalg.norm(mixed, axis=1, keepdims=True)])
    cut, numbers = cut.reshape(-1, 3), np.concatenate([mesh.faces, point.reshape(-1, 3)], axis=1)
    cuts = cut.sum(axis=1)
    faces, source = [mesh.faces[cuts == 0]], [np.flatnonzero(cuts == 0)]
    for k, pattern in _CUT_FACES.items():
        some = np.flatnonzero(cuts == k)
        # turned so that the first sides are the cut ones
        before = np.roll(cut[some], 1, axis=1)
        first = np.argmax(cut[some] & ~before, axis=1) if k < 3 else np.zeros(len(some), np.intp)
        turn = (first[:, None] + np.arange(3)) % 3
        six = np.take_along_axis(numbers[some], np.concatenate([turn, turn + 3], axis=1), axis=1)
        faces += [six[:, corners] for corners in pattern]
        source += [some] * len(pattern)
    order = np.argsort(np.concatenate(source), kind="stable")
    all_faces = np.concatenate(faces)[order].astype(np.int32)
    of = np.concatenate(source)[order]
    piece = None if loaded.piece is None else loaded.piece[of]
    brushing = tuple(
        replace(own, source=own.source[of]) if isinstance(own, TextureBrushing) else own for own in mesh.brushing
    )
    return replace(
        loaded, mesh=TriangleMesh(vertices, all_faces, normals, brushing=brushing), piece=piece, texture=None
    )


def _channels(colour: str) -> Index:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], np.intp)


def _listed(names: Sequence[str], none: str) -> str:
    return ", ".join(names[:12]) + (", …" if len(names) > 12 else "") if names else none
