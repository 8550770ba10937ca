"""How much evidence each image gives of each planned defect: the statistic of the inspection, as it is expected.

A defect changes each pixel of an image by m standard deviations of the good part's level
(:func:`lightopt.defects.expected_change`), and the image's evidence is E = Σ m² over its pixels: so much the image adds
to the square of the statistic Z that the inspection computes (:mod:`lightopt.defects`). The defect counts as found
where the images' evidence adds up to T², with T from the false alarms that are allowed. Where k images must show a
defect, k − 1 images never count for enough, however much evidence they give.

Pixels around a patch see its neighbours: their levels are looked up in the image, where patches are found by their
middles. The standard deviation is that of the sensor's noise and of a part that lies a tenth of a pixel off.

Evidence is counted in whole units, 3 of which are enough where one image may decide, else 4 · (k − 1). At a place that
fewer images light, so many decide (:func:`spare_units`). An image's units are flags: flag j says that it has more than
j (:mod:`lightopt.design.responses._pairs`).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import ndimage

from lightopt import defects, rendering
from lightopt.core.arrays import Float32, Float64, Int16, Int32, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.transforms import Posture
from lightopt.defects import DARK, MOST_CHANGE, REGISTRATION_PX, clipped_variance
from lightopt.design.responses._evidence_sums import (
    CODES_PER_DEVIATION,
    ImagePatches,
    PlannedTurns,
    Stencils,
    evidence_flags,
    in_cells,
    owner_at,
)
from lightopt.design.responses._luminance_matrix import Levels
from lightopt.design.responses._pairs import PlannedCatalogue, Words
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight
from lightopt.optics import Sensor
from lightopt.scene import Scene, project, surface_footprint, surface_share, typical_blur, view_from_part

UNITS_OF_IMAGE = 3  # most units of evidence that an image counts for

# evidence from which on an image counts for one, two and three units: as shares of T² where one image may decide, and
# else of T² / (k − 1), such that as much of a part is found as by sums without units (over parts, lights and finishes)
_ALONE = (1.0 / 6.0, 1.0 / 2.0, 1.0)
_CONFIRMED = (0.22, 0.46, 0.75)

# a defect's width is divided into so many pixels where the camera's are smaller, a scratch's into fewer; of its segment
# a piece little longer than wide stands for the whole, in so many places within its pixel
_PIXELS_ACROSS, _PIXELS_ACROSS_SCRATCH, _SCRATCH_WIDTHS = 4.0, 2.2, 1.4
_PLACES_ALONG, _PLACES_ACROSS = 2, 4

# Defects lie anywhere in their pixels: middles of narrow ones, of fewer pixels than this, are taken half way between
# the two places that differ most
_NARROW_PX, _OFF_PX = 5.0, (0.25, 0.25)

# the inspection compares the greatest Z of the hypotheses near a defect, which noise makes greater than that of the
# true one by about this much
_GREATEST_OF_NEAR = 0.5

_TILE_CELLS = 16.0  # patches are worked on in tiles of so many cells of the image
_NEAR_CELLS = 2  # cells without a patch see the nearest one up to so many cells away
# footprints within a 32nd of an octave, and discs of the lens within an eighth of a pixel, share what pixels see of
# defects
_FOOTPRINT_STEPS, _BLUR_STEP = 32, 0.125

# levels by grey levels, level above black at which it clips, noise without light, electrons per level, PRNU
_Camera = tuple[float, float, float, float, float]


def units_needed(min_images: int) -> int:
    return UNITS_OF_IMAGE if min_images == 1 else (UNITS_OF_IMAGE + 1) * (min_images - 1)


def spare_units(levels: Sequence[Levels], sensor: Sensor, min_images: int) -> UInt8 | None:
    """Units of evidence that are not needed at patches which too few images light, shape (p,); None for none.

    There the inspection asks for no more images than are lit. A light counts where any of its positions lights a patch.

    levels: Delivered, of each light, shape (positions, p)
    """
    if min_images == 1:
        return None
    lit_from = DARK * math.sqrt(sensor.noise_variance(0.0))
    for _ in range(3):  # noise grows with the level
        lit_from = DARK * math.sqrt(sensor.noise_variance(lit_from))
    low, high = sensor.black_level + lit_from, sensor.saturated_from
    lit = sum(((layer >= low) & (layer < high)).any(axis=0).astype(np.int32) for layer in levels)
    units = np.array([units_needed(images) for images in range(1, min_images + 1)])
    return (units[-1] - units[np.clip(lit, 1, min_images) - 1]).astype(np.uint8)


@dataclass(frozen=True, eq=False, kw_only=True)
class DetectionModel:
    catalogue: PlannedCatalogue
    sensor: Sensor
    full_scale: float  # grey level that makes a full-scale sensor level at exposure 1
    false_alarms: float = defects.DEFAULT_FALSE_ALARMS  # allowed in the images of a posture of a good part
    min_images: int = 1  # images that must show a defect
    threshold: float | None = None  # score of a calibrated inspection's threshold; None for that of noise alone

    def stencils(self, footprint: float, blur: float = 0.0) -> Stencils:
        """What pixels of this footprint see of the defects; `blur`: diameter of the lens' disc [px]."""
        step = round(_FOOTPRINT_STEPS * math.log2(footprint))
        return _make_stencils(self.catalogue, 2.0 ** (step / _FOOTPRINT_STEPS), round(blur / _BLUR_STEP) * _BLUR_STEP)

    def limits(self, pixels: float, footprint: float, blur: float = 0.0) -> Float64:
        """Evidence from which on an image counts for one unit and more, for each entry, shape (e, 3).

        pixels: That can be inspected in the images.
        blur: Diameter of the lens' disc [px].
        """
        entries, found = self.catalogue.entries, np.empty((len(self.catalogue.entries), UNITS_OF_IMAGE))
        # a score is −log₁₀ of the false alarms of noise alone in a pixel
        false_alarms = self.false_alarms if self.threshold is None else pixels * 10.0**-self.threshold
        for e, planned in enumerate(entries):
            own = defects.defect_hypotheses(planned.entry)
            grid = defects.search_grid(own, footprint, blur)
            places = pixels / (grid.ratio * grid.step) ** 2
            z = defects.least_z(
                places * len(own.turns) * len(grid.halves) * len(defects.SIZES), len(entries), false_alarms
            )
            z -= _GREATEST_OF_NEAR + _greatest_of_segments(planned)
            if self.min_images == 1:
                found[e] = np.array(_ALONE) * z * z
            else:
                # three units are no less than what confirms
                least = defects.CONFIRMED**2 / _CONFIRMED[-1]
                found[e] = np.array(_CONFIRMED) * max(z * z / (self.min_images - 1), least)
        return found


def _greatest_of_segments(own: defects.DefectHypotheses) -> float:
    # Segments of a scratch have noise of their own, and the greatest Z finds it: so much more than the others' mean it
    # is expected to have (Blom 1958, of n normal deviates)
    from scipy import special

    segments = own.entry.shape.length / own.shapes[1].length if own.entry.shape.kind == "scratch" else 1.0
    return float(special.ndtri((segments - 0.375) / (segments + 0.25))) if segments > 1.0 else 0.0


@lru_cache(maxsize=16)
def _make_stencils(catalogue: PlannedCatalogue, footprint: float, blur: float) -> Stencils:
    groups: list[tuple[Any, ...]] = []
    before = 0
    for own in catalogue.entries:
        long = own.entry.shape.kind == "scratch"
        width = math.hypot(own.shapes[1].width, blur * footprint)
        ratio = max(1.0, width / (footprint * (_PIXELS_ACROSS_SCRATCH if long else _PIXELS_ACROSS)))
        off = _OFF_PX if width < _NARROW_PX * ratio * footprint else (0.0, 0.0)
        # a scratch is found by any of its segments: five of them stand for all
        step = max(0.0, own.entry.shape.length - own.shapes[1].length) / 4.0 if long else 0.0
        for turn in range(len(own.turns)):
            axis = np.array([math.cos(own.turns[turn]), math.sin(own.turns[turn])])
            for one in range(defects.FORESHORTENINGS):
                to_image = defects.plane_to_image(one, ratio * footprint)
                sides = ratio
                if long:
                    seen, stands_for = _scratch_piece(own, turn, to_image, blur / ratio)
                    sides *= math.sqrt(stands_for)
                else:
                    seen = own.seen_by_pixels(1, turn, to_image, off_px=off, blur_px=blur / ratio)
                pixels, number = np.unique([seen.column, seen.row], axis=1, return_inverse=True)
                total = np.bincount(number, seen.weight)
                # those that see most of the defect come first: soon there is enough
                order = np.argsort(-total, kind="stable")
                by_pixel = np.argsort(np.argsort(order)[number], kind="stable")
                right, down = ratio * pixels[:, order]
                variant, share = before + seen.variant[by_pixel].astype(np.int64), seen.weight[by_pixel]
                square, along = max(1e-9, float((total**2).sum())), ratio * step * to_image @ axis
                groups.append((along, right, down, np.bincount(number)[order], variant, share, sides, square))
        before += len(own.slope)
    along, right, down, pieces, variant, share, ratios, squares = zip(*groups, strict=True)
    return Stencils(
        first=np.cumsum([0, *map(len, right)]).astype(np.int32),
        along=np.stack(along).astype(np.float32),
        right=np.concatenate(right).astype(np.float32),
        down=np.concatenate(down).astype(np.float32),
        piece=np.cumsum(np.concatenate([[0], *pieces])).astype(np.int32),
        variant=np.concatenate(variant).astype(np.int32),
        share=np.concatenate(share).astype(np.float32),
        ratio=np.array(ratios, np.float32),
        square=np.array(squares),
    )


def _scratch_piece(
    own: defects.DefectHypotheses, turn: int, to_image: Float64, blur: float
) -> tuple[defects.PixelMixture, float]:
    # A short piece of a segment, where it changes most, and the whole's evidence as a multiple of the piece's. Walls of
    # a narrow scratch lean to opposite sides, so that evidence depends on where it lies within its pixels: across it
    # lies anywhere, and along it some segment lies best. The change is taken as linear in the slope
    axis = np.array([math.cos(own.turns[turn]), math.sin(own.turns[turn])])
    along = to_image @ axis
    along /= np.hypot(*along)
    across = np.array([-along[1], along[0]])
    lean = np.tan(own.slope) * np.stack([np.cos(own.direction), np.sin(own.direction)])
    to_length = axis @ np.linalg.inv(to_image)
    most, piece, whole = -1.0, own.seen_by_pixels(1, turn, to_image, blur_px=blur), 0.0
    for i in range(_PLACES_ACROSS):
        best = 0.0
        for k in range(_PLACES_ALONG):
            off = across * ((i + 0.5) / _PLACES_ACROSS) + along * (k / _PLACES_ALONG)
            off -= np.rint(off)
            seen = own.seen_by_pixels(1, turn, to_image, off_px=(float(off[0]), float(off[1])), blur_px=blur)
            middle = to_length[0] * (seen.column - off[0]) + to_length[1] * (seen.row - off[1])
            near = np.abs(middle) <= 0.5 * _SCRATCH_WIDTHS * own.shapes[1].width
            best = max(best, _evidence_of(seen, lean))
            short = replace(seen, **{name: values[near] for name, values in vars(seen).items()})
            # of places that are alike the first one, however sums are rounded
            if (own_evidence := _evidence_of(short, lean)) > (1.0 + 1e-9) * most:
                most, piece = own_evidence, short
        whole += best / _PLACES_ACROSS
    return piece, whole / most if most > 0.0 else 1.0


def _evidence_of(seen: defects.PixelMixture, lean: Float64) -> float:
    return _sum_of_squares(seen.row, seen.column, seen.variant, seen.weight, lean)


@kernel
def _sum_of_squares(row: Int32, column: Int32, variant: Int32, weight: Float64, lean: Float64) -> float:
    # Σ m² where changes are as the lean of the surface, over all directions of light; pieces of a pixel are adjacent
    total, x, y = 0.0, 0.0, 0.0
    for i in range(len(row)):
        if i > 0 and (row[i] != row[i - 1] or column[i] != column[i - 1]):
            total += x * x + y * y
            x = y = 0.0
        x += weight[i] * lean[0, variant[i]]
        y += weight[i] * lean[1, variant[i]]
    return total + x * x + y * y


class PatchEvidence:
    """The inspectable patches of a posture, tested for defects."""

    def __init__(
        self,
        scene: Scene,
        table: rendering.PatchTable,
        surface: rendering.SurfacePoints,
        posture: Posture,
        detection: DetectionModel,
    ) -> None:
        self._scene, self._detection = scene, detection
        camera = view_from_part(scene, posture).camera
        right, up = defects.image_axes(surface.views, camera.right)
        classes = defects.foreshortening_classes(surface.normals, surface.views, right, up).astype(np.int32)
        footprint = surface_footprint(camera, surface.points)
        cosines = np.einsum("ij,ij->i", surface.normals, surface.views)
        areas = table.patches.areas[table.inspectable(posture)] * cosines / footprint**2
        references = defects.tangent_axis(surface.normals, right)
        # turns are counted from the part's axes, and what pixels see of them from the image's
        axes = scene.placement.rotation
        own = defects.tangent_references(surface.normals, x_axis=axes[:, 0], y_axis=axes[:, 1])
        x = np.einsum("ij,ij->i", own, references)
        y = np.einsum("ij,ij->i", own, np.cross(surface.normals, references))
        image = _locate(scene, table, posture, areas, classes, np.arctan2(y, x))
        # what is seen alike, and lies side by side in the image, is worked on together
        tiles = [np.floor(a / _TILE_CELLS).astype(np.int64) for a in (image.row, image.column)]
        self._order = np.argsort((classes * np.int64(1 << 20) + tiles[0]) * (1 << 20) + tiles[1], kind="stable")
        self._image = image.in_order(self._order)
        self._surface, self._references = surface.take(self._order), references[self._order]
        share = surface_share(camera, self._surface.points)
        self._passed = 1.0 if share is None else share
        blur = typical_blur(camera, surface.points)
        self._stencils = detection.stencils(footprint, blur).in_cells(image.cell)
        self._limits = detection.limits(float(areas.sum()), footprint, blur)
        entries = detection.catalogue.entries
        turns = [len(one.turns) for one in entries]
        self._planned = PlannedTurns(
            entry=np.repeat(np.arange(len(entries)), turns).astype(np.int32),
            turns=np.array(turns, np.int32),
            variants=np.cumsum([0, *(len(one.slope) for one in entries)]).astype(np.int32),
        )
        # the waviness of good parts is noise: by so much levels change with it
        slopes, directions, self._correlated = np.zeros(0), np.zeros(0), np.zeros(1)
        if scene.waviness is not None:
            slopes, directions = scene.waviness.leans
            self._correlated = np.array(
                [scene.waviness.correlated_pixels(footprint, one.scales_px(footprint), walls=True) for one in entries]
            )
        unchanged = np.ones(len(slopes))
        wavy = {"slope": slopes, "direction": directions, "R_d_factor": unchanged, "sigma_factor": unchanged}
        all_of = {name: np.concatenate([*(getattr(one, name) for one in entries), wavy[name]]) for name in wavy}
        self._variants = rendering.surface_variants(**all_of, reflectances=scene.reflectances)

    def evaluate(
        self,
        panels: Sequence[PanelLight],
        caster: RayCaster,
        blocker: RayCaster | None,
        exposures: Sequence[float],
        *,
        added: Sequence[Float64] | None = None,
        threads: int = 1,
    ) -> Iterator[tuple[Float32, list[Words]]]:
        """Levels of the patches, and the units of evidence of an image at each exposure, of each of some lights.

        panels: Part frame; channels of a light are worked out together
        added: To the levels under each, whether there is a defect or not, and the error [grey level], shape (2, p)
        Yields levels at exposure 1 [grey level], shape (p,), and per exposure flags of shape (units, p, words).
        """
        lights, surface = [rendering.panel_to_shade(panel, caster) for panel in panels], self._surface
        found = rendering.shade_variants(
            surface, self._references, lights, self._variants, caster=blocker, dtype=np.float32, threads=threads
        )
        passed = self._passed
        plain_levels = [one.good for one in found]
        exact = [i for i, panel in enumerate(panels) if panel.points == "auto"]
        if exact:
            lit, shadows, reflectances = [panels[i] for i in exact], blocker is not None, self._scene.reflectances
            levels = rendering.shade_isolated(
                surface, lit, reflectances=reflectances, caster=caster, shadows=shadows, threads=threads
            )
            for i, level in zip(exact, levels, strict=True):
                plain_levels[i] = level
        for i, shaded in enumerate(found):
            plain, good, varied = plain_levels[i], shaded.good, shaded.varied
            error = np.zeros(0)
            if added is not None:
                more, error = added[i][:, self._order]
                plain, good, varied = plain + more, good + more, varied + more.astype(varied.dtype)
                error = error * passed
            levels = np.empty(len(plain), np.float32)
            levels[self._order] = plain.astype(np.float32) * np.float32(passed)
            good, varied = good * passed, (varied * passed).astype(np.float32, copy=False)
            yield levels, [self._units(good, varied, error, exposure) for exposure in exposures]

    def _units(self, good: Float64, varied: Float32, error: Float64, exposure: float) -> Words:
        sensor, variants = self._detection.sensor, self._planned.variants
        varied, leant = varied[: variants[-1]], varied[variants[-1] :]
        first = variants if len(self._correlated) > 1 else variants[[0, -1]]
        scale = exposure * sensor.max_level / self._detection.full_scale
        limit = sensor.saturated_from - sensor.black_level
        still = math.hypot(sensor.read_noise_levels, sensor.dsnu_levels)
        camera = scale, limit, still, float(sensor.electrons_per_level or math.inf), sensor.prnu
        codes, bounds = _changes(good, varied, leant, error, self._correlated, first, self._image, camera)
        words = evidence_flags(codes, bounds, self._image, self._planned, self._stencils, self._limits)
        in_table = np.empty_like(words)
        in_table[:, self._order] = words
        return in_table


def _locate(
    scene: Scene, table: rendering.PatchTable, posture: Posture, areas: Float64, classes: Int32, angle: Float64
) -> ImagePatches:
    # `areas`: of the inspectable patches in the image [px²]
    camera = view_from_part(scene, posture).camera
    inspectable = table.inspectable(posture)
    shown = np.flatnonzero(table.visible[table.postures.index(posture)])
    columns, rows, _ = project(camera, table.patches.centroids[shown])
    cell = max(1.0, math.sqrt(float(np.median(areas)))) if len(areas) else 1.0
    shape = math.ceil(camera.height / cell), math.ceil(camera.width / cell)
    number = np.full(len(table.patches), -1, np.int32)
    number[inspectable] = np.arange(len(inspectable), dtype=np.int32)
    own = number[shown]
    # of several patches in a cell one that can be inspected has it
    order = np.argsort(own, kind="stable")
    y, x = (
        np.clip(np.floor(a[order] / cell).astype(np.intp), 0, side - 1)
        for a, side in zip((rows, columns), shape, strict=True)
    )
    none = -2
    owner = np.full(shape, none, np.int32)
    owner[y, x] = own[order]
    column, row = (in_cells(places[own >= 0], cell) for places in (columns, rows))
    return ImagePatches(column, row, _filled(owner, none), cell, classes, angle)


def _filled(owner: Int32, none: int) -> Int32:
    # cells between patches see the nearest one, if it is next to them
    if not (owner != none).any():
        return np.full_like(owner, -1)
    near = np.full_like(owner, -1)
    # distances are sought where there may be some that are short
    window = tuple(
        slice(max(0, int(some[0]) - _NEAR_CELLS), int(some[-1]) + _NEAR_CELLS + 1)
        for some in map(np.flatnonzero, ((owner != none).any(axis=1), (owner != none).any(axis=0)))
    )
    some = owner[window]
    distance: Float64 = np.empty(some.shape)
    place: Int32 = np.empty((2, *some.shape), np.int32)
    ndimage.distance_transform_edt(some == none, return_indices=True, distances=distance, indices=place)
    near[window] = np.where(distance <= _NEAR_CELLS, some[tuple(place)], np.int32(-1))
    return near


@kernel
def _changes(
    good: Float64,
    varied: Float32,
    leant: Float32,
    error: Float64,
    correlated: Float64,
    first: Int32,
    image: ImagePatches,
    camera: _Camera,
) -> tuple[Int16, Float32]:
    # Changes by the variants, of each patch, as the camera would deliver them if it did not clip: mixed levels are
    # clipped, not those that are mixed; the last patch stands for none. The bounds are the least and the greatest
    # change that it delivers, and the change that is none: see expected_change. Levels are above black. The waviness of
    # good parts is noise by what `leant` variants change, `correlated` times in each set of bounds, which is of the
    # variants from `first`; so is the error of levels, unless there is none
    (column, row, owner, cell, _, _, _), (scale, limit, still, electrons, prnu) = image, camera
    codes = np.zeros((len(varied), len(good) + 1), np.int16)
    bounds = np.zeros((len(correlated), len(good) + 1, 3), np.float32)
    levels, variances, wavy = np.empty(len(good)), np.empty(len(good)), np.zeros(len(good))
    for p in range(len(good)):
        level = min(scale * good[p], limit)
        square = 0.0
        for across in range(2):
            before = owner_at(column[p] - (1 - across), row[p] - across, owner)
            after = owner_at(column[p] + (1 - across), row[p] + across, owner)
            low = level if before < 0 else min(scale * good[before], limit)
            high = level if after < 0 else min(scale * good[after], limit)
            steps = (before >= 0) + (after >= 0)
            slope = (high - low) / (max(steps, 1) * cell)
            square += slope * slope
        levels[p] = level
        variances[p] = (still * still + level / electrons + 1.0 / 12.0 + REGISTRATION_PX * REGISTRATION_PX * square) + (
            prnu * level
        ) ** 2
        if len(error):
            top, bottom = min(scale * (good[p] + error[p]), limit), min(scale * (good[p] - error[p]), limit)
            variances[p] += (0.5 * (top - bottom)) ** 2
        if len(leant):
            spread = scale * math.hypot(leant[0, p] - good[p], leant[1, p] - good[p])
            wavy[p] = clipped_variance(scale * good[p], spread, limit)
    noises = np.empty(len(good))
    for e in range(len(bounds)):
        for p in range(len(good)):
            level, noise = levels[p], math.sqrt(variances[p] + correlated[e] * wavy[p])
            bounds[e, p, 0] = max(-level / noise, -MOST_CHANGE)
            bounds[e, p, 1] = min((limit - level) / noise, MOST_CHANGE)
            bounds[e, p, 2] = DARK if level < DARK * noise else 0.0
            noises[p] = noise
        for v in range(first[e], first[e + 1]):
            for p in range(len(good)):
                change = (scale * varied[v, p] - levels[p]) / noises[p]
                codes[v, p] = np.int16(np.rint(max(-32_000.0, min(32_000.0, change * CODES_PER_DEVIATION))))
    return codes, bounds
