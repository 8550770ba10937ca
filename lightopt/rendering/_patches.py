"""The patches that optimisation works on: the part cut to the pixel's footprint, and what the camera sees of it."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64, Index, Int32, Int64, UInt8
from lightopt.core.parallel import ProcessPool, spread
from lightopt.core.threads import Task, available_processors, blocks, run_all
from lightopt.core.transforms import Posture
from lightopt.geometry import (
    Patches,
    RayCaster,
    TriangleMesh,
    estimate_patch_count,
    face_normals,
    longest_edges,
    refine,
)
from lightopt.rendering._pixels import mask_pixels
from lightopt.rendering._surface import GRAZING_COSINE, hidden_by
from lightopt.scene import (
    PartView,
    PinholeCamera,
    Scene,
    pixel_directions,
    pixel_footprint,
    project,
    screen_window,
    view_from_part,
)

DEFAULT_PATCH_BUDGET = 200_000  # patches visible in at least one posture, by default
_MOST_PATCHES = 1 << 24  # the geometry image holds patch numbers as float32, which counts no further

# image rows whose rays are cast at once, and points that are tested at once: they bound the memory
_BLOCK_ROWS, _BLOCK_POINTS = 32, 1 << 16

_TILE = 4  # pixels along a side of the tiles that points are tested in


@dataclass(frozen=True, kw_only=True)
class PatchTable:
    """A part's patches and from which postures the camera sees them; part frame."""

    patches: Patches
    postures: tuple[Posture, ...]  # the postures considered
    visible: Bool  # whether the camera sees a patch's centroid, from the front and in the image; shape (postures, p)
    # whether it sees it at more than :data:`lightopt.rendering.GRAZING_DEG` to its normal, shape (postures, p): such
    # patches count in no score and no share of that posture. Where edges are left out, also at edges
    grazing: Bool
    max_edge: float  # longest edge of a patch that the camera may see, unless the mesh was finer already [mm]
    footprint: float  # side of a pixel's footprint on the part, where it is smallest [mm]
    # faces of the mesh that the camera sees, where they use up the budget of patches; 0 otherwise, and of a table from
    # arrays
    seen_faces: int = 0
    # the budget of patches, where more are visible although the camera sees fewer faces: half of the budget is for
    # cutting; 0 otherwise, and of a table from arrays
    exceeded: int = 0

    def inspectable(self, posture: Posture) -> Index:
        """Indices of the patches that the camera sees in a posture, not at a grazing angle, ascending."""
        row = self.postures.index(posture)
        return np.flatnonzero(self.visible[row] & ~self.grazing[row])

    def left_out(self, posture: Posture) -> Index:
        """Indices of the patches that the camera sees in a posture at a grazing angle, ascending."""
        row = self.postures.index(posture)
        return np.flatnonzero(self.visible[row] & self.grazing[row])

    @property
    def inspectable_anywhere(self) -> Bool:
        """Whether a patch is inspectable in one posture or more, shape (p,)."""
        return np.any([seen & ~grazing for seen, grazing in zip(self.visible, self.grazing, strict=True)], axis=0)

    @property
    def message(self) -> str:
        """What the refinement reached, as a message."""
        seen = int(self.visible.any(axis=0).sum())
        reached = (
            "the pixel's footprint"
            if self.max_edge <= self.footprint
            else f"{self.max_edge / self.footprint:.3g} times the pixel's footprint of {self.footprint:.3g} mm"
        )
        text = f"{seen:,} visible patches of {len(self.patches):,}; edges up to {self.max_edge:.3g} mm ({reached})"
        if self.seen_faces:
            text += f"; {self.seen_faces:,} of the mesh's own triangles may show, however small the patch budget"
        if self.exceeded:
            text += (
                f"; more than the patch budget of {self.exceeded:,}: half of it is for cutting long triangles, and the "
                "mesh's other triangles leave less"
            )
        return text

    @property
    def grain(self) -> float:
        """How far a share of the inspectable area may be off, 0 to 1: see :func:`grain_of`."""
        return grain_of(self.patches.areas[self.inspectable_anywhere])

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """The table as named arrays for ``patches.npz``."""
        return {
            **{field.name: getattr(self.patches, field.name) for field in fields(Patches)},
            "visible": self.visible,
            "grazing": self.grazing,
            "postures_deg": np.array([[q.elevation_deg, q.rotation_deg] for q in self.postures]),
            "max_edge_mm": np.array(self.max_edge),
            "footprint_mm": np.array(self.footprint),
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, NDArray[Any]]) -> PatchTable:
        """The table that :meth:`arrays` described."""
        return PatchTable(
            patches=Patches(**{field.name: arrays[field.name] for field in fields(Patches)}),
            postures=tuple(Posture(float(e), float(r)) for e, r in arrays["postures_deg"]),
            visible=arrays["visible"],
            grazing=arrays["grazing"],
            max_edge=float(arrays["max_edge_mm"]),
            footprint=float(arrays["footprint_mm"]),
        )


@dataclass(frozen=True)
class PatchPixels:
    """Which pixels show each patch."""

    start: Int64  # the pixels of patch i are ``pixels[start[i]:start[i + 1]]``; shape (p + 1,)
    pixels: Int64  # raveled pixel indices, ascending within a patch

    def of(self, patch: int) -> Int64:
        """Raveled indices of the pixels whose centre shows a patch; empty for a patch smaller than a pixel."""
        return self.pixels[self.start[patch] : self.start[patch + 1]]


def build_patches(
    scene: Scene,
    *,
    caster: RayCaster,
    budget: int = DEFAULT_PATCH_BUDGET,
    edges: bool = True,
    threads: int | None = None,
    pool: ProcessPool | None = None,
) -> PatchTable:
    """Cut the faces that the camera sees towards the pixel's footprint, within a budget (paper, section 3.3).

    scene: With the postures to look from
    budget: About how many patches may be visible. A mesh that has more faces to begin with is not coarsened; half of
        the budget is for cutting long faces, however many others there are: where the camera sees more faces than the
        other half, the budget may be exceeded by up to a half, and the table says so.
    edges: Whether patches at silhouettes and creases, which an inspection leaves out, are as good as others; else they
        count as grazing.
    pool: Other processes that postures are spread over
    """
    mesh = scene.mesh
    views = [view_from_part(scene, posture) for posture in scene.postures]
    nearest = [(view.camera, project(view.camera, mesh.vertices)[2].min()) for view in views]
    footprint = min(pixel_footprint(camera, max(float(depth), 1e-3)) for camera, depth in nearest)
    threads = threads or available_processors()
    over_postures = partial(spread, pool=pool, threads=threads)
    if edges:
        seen, masks = _faces_of_pixels(mesh, views, caster, threads), [None] * len(views)
    else:
        seen, masks = _masks_of_pixels(scene, caster, threads, pool)
    # a face too narrow for any pixel's centre, such as a wall seen at a grazing angle, shows by its centroid
    facets = face_normals(mesh)
    rest = np.flatnonzero(~seen)
    by_centroid = np.zeros((len(views), len(mesh.faces)), np.bool_)

    def keep_narrow(number: int, sees: Bool) -> None:
        view, some = narrow[number]
        by_centroid[view, rest[some]] = sees

    narrow = [(k, slice(*some)) for k in range(len(views)) for some in blocks(len(rest), _BLOCK_POINTS)]
    a, b, c = (mesh.vertices[mesh.faces[rest, k]] for k in range(3))
    over_postures(_seen_points, narrow, keep_narrow, scene, caster, ((a + b + c) / 3.0, facets[rest]))
    no_pixel = ~seen
    seen |= by_centroid.any(axis=0)
    hidden, shown = int((~seen).sum()), int(seen.sum())
    # half of the budget for cutting where fine faces elsewhere take more: else a large flat face of two triangles would
    # be seen or not, lit or not, as the middles of these are
    edge, most = footprint, max(budget - shown, budget // 2)
    limit = hidden + shown + 16 * max(1, most) + 1  # beyond it the step below is the longest anyway
    while (cut := estimate_patch_count(mesh, edge, select=seen, limit=limit) - hidden - shown) > most:
        # what cutting adds goes with 1 / edge²
        edge *= max(1.02, min(4.0, math.sqrt(cut / max(1, most))))
    edge = min(edge, max(footprint, math.sqrt(longest_edges(mesh.vertices, mesh.faces, seen).max(initial=0.0))))
    patches = refine(mesh, max_edge_mm=edge, max_patches=_MOST_PATCHES, select=seen)
    # of a face that no pixel's centre shows, the centroid was tried above; it is that of the patch where there is one
    tried = no_pixel & (patches.roots < 0)
    shape, candidates = (len(views), len(patches)), np.flatnonzero(seen[patches.face])
    visible, grazing = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)

    face = patches.face[candidates]
    points = patches.centroids[candidates], facets[face], patches.normals[candidates], ~tried[face]

    def keep_visible(number: int, found: tuple[Bool, Bool]) -> None:
        view, some = shares[number]
        visible[view, candidates[some]], grazing[view, candidates[some]] = found

    shares = [(k, slice(*some)) for k in range(len(views)) for some in blocks(len(candidates), _BLOCK_POINTS)]
    items = [(k, some, by_centroid[k, face[some]], masks[k]) for k, some in shares]
    over_postures(_seen_patches, items, keep_visible, scene, caster, points)
    exceeds = shown < budget < int(visible.any(axis=0).sum()) and most > budget - shown
    return PatchTable(
        patches=patches,
        postures=scene.postures,
        visible=visible,
        grazing=grazing,
        max_edge=edge,
        footprint=footprint,
        seen_faces=shown if shown >= budget else 0,
        exceeded=budget if exceeds else 0,
    )


def _faces_of_pixels(mesh: TriangleMesh, views: Sequence[PartView], caster: RayCaster, threads: int) -> Bool:
    # which faces the centre of a pixel shows, in one of the views at least
    seen = np.zeros(len(mesh.faces), np.bool_)

    def cast(camera: PinholeCamera, rows: Float64, columns: Float64) -> None:
        column, row = np.meshgrid(columns, rows)
        directions = pixel_directions(camera, column.ravel(), row.ravel())
        face = caster.first_hit(camera.position, directions, neighbours=True)
        seen[face[face >= 0]] = True

    def tasks() -> Iterator[Task]:
        for view in views:
            left, top, right, bottom = screen_window(view.camera, mesh)
            for first, end in blocks(bottom - top, _BLOCK_ROWS):
                yield cast, (view.camera, np.arange(top + first, top + end) + 0.5, np.arange(left, right) + 0.5)

    run_all(tasks(), threads=threads)
    return seen


def _masks_of_pixels(
    scene: Scene, caster: RayCaster, threads: int, pool: ProcessPool | None
) -> tuple[Bool, list[bytes | None]]:
    # as _faces_of_pixels; and of each posture the pixels that an inspection does not leave out, see _masks_of_posture
    count, masks, lock = len(scene.postures), list[bytes | None]([None] * len(scene.postures)), Lock()

    faces = np.zeros(-(-len(scene.mesh.faces) // 8), np.uint8)

    def keep(number: int, found: tuple[UInt8, bytes]) -> None:
        with lock:
            np.bitwise_or(faces, found[0], out=faces)
        masks[number] = found[1]

    threads_of_posture = 1 if count >= threads or pool is not None else threads
    spread(_masks_of_posture, scene.postures, keep, scene, caster, threads_of_posture, pool=pool, threads=threads)
    return np.unpackbits(faces, count=len(scene.mesh.faces)).astype(np.bool_), masks


def _masks_of_posture(posture: Posture, scene: Scene, caster: RayCaster, threads: int) -> tuple[UInt8, bytes]:
    # the faces of pixels, and which pixels are clean, eight to an octet; these compressed, since those of thousands of
    # postures take hundreds of megabytes otherwise
    masks = mask_pixels(scene, posture, caster, threads=threads)
    return np.packbits(masks.faces), zlib.compress(np.packbits(masks.clean, axis=1).tobytes(), 1)


def _seen_points(item: tuple[int, slice], scene: Scene, caster: RayCaster, points: tuple[Float64, Float64]) -> Bool:
    # which of some points are seen in a posture
    view, some = item
    places, facets = points
    return visible_points(places[some], facets[some], view_from_part(scene, scene.postures[view]), caster)


def _seen_patches(
    item: tuple[int, slice, Bool, bytes | None],
    scene: Scene,
    caster: RayCaster,
    points: tuple[Float64, Float64, Float64, Bool],
) -> tuple[Bool, Bool]:
    # which of some patches are seen in a posture, and which of these at a grazing angle or an edge; those that are not
    # fresh were tried before
    number, some, sees, mask = item
    (places, facets, normals), fresh = (one[some] for one in points[:3]), points[3][some]
    view, sees = view_from_part(scene, scene.postures[number]), sees.copy()
    sees[fresh] = visible_points(places[fresh], facets[fresh], view, caster)
    grazing = _grazing(places, normals, sees, view)
    if mask is not None:
        octets = np.frombuffer(zlib.decompress(mask), np.uint8).reshape(view.camera.height, -1)
        grazing[sees] |= ~_at_points(octets, view.camera, places[sees])
    return sees, grazing


def _at_points(octets: UInt8, camera: PinholeCamera, points: Float64) -> Bool:
    # the flags of the pixels that points lie in
    columns, rows, _ = project(camera, points)
    x, y = (
        np.clip(np.floor(a).astype(np.intp), 0, side - 1)
        for a, side in ((columns, camera.width), (rows, camera.height))
    )
    return (octets[y, x // 8] << (x % 8).astype(np.uint8)) & 128 > 0


def patches_for_edge(table: PatchTable, mesh: TriangleMesh, edge: float) -> int:
    """The budget of patches with which no edge of what the camera sees is longer than so much [mm], about."""
    seen = np.zeros(len(mesh.faces), np.bool_)
    seen[table.patches.face[table.visible.any(axis=0)]] = True
    cuts = estimate_patch_count(mesh, edge, select=seen) - len(mesh.faces)
    return min(cuts + max(table.seen_faces, int(seen.sum())), 2 * cuts + 1)


def patch_pixels(patch: Int32, count: int) -> PatchPixels:
    """Turn a geometry image's patch channel round: from which patch a pixel shows to which pixels show a patch.

    patch: Patch index of each pixel, −1 where none, shape (height, width)
    count: Number of patches
    """
    flat = patch.ravel()
    pixels = np.flatnonzero(flat >= 0)
    order = np.argsort(flat[pixels], kind="stable")
    per_patch = np.bincount(flat[pixels], minlength=count)
    return PatchPixels(np.concatenate([[0], np.cumsum(per_patch)]), pixels[order])


def patch_positions(table: PatchTable, scene: Scene, posture: Posture) -> tuple[Float64, Float64]:
    """Image points (columns, rows) [px] of the patches' centroids in a posture, each of shape (p,).

    For patches smaller than a pixel, which :func:`patch_pixels` may not list; NaN behind the camera. Says nothing of
    visibility.
    """
    columns, rows, _ = project(view_from_part(scene, posture).camera, table.patches.centroids)
    return columns, rows


def marks_by_area(areas: Float64, count: int) -> Float64:
    """How many of `count` marks at equal distances along the running sum of the areas each patch has, shape (n,)."""
    each = areas.sum() / count
    return np.diff(np.floor(np.cumsum(areas) / each + 0.5), prepend=0.0)


def grain_of(areas: Float64) -> float:
    """How far a share of an area may be off since each patch counts as its middle does, 0 to 1.

    The standard deviation if the middle of each patch were a place by chance, and half of the places counted:
    √(Σ a²) / (2 Σ a). Patches that are wholly within or wholly without what is counted are not off at all.
    """
    return 0.5 * math.sqrt(float((areas**2).sum())) / max(float(areas.sum()), 1e-300)


def camera_visibility(
    points: Float64, normals: Float64, facets: Float64, view: PartView, caster: RayCaster
) -> tuple[Bool, Bool]:
    """Which points of the surface the camera sees, and which of these at a grazing angle.

    normals: Of the surface at the points, shape (p, 3); the other parameters are those of :func:`visible_points`
    Returns visible, grazing: As :func:`visible_points`; and of these, those seen at more than
        :data:`lightopt.rendering.GRAZING_DEG` to the normal, shape (p,)
    """
    visible = visible_points(points, facets, view, caster)
    return visible, _grazing(points, normals, visible, view)


def _grazing(points: Float64, normals: Float64, visible: Bool, view: PartView) -> Bool:
    # which of the visible points are seen at a grazing angle
    grazing = np.zeros_like(visible)
    toward = view.camera.position - points[visible]
    cosines = np.einsum("ij,ij->i", normals[visible], toward) / np.linalg.norm(toward, axis=1)
    grazing[visible] = cosines < GRAZING_COSINE
    return grazing


def visible_points(points: Float64, facets: Float64, view: PartView, caster: RayCaster) -> Bool:
    """Whether the camera sees points of the surface: in the image, from the front, with nothing in between.

    points, facets: Points [mm] and normals of the facets that they lie on, part frame, shape (p, 3)
    view, caster: The camera as the part sees it, and the part's ray caster
    """
    camera = view.camera
    columns, rows, depth = project(camera, points)
    visible = (depth > 0.0) & (np.einsum("ij,ij->i", facets, camera.position - points) > 0.0)
    visible[visible] &= (
        (columns[visible] >= 0.0)
        & (columns[visible] < camera.width)
        & (rows[visible] >= 0.0)
        & (rows[visible] < camera.height)
    )
    if camera.obstructions is not None:
        visible[visible] = ~hidden_by(camera.obstructions, camera.position, points[visible])
    # tile by tile, so that rays that go nearly the same way follow each other
    order = np.flatnonzero(visible)
    tile = (rows[order].astype(np.int32) // _TILE) * camera.width + columns[order].astype(np.int32) // _TILE
    order = order[np.argsort(tile, kind="stable")]
    cast = np.ones((1, len(order)), np.bool_)
    visible[order] = caster.visible(points[order], facets[order], camera.position[None, :], candidates=cast)[0]
    return visible
