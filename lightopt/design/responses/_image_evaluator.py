"""What images show: levels of the patches, and which defects, under candidate positions of the lights.

Rays go from the centroid of every inspectable patch, one that the camera sees and not at a grazing angle
(:data:`lightopt.rendering.GRAZING_DEG`), to the point lights of every candidate panel. The panel's light is computed as
for images, then exposed without noise (paper, section 5.2, step 1): a level here is what the camera would deliver for
the patch. With ``points: auto`` each patch's own five rays decide on shadows, since patches have no neighbours in a
grid. Where images are tested for defects, the same rays decide how much evidence each image gives of them; what lies
at edges then counts as little as what is seen at a grazing angle, since an inspection leaves it out.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from threading import Lock
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float32, Float64, Index, UInt8
from lightopt.core.errors import counted
from lightopt.core.parallel import ProcessPool, spread
from lightopt.core.run_context import Share, WorkCounter
from lightopt.core.threads import Task, available_processors, run_all, threads_each
from lightopt.core.transforms import Posture
from lightopt.design.responses import _pairs
from lightopt.design.responses._evidence import UNITS_OF_IMAGE, DetectionModel, PatchEvidence, units_needed
from lightopt.design.responses._luminance_matrix import Levels, LuminanceMatrix, Visibility, area_units
from lightopt.geometry import RayCaster, face_normals
from lightopt.lights import PanelLight, SurfaceLight
from lightopt.optics import expose
from lightopt.rendering import BouncedPatches, PatchTable, SurfacePoints, marks_by_area, shade_isolated, shadow_targets
from lightopt.scene import Scene, surface_share, view_from_part

BLOCK_PATCHES = 1 << 12  # patches whose levels, under all hypotheses, are in the processor's caches together
AT_ONCE = 8  # channels of a light that are worked out together: bounds their levels in memory
BLOCKS_AT_ONCE = 8  # that a thread works on before it takes others

# of the levels that are held at a time: with a part of some hundred thousand triangles, its patches and the search the
# process then stays below 2 GB
MOST_BYTES = 1_000_000_000

DRAWN_PATCHES = 20_000
"""Patches that represent all where much is tried: the first iterations of the search, and tolerances."""


T = TypeVar("T")

# a posture of a patch table: which patches are visible, and which at a grazing angle, eight to an octet
PatchRow = tuple[Posture, UInt8, UInt8]

_Passed = Float64 | float  # share of the light that the lens lets pass
_Block = tuple[slice, SurfacePoints, _Passed]  # patches that are worked on together


def _image_key(posture: Posture, exposures: Sequence[float], panel: PanelLight) -> Any:
    # the same wherever a light of these properties stands at this place, whichever object that is
    return posture, tuple(exposures), *map(_hashable, vars(panel).values())


def _hashable(value: Any) -> Any:
    if isinstance(value, tuple):  # a pattern has arrays, too
        return tuple(map(_hashable, cast("tuple[Any, ...]", value)))
    return value.tobytes() if isinstance(value, np.ndarray) else value


def _channels_of_places(lights: Sequence[PanelLight], some: Sequence[int]) -> list[list[int]]:
    # numbers of the lights that are worked out together: channels of a light in one place
    found: dict[Any, list[int]] = {}
    for at in some:
        light = lights[at]
        key: Any = at
        if isinstance(light, SurfaceLight):
            key = light.entry, *(vector.tobytes() for vector in (light.centre, light.across, light.along))
        found.setdefault(key, []).append(at)
    return [own[i : i + AT_ONCE] for own in found.values() for i in range(0, len(own), AT_ONCE)]


class ImageCache:
    """Arrays of images of single lights, by posture, exposures and place of the light, as long as there is room.

    Safe to use from several threads at once.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes, self._bytes = most_bytes, 0
        self._lock = Lock()
        self._images: dict[Any, tuple[NDArray[Any], ...]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return ImageCache, (self._most_bytes,)  # another process fills one of its own

    def clear(self) -> None:
        self._bytes = 0
        self._images.clear()

    def find(self, posture: Posture, exposures: Sequence[float], panel: PanelLight) -> tuple[NDArray[Any], ...] | None:
        return self._images.get(_image_key(posture, exposures, panel))

    def keep(self, posture: Posture, exposures: Sequence[float], panel: PanelLight, *arrays: NDArray[Any]) -> None:
        """Hold copies of arrays, if there is room left."""
        size = sum(array.nbytes for array in arrays)
        with self._lock:
            if self._bytes + size <= self._most_bytes:
                self._bytes += size
                self._images[_image_key(posture, exposures, panel)] = tuple(array.copy() for array in arrays)


@dataclass(frozen=True, eq=False)
class ImageEvaluator:
    """A part, its patches, and the defects that its images are tested for."""

    scene: Scene  # its lights are ignored
    table: PatchTable  # the patches; their pairs with the planned defects are counted
    caster: RayCaster
    detection: DetectionModel | None  # the defects, and when one counts as found; None where levels alone are wanted
    shadows: bool = True  # whether the part casts shadows on itself
    threads: int | None = None
    exposures: tuple[float, ...] = (1.0,)  # that an image may be taken with: it shows what it shows with any of them
    images: ImageCache | None = None  # levels and flags of images of these very patches: looked up first
    keeps_images: bool = False  # whether new ones are kept there
    pool: ProcessPool | None = None  # other processes, over which postures and positions are spread
    inspectable: Index | None = None  # the patches that count, where the table has only some of the postures

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # without what is found once

    @cached_property
    def patches(self) -> Index:
        """Indices of the patches that are inspectable in one posture or more, ascending, shape (p,)."""
        return np.flatnonzero(self.table.inspectable_anywhere) if self.inspectable is None else self.inspectable

    @cached_property
    def weights(self) -> _pairs.PairWeights:
        """Weights of the pairs of these patches and the planned defects."""
        assert self.detection is not None
        units = area_units(self.table.patches.areas[self.patches])
        masks, factors = _pairs.weight_planes(self.detection.catalogue.defects)
        return _pairs.PairWeights(areas=units, masks=masks, factors=factors)

    def table_of(self, postures: Sequence[Posture]) -> PatchTable:
        rows = [self.table.postures.index(posture) for posture in postures]
        visible, grazing = self.table.visible[rows], self.table.grazing[rows]
        return replace(self.table, postures=tuple(postures), visible=visible, grazing=grazing)

    def row(self, posture: Posture) -> PatchRow:
        """What the table has of a posture alone, as small as a task should be."""
        row = self.table.postures.index(posture)
        return posture, np.packbits(self.table.visible[row]), np.packbits(self.table.grazing[row])

    def of_rows(self, rows: Sequence[PatchRow]) -> "ImageEvaluator":
        """The evaluator with these postures, the same patches counting, from one of no posture."""
        count = len(self.table.patches)
        seen, left_out = (
            np.array([np.unpackbits(one, count=count) for one in some], np.bool_).reshape(-1, count)
            for some in ([visible for _, visible, _ in rows], [grazing for _, _, grazing in rows])
        )
        postures = tuple(row[0] for row in rows)
        return replace(self, table=replace(self.table, postures=postures, visible=seen, grazing=left_out))

    def spread(
        self,
        function: Callable[..., T],
        items: Sequence[Any],
        keep: Callable[[int, T], None],
        *shared: Any,
        threads: int | None,
        progress: Share | None = None,
    ) -> None:
        """Call ``function(item, evaluator, *shared)`` for each item, and `keep` with its place and the result.

        The evaluator is one of no posture, with one thread where other processes compute.
        """
        own = replace(self, table=self.table_of(()), inspectable=self.patches)
        if self.pool is None:
            spread(function, items, keep, own, *shared, pool=None, threads=threads, report=progress)
            return
        # most of an evaluator is the same on all patches and on drawn ones: other processes need it once
        absent: Any = None
        own = replace(own, scene=absent, caster=absent, detection=None, threads=1, pool=None)
        parts = function, own, self.scene, self.caster, self.detection
        spread(_with_evaluator, items, keep, *parts, *shared, pool=self.pool, report=progress)

    def matrices(
        self,
        posture: Posture,
        panels: Sequence[Sequence[PanelLight]],
        *,
        exposures: Sequence[float] = (1.0,),
        most_bytes: int = MOST_BYTES,
        progress: Share | None = None,
    ) -> tuple[LuminanceMatrix, ...]:
        """Delivered levels of the inspectable patches under every candidate panel of every light, per exposure.

        Where images are tested for defects, with those that they show. The rays are cast once.

        panels: Per light, the panels at its candidate positions; world frame.
        most_bytes: Limit for the levels and the defects' bits.
        Raises InputError: More positions than memory is meant for.
        """
        detection, seen = self.detection, self.table.inspectable(posture)
        positions = sum(len(some) for some in panels)
        what = f"luminance matrix of a posture: {counted(positions, 'position')} × {len(seen):,} patches"
        size = positions * self._position_bytes(len(seen), len(exposures))
        _pairs.refuse_memory(what, size, most_bytes, "raise option 'step_deg'")
        shape, dtype = (len(exposures), positions), np.uint8 if self.scene.sensor.bit_depth <= 8 else np.uint16
        levels = np.zeros((*shape, len(seen)), dtype)
        words = np.zeros((*shape, UNITS_OF_IMAGE, len(seen), self._words), np.uint64)
        flat = [panel for some in panels for panel in some]
        missing: list[int] = []
        for at, panel in enumerate(flat):
            image = None if self.images is None else self.images.find(posture, exposures, panel)
            if image is None:
                missing.append(at)
            else:
                levels[:, at], words[:, at] = image[0], _pairs.widen_octets(image[1], self._words)
        if missing:
            self._compute(posture, flat, missing, exposures, (levels, words), progress)
        if self.images is not None and self.keeps_images:
            for at in missing:
                self.images.keep(posture, exposures, flat[at], levels[:, at], _pairs.narrow_words(words[:, at]))
        areas, grazing = self.table.patches.areas[seen], self.table.left_out(posture)
        ends = np.cumsum([len(some) for some in panels])[:-1]
        grazing_mm2 = float(self.table.patches.areas[grazing].sum())

        def matrix(index: int) -> LuminanceMatrix:
            shown = None
            if detection is not None:
                flags, left_out = tuple(np.split(words[index], ends)), grazing.astype(np.int32)
                shown = Visibility(detection.catalogue.defects, flags, seen.astype(np.int32), left_out)
            own = tuple(np.split(levels[index], ends))
            return LuminanceMatrix(levels=own, areas=areas, visibility=shown, grazing_mm2=grazing_mm2)

        return tuple(map(matrix, range(len(exposures))))

    def _compute(
        self,
        posture: Posture,
        panels: Sequence[PanelLight],
        missing: Sequence[int],
        exposures: Sequence[float],
        images: tuple[Levels, _pairs.Words],
        progress: Share | None,
    ) -> None:
        """Levels and flags of the `missing` of some panels, written to their rows of `images`."""
        scene, caster, (levels, words) = self.scene, self.caster, images
        view, (surface, seen) = view_from_part(scene, posture), patch_points(scene, self.table, posture)
        surface = replace(surface, outside=caster.is_outside(view.camera.position))
        bounced = evidence = None
        if scene.bounces or scene.is_surrounded:
            areas = self.table.patches.areas[seen]
            bounced = BouncedPatches(scene, view, surface, areas, caster, shadows=self.shadows)
        if self.detection is not None:
            evidence = PatchEvidence(scene, self.table, surface, posture, self.detection)
        blocks: list[_Block] = []
        for start in range(0, len(surface), BLOCK_PATCHES):
            block = surface.take(slice(start, start + BLOCK_PATCHES))
            share = surface_share(view.camera, block.points)
            blocks.append((slice(start, start + len(block)), block, 1.0 if share is None else share))
        # the candidates as the part sees them
        moved = view_from_part(replace(scene, lights=tuple(panels)), posture).lights

        # evidence at a patch depends on its neighbours, and light on what the part mirrors: all are done together
        groups = [blocks[first : first + BLOCKS_AT_ONCE] for first in range(0, len(blocks), BLOCKS_AT_ONCE)]
        groups = groups if evidence is None and bounced is None else [blocks]
        work = WorkCounter(len(missing) * len(groups), progress)

        shade = partial(shade_isolated, reflectances=scene.reflectances, caster=caster, shadows=self.shadows)

        def evaluate(some: Sequence[int], own: Sequence[_Block]) -> None:
            # of each light by itself, so that no result depends on the others
            lights = [moved[at] for at in some]
            added = None if bounced is None else [bounced.levels(light, threads_of_task) for light in lights]
            if evidence is not None:
                blocker = caster if self.shadows else None
                found = evidence.evaluate(lights, caster, blocker, exposures, added=added, threads=threads_of_task)
                for at, (level, units) in zip(some, found, strict=True):
                    store(at, slice(None), level)
                    words[:, at] = units
            else:
                for (i, at), (here, block, passed) in itertools.product(enumerate(some), own):
                    level = shade(block, (moved[at],))[0]
                    if added is not None:
                        level += added[i][0, here]
                    # images are stored as float32, and a level is rounded from what is stored
                    store(at, here, (passed * level).astype(np.float32))
            work.add(len(some))

        def store(at: int, here: slice, level: Float32) -> None:
            for index, exposure in enumerate(exposures):
                levels[index, at, here] = expose(
                    level[None, :], sensor=scene.sensor, exposure=exposure, full_scale=scene.reflectance.full_scale
                )[0]

        together_groups = _channels_of_places(panels, missing)
        threads_of_task = threads_each(len(together_groups), self.threads)

        def tasks() -> Iterator[Task]:
            for together in together_groups:
                if self.shadows:
                    targets = np.concatenate([shadow_targets(moved[at]) for at in together])
                    caster.map_blockers(targets, rays=len(surface), threads=1)
                for group in groups:
                    yield evaluate, (together, group)

        run_all(tasks(), threads=self.threads or available_processors(), done=work.report)

    @property
    def _words(self) -> int:
        return 0 if self.detection is None else -(-len(self.detection.catalogue.defects) // 64)

    def _position_bytes(self, patches: int, exposures: int) -> int:
        # memory of `matrices` for one position of a light: levels, and the defects' bits
        return patches * exposures * ((1 if self.scene.sensor.bit_depth <= 8 else 2) + 8 * UNITS_OF_IMAGE * self._words)

    def positions_at_once(self, posture: Posture, exposures: Sequence[float]) -> int:
        seen = len(self.table.inspectable(posture))
        return max(1, MOST_BYTES // max(1, self._position_bytes(seen, len(exposures))))

    def in_batches(
        self, posture: Posture, places: Sequence[PanelLight], *, exposures: Sequence[float] = (1.0,)
    ) -> Iterator[tuple[LuminanceMatrix, ...]]:
        """As :meth:`matrices` of one light, for as many of its positions at a time as memory allows."""
        # what was given out before is held while the next is made
        most = max(1, self.positions_at_once(posture, exposures) // 2)
        if len(places) <= 2 * most:
            most = len(places)
        for start in range(0, len(places), most):
            yield self.matrices(posture, [places[start : start + most]], exposures=exposures)

    def flags(self, posture: Posture, panels: Sequence[Sequence[PanelLight]]) -> tuple[_pairs.Words, ...]:
        """Evidence of the pairs by the images: of each light an array of shape (positions, units, p, words)."""
        found = [np.zeros((len(some), UNITS_OF_IMAGE, len(self.patches), self._words), np.uint64) for some in panels]
        if sum(map(len, panels)) <= self.positions_at_once(posture, self.exposures):
            matrices = self.matrices(posture, panels, exposures=self.exposures)
            lights = [[(matrices, light)] for light in range(len(panels))]
        else:
            every = (self.in_batches(posture, some, exposures=self.exposures) for some in panels)
            lights = [((matrices, 0) for matrices in batches) for batches in every]
        for images, batches in zip(found, lights, strict=True):
            places = ((some, light, at) for some, light in batches for at in range(len(some[0].levels[light])))
            for image, (some, light, at) in zip(images, places, strict=True):
                image[:] = scattered_flags(some, self.patches, light=light, place=at)
        return tuple(found)

    @property
    def needed(self) -> int:
        assert self.detection is not None
        return units_needed(self.detection.min_images)

    def counts(self, posture: Posture, panels: Sequence[PanelLight]) -> _pairs.Counts:
        """Units of evidence of each pair by the images of a posture, one of each light, up to what is needed."""
        images = self.flags(posture, [[panel] for panel in panels])
        return self.weights.sum_counts((layer[0] for layer in images), self.needed)

    def counts_of_postures(self, panels: Sequence[PanelLight], progress: Share | None = None) -> _pairs.PackedCounts:
        """The same of every posture of the table."""
        packed: dict[int, _pairs.Packed] = {}
        shape = self.weights.zero_counts(self.needed).shape
        rows = [self.row(posture) for posture in self.table.postures]
        # posture by posture in each thread: none waits for another at the end of a posture
        single = replace(self, threads=1)
        single.spread(_counts_of_row, rows, packed.__setitem__, tuple(panels), threads=self.threads, progress=progress)
        return _pairs.PackedCounts([packed[place] for place in range(len(rows))], shape)


def _counts_of_row(row: PatchRow, evaluator: ImageEvaluator, panels: Sequence[PanelLight]) -> _pairs.Packed:
    return _pairs.pack_counts(evaluator.of_rows([row]).counts(row[0], panels))


def _with_evaluator(
    item: Any,
    function: Callable[..., T],
    evaluator: ImageEvaluator,
    scene: Scene,
    caster: RayCaster,
    detection: DetectionModel | None,
    *shared: Any,
) -> T:
    return function(item, replace(evaluator, scene=scene, caster=caster, detection=detection), *shared)


def luminance_matrix(
    scene: Scene,
    table: PatchTable,
    posture: Posture,
    panels: Sequence[Sequence[PanelLight]],
    *,
    caster: RayCaster,
    detection: DetectionModel | None = None,
    shadows: bool = True,
    threads: int | None = None,
    progress: Share | None = None,
) -> LuminanceMatrix:
    """Delivered levels of the inspectable patches at exposure 1: see :meth:`ImageEvaluator.matrices`."""
    evaluator = ImageEvaluator(scene, table, caster, detection, shadows=shadows, threads=threads)
    return evaluator.matrices(posture, panels, progress=progress)[0]


def patch_points(scene: Scene, table: PatchTable, posture: Posture) -> tuple[SurfacePoints, Index]:
    """The inspectable patches of a posture as surface points in the part's frame, and their indices."""
    patches = table.patches
    seen = table.inspectable(posture)
    views = view_from_part(scene, posture).camera.position - patches.centroids[seen]
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    facets, front = face_normals(scene.mesh)[patches.face[seen]], np.ones(len(seen), np.bool_)
    material = None if scene.mesh.material is None else scene.mesh.material[patches.face[seen]]
    points, normals = patches.centroids[seen], patches.normals[seen]
    across = scene.mesh.across_brushing(points, normals, patches.face[seen])
    return SurfacePoints(points, normals, facets, views, front, material=material, across=across), seen


def scattered_flags(matrices: Sequence[LuminanceMatrix], patches: Index, *, light: int, place: int) -> _pairs.Words:
    """An image's units of evidence in another numbering of the patches, shape (units, p, words).

    `matrices` have the visibility of some of the patches, one for each exposure of the image: the best of them counts
    for each pair. `patches` are the ascending indices of the patches that count, shape (p,).
    """
    first = matrices[0].visibility
    assert first is not None
    units, _, width = first.words[light].shape[1:]
    flags = np.zeros((units, len(patches), width), np.uint64)
    rows = np.searchsorted(patches, first.patch)
    for matrix in matrices:
        assert matrix.visibility is not None
        flags[:, rows] |= matrix.visibility.words[light][place]
    return flags


def drawn_patches(table: PatchTable, count: int) -> PatchTable:
    """A sample of the patches, every part of the surface by its area; the others become invisible.

    Along the running sum of the inspectable patches' areas, `count` marks stand at equal distances; a patch with marks
    represents their share of the area. The order of patches is that of the mesh, so that marks spread over the surface.
    With `count` inspectable patches or fewer, all stay as they are.
    """
    seen = np.flatnonzero(table.inspectable_anywhere)
    if len(seen) <= count:
        return table
    areas = table.patches.areas[seen]
    marks = marks_by_area(areas, count)
    chosen = np.zeros(len(table.patches), np.bool_)
    chosen[seen[marks > 0.0]] = True
    drawn = np.zeros(len(table.patches))
    drawn[seen] = marks * (areas.sum() / count)
    return replace(table, patches=replace(table.patches, areas=drawn), visible=table.visible & chosen)
