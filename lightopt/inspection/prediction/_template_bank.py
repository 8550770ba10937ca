"""The images of a posture as the defects of a catalogue would change them, wherever these lie.

The change that each variant of the surface makes of a pixel is computed once; a defect changes the images by the sum of
its pieces (:mod:`lightopt.defects`). Pixels that see the surface under nearly the same foreshortening share the pieces.
Entries of wide defects have images of larger pixels.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lightopt import defects, rendering
from lightopt.core.arrays import Bool, Float32, Float64, Index, Int8, Int16, Int32, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.threads import blocks, in_threads
from lightopt.geometry import RayCaster
from lightopt.inspection._image_blocks import block_sums, mask_window
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.lights import PanelLight
from lightopt.scene import Scene, lens_share, surface_footprint, typical_blur

# a place is tested where a defect of the entry's own size and amplitude is expected to stand out by so much; elsewhere
# only one several times as strong would be found
LEAST_EXPECTED = 1.5

CODES = 127  # changes are stored as whole numbers up to this

_LEVELS = 1 << 18  # of points, variants and lights that are shaded at once
_ROWS = 16  # rows of places that a thread works on at once


@dataclass(frozen=True, eq=False, kw_only=True)
class Pieces:
    """What pixels see of the sizes and poses of a defect, for each class of foreshortening.

    A pose is a turn and a place of the middle within its pixel.
    """

    # of class c, size s and pose p, group g = (c · sizes + s) · poses + p: the pieces from first[g] to first[g + 1],
    # shape (groups + 1,)
    first: Int32
    pixel: Int32  # offset of the piece's pixel from that of the middle, in the raveled images, shape (n,)
    # of the piece, shape (n,)
    variant: Int32
    weight: Float32


@dataclass(frozen=True, eq=False, kw_only=True)
class EntryTemplates:
    """The expected changes of an entry of the catalogue, in images of h × w larger pixels, an empty border included."""

    hypotheses: defects.DefectHypotheses
    deviation: Float32  # of the good part's levels: unit of the changes, shape (lights, H, W)
    # what measured deviations are multiplied by for that unit, shape (lights, H, W): waviness changes the pixels of a
    # wide defect alike. None where it is 1
    attenuation: Float32 | None
    ratio: int  # side of these pixels [px]
    width_px: float  # width of the middle size [pixels of these images]
    corner: tuple[int, int]  # row and column of the first one's corner [px]
    border: int  # width of the border [pixels of these images]
    change: Int8  # of each pixel, light and variant, in units of :attr:`unit`, shape (h, w, lights, variants)
    count: UInt8  # pixels of the image that count in each, shape (h, w, lights)
    foreshortening: Int16  # class of each pixel, −1 where no defect is tested, shape (h, w)
    pieces: Pieces
    step: int  # places to test are so many pixels apart, from the border on
    # places of the middle within its pixel, to the right and down [pixels of these images]
    halves: tuple[tuple[float, float], ...]
    # 1/√ΣE of the middle size at each pose and place, in units of the stored changes, 0 where it is not tested; shape
    # (poses, rows, columns)
    inverse: Float32

    @property
    def unit(self) -> float:
        """Of the stored changes: standard deviations of the sum over a larger pixel."""
        return defects.MOST_CHANGE * self.ratio / CODES

    @property
    def poses(self) -> int:
        return len(self.hypotheses.turns) * len(self.halves)

    @property
    def tests(self) -> int:
        return int(np.count_nonzero(self.inverse)) * len(self.hypotheses.shapes)


TemplateBank = tuple[EntryTemplates, ...]


def bank_bytes(bank: TemplateBank) -> int:
    """Memory of the images of a bank; entries may have some in common."""
    names = ("deviation", "attenuation", "change", "count", "foreshortening", "inverse")
    images = (getattr(one, name) for one in bank for name in names)
    return sum({id(image): image.nbytes for image in images if image is not None}.values())


@dataclass(frozen=True, eq=False)
class _Surface:
    """The pixels of a posture for shading: number among `pixels` or −1, tangent axes, foreshortening, blur [px]."""

    pixels: rendering.PosturePixels
    index: Int32
    references: Float64
    foreshortening: Int16
    footprint: float
    blur: float


def template_bank(
    scene: Scene,
    view: PostureView,
    catalogue: Sequence[defects.CatalogueEntry],
    caster: RayCaster,
    *,
    threads: int | None = None,
) -> TemplateBank:
    """Predict the changes of all defects of a catalogue in the images of a posture.

    scene: With the part where it lies.
    """
    if not view.clean.any():
        return ()
    pixels = rendering.trace_pixels(scene, view.posture, caster, threads=threads)
    surface = _surface(pixels, view.clean)
    deviation = expected_deviation(view)
    panels = [next(light for light in pixels.view.lights if light.name == name) for name in view.lights]
    hypotheses = [defects.defect_hypotheses(entry) for ranges in catalogue for entry in ranges.in_sizes()]
    entries = [_templates_without_changes(own, view, deviation, surface, len(panels)) for own in hypotheses]
    # entries whose larger pixels are of one size see the same places of the surface
    for ratio in dict.fromkeys(entry.ratio for entry, _ in entries):
        alike, pixels = zip(*(one for one in entries if one[0].ratio == ratio), strict=True)
        _set_changes(alike, pixels[0], scene, view, surface, panels, caster, threads)
    for entry, _ in entries:
        _set_inverse(entry, threads)
    return tuple(entry for entry, _ in entries)


def expected_deviation(view: PostureView) -> Float32:
    """Standard deviation of a good part's levels, of noise and of where it lies, shape (lights, H, W)."""
    result = np.empty_like(view.deviation)
    for i, (level, limit, noise) in enumerate(zip(view.predicted, view.limit, view.deviation, strict=True)):
        down, right = np.gradient(np.clip(level, 0.0, limit))
        result[i] = np.sqrt(noise**2 + defects.REGISTRATION_PX**2 * (down**2 + right**2))
    return result


def _surface(pixels: rendering.PosturePixels, clean: Bool) -> _Surface:
    surface, camera = pixels.surface, pixels.view.camera
    index = np.full(pixels.shape, -1, np.int32)
    index[pixels.row, pixels.column] = np.arange(len(pixels.row), dtype=np.int32)
    index[~clean] = -1
    right, up = defects.image_axes(surface.views, camera.right)
    references = defects.tangent_axis(surface.normals, right)
    classes = defects.foreshortening_classes(surface.normals, surface.views, right, up).astype(np.int16)
    seen = surface.points[index[clean]]
    return _Surface(pixels, index, references, classes, surface_footprint(camera, seen), typical_blur(camera, seen))


def _templates_without_changes(
    own: defects.DefectHypotheses, view: PostureView, deviation: Float32, surface: _Surface, lights: int
) -> tuple[EntryTemplates, Index]:
    # `change` and `inverse` are set later; and the pixel of the image in the middle of each larger one that sees the
    # part, shape (k,)
    grid = defects.search_grid(own, surface.footprint, surface.blur)
    ratio = grid.ratio
    deviation, attenuation = entry_deviation(own, view, deviation)
    reach = max(shape.length for shape in own.shapes) / surface.footprint + surface.blur
    border = 2 + math.ceil(0.5 * reach / ratio)
    rows, columns = mask_window(view.clean)
    clean = [(view.clean & (level > 0.0))[rows, columns] for level in view.predicted]
    count = np.stack([np.pad(block_sums(mask, ratio).astype(np.uint8), border) for mask in clean], axis=-1)
    # the surface is that of the pixel in the middle of each larger one
    index = np.full(count.shape[:2], -1, np.int32)
    middle = surface.index[
        rows.start + ratio // 2 : rows.stop : ratio, columns.start + ratio // 2 : columns.stop : ratio
    ]
    index[border : border + middle.shape[0], border : border + middle.shape[1]] = middle
    foreshortening = np.where(index < 0, np.int16(-1), surface.foreshortening[np.maximum(index, 0)])
    classes = np.unique(foreshortening[index >= 0]).tolist()
    footprint, blur = ratio * surface.footprint, surface.blur / ratio
    places = [-(-(side - 2 * border) // grid.step) for side in index.shape]
    templates = EntryTemplates(
        hypotheses=own,
        deviation=deviation,
        attenuation=attenuation,
        ratio=ratio,
        width_px=math.hypot(own.shapes[1].width / footprint, blur),
        corner=(rows.start - border * ratio, columns.start - border * ratio),
        border=border,
        change=np.zeros((*index.shape, lights, len(own.slope)), np.int8),
        count=count,
        foreshortening=foreshortening,
        pieces=_pieces(own, grid.halves, classes, footprint, blur, count.shape[1]),
        step=grid.step,
        halves=grid.halves,
        inverse=np.zeros((len(own.turns) * len(grid.halves), *places), np.float32),
    )
    return templates, index[index >= 0].astype(np.intp)


def _set_changes(
    entries: Sequence[EntryTemplates],
    pixel: Index,
    scene: Scene,
    view: PostureView,
    surface: _Surface,
    panels: Sequence[PanelLight],
    caster: RayCaster,
    threads: int | None,
) -> None:
    # the changes of entries with the same pixels, worked out together
    kinds, at = zip(*((entry.hypotheses, np.flatnonzero(entry.foreshortening >= 0)) for entry in entries), strict=True)
    variants = rendering.surface_variants(
        slope=np.concatenate([own.slope for own in kinds]),
        direction=np.concatenate([own.direction for own in kinds]),
        R_d_factor=np.concatenate([own.R_d_factor for own in kinds]),
        sigma_factor=np.concatenate([own.sigma_factor for own in kinds]),
        reflectances=scene.reflectances,
    )
    ends = np.cumsum([len(own.slope) for own in kinds])
    sources = [rendering.panel_to_shade(panel, caster) for panel in panels]
    most = max(1, _LEVELS // int(ends[-1]))
    tasks = [
        (group, start, end)
        for group in rendering.channel_groups(sources)
        for start, end in blocks(len(pixel), max(1, most // len(group)))
    ]

    def shade(task: tuple[Sequence[int], int, int]) -> None:
        group, start, end = task
        some = pixel[start:end]
        points: rendering.SurfacePoints = surface.pixels.surface.take(some)
        own, references = [sources[i] for i in group], surface.references[some]
        place = surface.pixels.row[some], surface.pixels.column[some]
        share = lens_share(scene.camera, place[1] + 0.5, place[0] + 0.5)
        passed = 1.0 if share is None else share[:, None]
        found = rendering.shade_variants(points, references, own, variants, caster=caster)
        for i, levels in zip(group, found, strict=True):
            good, limit = (a[i][place].astype(np.float64)[:, None] for a in (view.predicted, view.limit))
            change_of_level = passed * (levels.varied.T - levels.good[:, None])
            for entry, all_of_it, change in zip(entries, at, np.split(change_of_level, ends[:-1], axis=1), strict=True):
                noise, to = entry.deviation[i][place].astype(np.float64)[:, None], all_of_it[start:end]
                lights, width = entry.change.shape[2:]
                off = defects.expected_change(good, good + change, deviation=noise, limit=limit)
                off *= np.sqrt(entry.count.reshape(-1, lights)[to, i])[:, None]
                entry.change.reshape(-1, lights, width)[to, i] = np.rint(off / entry.unit)

    in_threads(shade, tasks, threads)


def _set_inverse(entry: EntryTemplates, threads: int | None) -> None:
    (_, width, lights, variants), border, step = entry.change.shape, entry.border, entry.step
    # where the piece's change lies from that of the middle where pixels of a row are side by side
    down = (entry.pieces.pixel + border * (width + 1)) // width - border
    offset = entry.pieces.pixel + (down * (lights * variants - 1) + entry.pieces.variant) * width
    pieces = entry.pieces.first, entry.pieces.pixel, offset, entry.pieces.weight
    grid = len(entry.hypotheses.shapes), border, step

    def invert(top: int) -> None:
        rows = top, min(top + _ROWS, entry.inverse.shape[1])
        some = entry.change[rows[0] * step : (rows[1] - 1) * step + 2 * border + 1]
        change = np.ascontiguousarray(some.transpose(0, 2, 3, 1))
        _invert(change, entry.foreshortening, pieces, grid, rows, LEAST_EXPECTED / entry.unit, entry.inverse)

    in_threads(invert, range(0, entry.inverse.shape[1], _ROWS), threads)


def entry_deviation(
    own: defects.DefectHypotheses, view: PostureView, deviation: Float32
) -> tuple[Float32, Float32 | None]:
    """The deviation in sums over the pixels of an entry's defects, and that of other sums as a share of it.

    deviation: From :func:`expected_deviation`
    """
    known = view.prediction.waviness
    if known is None or view.wavy is None:
        return deviation, None
    of_entry = known.waviness.correlated_pixels(known.footprint, own.scales_px(known.footprint), walls=True)
    included = known.waviness.correlated_pixels(known.footprint, defects.SCALES_PX)
    wider = np.sqrt(deviation**2 + np.float32(of_entry - included) * view.wavy).astype(np.float32)
    return wider, (deviation / wider).astype(np.float32)


def _pieces(
    own: defects.DefectHypotheses,
    halves: Sequence[tuple[float, float]],
    classes: Sequence[int],
    footprint: float,
    blur: float,
    breadth: int,
) -> Pieces:
    sizes, turns = len(own.shapes), len(own.turns)
    counts = np.zeros((defects.FORESHORTENINGS, sizes, turns * len(halves)), np.int32)
    # empty ones first: there may be no place to test
    parts: list[tuple[Int32, Int32, Float64]] = [(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0))]
    for one in classes:
        to_image = defects.plane_to_image(one, footprint)
        for size in range(sizes):
            for pose, (turn, off) in enumerate(itertools.product(range(turns), halves)):
                mixture = own.seen_by_pixels(size, turn, to_image, off_px=off, blur_px=blur)
                parts.append((mixture.row * breadth + mixture.column, mixture.variant, mixture.weight))
                counts[one, size, pose] = len(mixture.weight)
    pixel, variant, weight = (np.concatenate(some) for some in zip(*parts, strict=True))
    first = np.concatenate([[0], np.cumsum(counts)])
    return Pieces(
        first=first.astype(np.int32),
        pixel=pixel.astype(np.int32),
        variant=variant.astype(np.int32),
        weight=weight.astype(np.float32),
    )


@kernel
def _invert(
    change: Int8,
    foreshortening: Int16,
    pieces: tuple[Int32, Int32, Int32, Float32],
    grid: tuple[int, int, int],
    rows: tuple[int, int],
    least: float,
    inverse: Float32,
) -> None:
    # some rows of places: 1/√ΣE of the middle size in units of the stored changes, which begin with the first row of
    # pixels that they see, shape (rows, lights, variants, w)
    (first, pixel, offset, weight), (sizes, border, step) = pieces, grid
    poses, _, columns = inverse.shape
    _, lights, variants, width = change.shape
    flat, of_light = change.reshape(-1), variants * width
    energy, own = np.empty(columns, np.float32), np.zeros((lights, columns), np.float32)
    for i in range(rows[0], rows[1]):
        y, left = border + i * step, 0
        while left < columns:
            # places of a row that share their pieces
            view = foreshortening[y, border + left * step]
            right = left + 1
            while right < columns and foreshortening[y, border + right * step] == view:
                right += 1
            base = (y - rows[0] * step) * lights * of_light + border + left * step
            count = right - left if view >= 0 else 0
            for p in range(poses if count > 0 else 0):
                group = (view * sizes + 1) * poses + p
                start, end = first[group], first[group + 1]
                energy[:count] = np.float32(0.0)
                for n in range(start, end):
                    for light in range(lights):
                        some = flat[base + offset[n] + light * of_light :]
                        if step == 1:
                            for k in range(count):
                                own[light, k] += weight[n] * np.float32(some[k])
                        else:
                            for k in range(count):
                                own[light, k] += weight[n] * np.float32(some[k * step])
                        if n + 1 == end or pixel[n + 1] != pixel[n]:
                            for k in range(count):
                                energy[k] += own[light, k] * own[light, k]
                                own[light, k] = np.float32(0.0)
                for k in range(count):
                    if energy[k] >= least * least:
                        inverse[p, i, left + k] = np.float32(1.0) / math.sqrt(energy[k])
            left = right
