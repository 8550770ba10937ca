"""Test every place for the defects of a catalogue, with one statistic of all images (:mod:`lightopt.defects`).

Defects are accepted one by one, the one of the highest score first. What an accepted defect explains is taken out of
the images before the next one is sought, so that a strong defect leaves no others around it.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, Index, Int8, Int16, Int32, UInt8
from lightopt.core.errors import InputError
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.defects import CONFIRMED, SIZES, chance_score, rest_of_images
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.prediction._template_bank import CODES, EntryTemplates, TemplateBank

LEAST_SCORE = 3.0  # defects of lower scores are not sought

# the other sizes of a defect are tested where the middle one stands out by so much: they are much alike
LEAST_MIDDLE = 3.0

MARGIN_PX = 2  # pixels around what an accepted defect explains are explained, too: models of defects are not exact
MOST_DEFECTS = 2000  # that are accepted or refused; beyond, the model does not describe the part
_ROWS = 16  # rows of places that a thread works on at once


@dataclass(frozen=True, eq=False, kw_only=True)
class ExplainedDefect:
    """A defect of the catalogue that explains deviations of a posture."""

    templates: EntryTemplates
    # indices of the hypothesis
    size: int
    pose: int
    middle: tuple[int, int]  # row and column of its middle
    score: float
    # U and E of each image, shape (lights,)
    sums: Float64
    energies: Float64
    # U and E of each image over the pixels whose change is not clipped, which the amplitude follows from; shape
    # (lights, 2)
    shares: Float64
    of_sizes: Float64  # Z of each size at its place
    # pixels of the images that it lies on, shape (n,)
    rows: Index
    columns: Index

    @property
    def z(self) -> float:
        return float(self.sums.sum() / math.sqrt(self.energies.sum()))


@dataclass
class _Candidates:
    """Hypotheses that stand out, n of them: index of the entry, size, pose, pixel of the middle, Z and score.

    In the order of entry, size and row.
    """

    entry: Int32
    size: Int32
    pose: Int32
    row: Int32
    column: Int32
    z: Float64
    score: Float64

    def take(self, which: Index | Bool) -> "_Candidates":
        return _Candidates(*(getattr(self, one.name)[which] for one in fields(self)))

    @staticmethod
    def joined(parts: Sequence["_Candidates"]) -> "_Candidates":
        return _Candidates(*(np.concatenate([getattr(p, one.name) for p in parts]) for one in fields(_Candidates)))


@dataclass
class _Entry:
    """An entry's images while defects are sought."""

    templates: EntryTemplates
    z: Float32  # deviations in its larger pixels, of variance 1, shape (h, w, lights)
    handicap: float  # what is taken off −log₁₀ of a test's probability, since the entry has so many tests
    free: Bool = field(init=False)  # which of them no defect explains yet, same shape

    def __post_init__(self) -> None:
        self.free = np.ones(self.z.shape, np.bool_)

    def measure(self, some: _Candidates) -> tuple[Float32, Float32, Float32]:
        """U and E of each image by what is free, shape (n, lights), and those not clipped, (n, lights, 2)."""
        t, lights = self.templates, self.z.shape[2]
        sums, energies = np.zeros((len(some.row), lights), np.float32), np.zeros((len(some.row), lights), np.float32)
        shares = np.zeros((len(some.row), lights, 2), np.float32)
        groups = _group(t, some.row, some.column, some.size, some.pose)
        pieces = t.pieces.first, t.pieces.pixel, t.pieces.variant, t.pieces.weight
        images, places = (t.change, self.z, self.free), (groups, some.row, some.column)
        _light_sums(images, np.float32(t.unit), pieces, places, sums, energies, shares)
        return sums, energies, shares

    def rate(self, some: _Candidates) -> None:
        sums, energies, _ = self.measure(some)
        total = energies.sum(axis=1, dtype=np.float64)
        z = np.where(total > 0.0, sums.sum(axis=1, dtype=np.float64) / np.sqrt(np.maximum(total, 1e-12)), 0.0)
        some.z, some.score = z, chance_score(z) - self.handicap


def _group(t: EntryTemplates, row: Int32, column: Int32, size: Int32, pose: Int32) -> Int32:
    sizes, poses = len(t.hypotheses.shapes), t.poses
    classes = t.foreshortening[row, column].astype(np.int32)
    return ((classes * sizes + size) * poses + pose).astype(np.int32)


def explain_deviations(
    found: Deviations, bank: TemplateBank, *, share: float, min_images: int, threads: int | None = None
) -> tuple[ExplainedDefect, ...]:
    """The defects of a catalogue that explain deviations of a posture, by descending score.

    On a good part at most 10⁻ˢ · `share` of them per pixel are expected to have a score of s or more, the bound of
    Bonferroni; each entry has an even part of that.

    min_images: A defect counts where the images without the `min_images` − 1 that support it most confirm it. Where
        fewer are lit it has to show in these alone.
    """
    pixels = max(1, int(np.count_nonzero(found.usable.any(axis=0))))
    entries = [
        _Entry(t, reduced_deviations(t, found.z, threads), math.log10(max(t.tests, 1) * len(bank) / (share * pixels)))
        for t in bank
    ]
    scans = [_scan(number, entry, threads) for number, entry in enumerate(entries)]
    candidates = _Candidates.joined(scans) if scans else None
    lit = found.lit.sum(axis=0)
    result: list[ExplainedDefect] = []
    for _ in range(MOST_DEFECTS):
        if candidates is None or not len(candidates.score):
            break
        best = candidates.take(np.array([candidates.score.argmax()]))
        if not best.score[0] >= LEAST_SCORE:
            break
        entry = entries[int(best.entry[0])]
        sums, energies, _ = by_light = entry.measure(best)
        rows, columns, middle = support = _support(entry.templates, best, lit.shape)
        images = min(min_images, max(1, int(lit[middle])))
        confirmed = images == 1 or float(rest_of_images(sums, energies, images)[0]) >= CONFIRMED
        if confirmed:
            result.append(_explained(entry, best, by_light, support))
            lights = np.arange(sums.shape[1])
        else:
            lights = np.argsort(-sums[0] * np.sign(best.z[0]), kind="stable")[: images - 1]
        box = _take_out(entries, rows, columns, lights, lit.shape)
        _rate_again(entries, candidates, box)
        if not candidates.score.max(initial=0.0) >= LEAST_SCORE:
            break
        alive = candidates.score >= LEAST_SCORE
        if np.count_nonzero(alive) < 0.5 * len(alive):
            candidates = candidates.take(alive)
    else:
        raise InputError(
            f"detector catalogue: more than {MOST_DEFECTS:,} places look like a defect: the model does not describe "
            "the part; check the sensor's noise in the rig file, and fit the reflectance (lightopt fit-specular)"
        )
    return tuple(sorted(result, key=lambda one: -one.score))


def reduced_deviations(templates: EntryTemplates, z: Float32, threads: int | None = None) -> Float32:
    """Sums of deviations over the larger pixels of an entry, of variance 1, shape (h, w, lights)."""
    if templates.attenuation is not None:
        z = z * templates.attenuation
    result = np.zeros(templates.count.shape, np.float32)
    top, left = templates.corner

    def reduce(start: int) -> None:
        rows = slice(start, start + 4 * _ROWS)
        _reduce(z, templates.count[rows], templates.ratio, top + start * templates.ratio, left, result[rows])

    in_threads(reduce, range(0, len(result), 4 * _ROWS), threads)
    return result


def _scan(number: int, entry: _Entry, threads: int | None) -> _Candidates:
    # the middle size everywhere, the others where that stands out
    t = entry.templates
    _, rows, columns = t.inverse.shape
    best, pose = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.int32)
    # in products, of which each row of pixels has a row for each variant
    width, variants = t.change.shape[1], t.change.shape[3]
    down = (t.pieces.pixel + t.border * (width + 1)) // width - t.border
    offset = t.pieces.pixel + (down * (variants - 1) + t.pieces.variant) * width

    def scan(top: int) -> None:
        bottom = min(top + _ROWS, rows)
        start, end = top * t.step, (bottom - 1) * t.step + 2 * t.border + 1
        products = _multiply(t.change, entry.z, start, end)
        pieces, grid = (t.pieces.first, offset, t.pieces.weight), (len(t.hypotheses.shapes), t.border, t.step)
        _best_poses(products, start, t.foreshortening, pieces, grid, top, bottom, t.inverse, best, pose)

    in_threads(scan, range(0, rows, _ROWS), threads)
    i, k = np.nonzero(np.abs(best) >= LEAST_MIDDLE)
    parts: list[_Candidates] = []
    for size in range(len(t.hypotheses.shapes)):
        some = _Candidates(
            entry=np.full(len(i), number, np.int32),
            size=np.full(len(i), size, np.int32),
            pose=pose[i, k],
            row=(t.border + i * t.step).astype(np.int32),
            column=(t.border + k * t.step).astype(np.int32),
            z=np.zeros(len(i)),
            score=np.zeros(len(i)),
        )
        entry.rate(some)
        parts.append(some.take(some.score >= LEAST_SCORE))
    return _Candidates.joined(parts)


def _support(t: EntryTemplates, one: _Candidates, shape: tuple[int, ...]) -> tuple[Index, Index, tuple[int, int]]:
    # pixels of the image that a defect lies on, and that of its middle
    (group,) = _group(t, one.row, one.column, one.size, one.pose)
    own = t.pieces.pixel[t.pieces.first[group] : t.pieces.first[group + 1]]
    at = np.unique(int(one.row[0]) * t.change.shape[1] + int(one.column[0]) + own)
    y, x = np.divmod(at, t.change.shape[1])
    inner = np.arange(t.ratio)
    rows = np.broadcast_to((t.corner[0] + y * t.ratio)[:, None, None] + inner[:, None], (len(at), t.ratio, t.ratio))
    columns = np.broadcast_to((t.corner[1] + x * t.ratio)[:, None, None] + inner, (len(at), t.ratio, t.ratio))
    rows, columns = rows.ravel(), columns.ravel()
    inside = (rows >= 0) & (columns >= 0) & (rows < shape[0]) & (columns < shape[1])
    middle = [
        min(corner + int(place[0]) * t.ratio + t.ratio // 2, side - 1)
        for corner, place, side in zip(t.corner, (one.row, one.column), shape, strict=True)
    ]
    return rows[inside], columns[inside], (middle[0], middle[1])


def _explained(
    entry: _Entry, one: _Candidates, by_light: Sequence[Float32], support: tuple[Index, Index, tuple[int, int]]
) -> ExplainedDefect:
    sums, energies, shares = (some[0].astype(np.float64) for some in by_light)
    rows, columns, middle = support
    every = one.take(np.zeros(len(SIZES), np.intp))
    every.size = np.arange(len(SIZES), dtype=np.int32)
    entry.rate(every)
    return ExplainedDefect(
        templates=entry.templates,
        size=int(one.size[0]),
        pose=int(one.pose[0]),
        middle=middle,
        score=float(one.score[0]),
        sums=sums,
        energies=energies,
        shares=shares,
        of_sizes=every.z,
        rows=rows,
        columns=columns,
    )


def _take_out(
    entries: Sequence[_Entry], rows: Index, columns: Index, lights: Index, shape: tuple[int, ...]
) -> tuple[int, int, int, int]:
    # mark pixels and those around them as explained in some images; first and last row and column of these
    top, left = max(0, int(rows.min()) - MARGIN_PX), max(0, int(columns.min()) - MARGIN_PX)
    bottom, right = min(shape[0] - 1, int(rows.max()) + MARGIN_PX), min(shape[1] - 1, int(columns.max()) + MARGIN_PX)
    mask = np.zeros((bottom - top + 1, right - left + 1), np.bool_)
    mask[rows - top, columns - left] = True
    y, x = np.nonzero(ndimage.binary_dilation(mask, np.ones((3, 3)), iterations=MARGIN_PX))
    for entry in entries:
        t = entry.templates
        row, column = (y + top - t.corner[0]) // t.ratio, (x + left - t.corner[1]) // t.ratio
        inside = (row >= 0) & (column >= 0) & (row < entry.free.shape[0]) & (column < entry.free.shape[1])
        for light in lights:
            entry.free[row[inside], column[inside], light] = False
    return top, bottom, left, right


def _rate_again(entries: Sequence[_Entry], candidates: _Candidates, box: tuple[int, int, int, int]) -> None:
    # those that an explained box changes: of each entry and size those of some rows, which lie together
    groups = candidates.entry * len(SIZES) + candidates.size
    begins = np.searchsorted(groups, np.arange(len(entries) * len(SIZES) + 1))
    for number, (begin, end) in enumerate(itertools.pairwise(begins)):
        entry = entries[number // len(SIZES)]
        t = entry.templates
        (top, bottom), (left, right) = (
            ((first - corner) // t.ratio - t.border, (last - corner) // t.ratio + t.border)
            for first, last, corner in zip(box[::2], box[1::2], t.corner, strict=True)
        )
        first, last = begin + np.searchsorted(candidates.row[begin:end], [top, bottom + 1])
        column = candidates.column[first:last]
        near = (candidates.score[first:last] >= LEAST_SCORE) & (column >= left) & (column <= right)
        which = first + np.flatnonzero(near)
        if len(which):
            some = candidates.take(which)
            entry.rate(some)
            candidates.z[which], candidates.score[which] = some.z, some.score


@kernel
def _reduce(z: Float32, count: UInt8, ratio: int, top: int, left: int, result: Float32) -> None:
    lights, height, width = z.shape
    for y in range(result.shape[0]):
        for x in range(result.shape[1]):
            for light in range(lights):
                if count[y, x, light] == 0:
                    continue
                total = np.float32(0.0)
                for v in range(max(0, top + y * ratio), min(height, top + (y + 1) * ratio)):
                    for u in range(max(0, left + x * ratio), min(width, left + (x + 1) * ratio)):
                        total += z[light, v, u]
                result[y, x, light] = total / math.sqrt(np.float32(count[y, x, light]))


@kernel
def _multiply(change: Int8, z: Float32, top: int, bottom: int) -> Float32:
    # Σ m·z over the lights, for each variant of some rows of pixels, shape (rows, variants, w)
    _, width, lights, variants = change.shape
    result = np.zeros((bottom - top, variants, width), np.float32)
    own = np.empty(variants, np.float32)
    for y in range(top, bottom):
        for x in range(width):
            own[:] = np.float32(0.0)
            for light in range(lights):
                # variants lie side by side, so that the processor takes several at once
                some, factor = change[y, x, light], z[y, x, light]
                for v in range(variants):
                    own[v] += factor * np.float32(some[v])
            for v in range(variants):
                result[y - top, v, x] = own[v]
    return result


@kernel
def _best_poses(
    products: Float32,
    start: int,
    foreshortening: Int16,
    pieces: tuple[Int32, Int32, Float32],
    grid: tuple[int, int, int],
    top: int,
    bottom: int,
    inverse: Float32,
    best: Float32,
    pose: Int32,
) -> None:
    # rows of places from `top` to `bottom`: Z of the middle size at the pose where it is greatest; `products` begin
    # with the row `start` of the images
    (first, offset, weight), (sizes, border, step) = pieces, grid
    poses, _, columns = inverse.shape
    _, variants, width = products.shape
    flat = products.reshape(-1)
    total = np.empty(columns, np.float32)
    for i in range(top, bottom):
        y = border + i * step
        left = 0
        while left < columns:
            # places of a row that share their pieces
            view = foreshortening[y, border + left * step]
            right = left + 1
            while right < columns and foreshortening[y, border + right * step] == view:
                right += 1
            base = (y - start) * variants * width + border + left * step
            count = right - left if view >= 0 else 0
            for p in range(poses if count > 0 else 0):
                group = (view * sizes + 1) * poses + p
                total[:count] = np.float32(0.0)
                for n in range(first[group], first[group + 1]):
                    some, factor = flat[base + offset[n] :], weight[n]
                    if step == 1:
                        for k in range(count):
                            total[k] += factor * some[k]
                    else:
                        for k in range(count):
                            total[k] += factor * some[k * step]
                for k in range(count):
                    z = total[k] * inverse[p, i, left + k]
                    if abs(z) > abs(best[i, left + k]):
                        best[i, left + k], pose[i, left + k] = z, p
            left = right


@kernel
def _light_sums(
    images: tuple[Int8, Float32, Bool],
    unit: np.float32,
    pieces: tuple[Int32, Int32, Int32, Float32],
    places: tuple[Int32, Int32, Int32],
    sums: Float32,
    energies: Float32,
    shares: Float32,
) -> None:
    # of each hypothesis U and E by light over the pixels that are free, and of those whose change is not clipped
    (change, z, free), (first, pixel, variant, weight), (groups, row, column) = images, pieces, places
    _, width, lights, variants = change.shape
    flat, flat_z, flat_free = change.reshape(-1), z.reshape(-1), free.reshape(-1)
    own, whole = np.zeros(lights, np.float32), np.ones(lights, np.bool_)
    for j in range(len(row)):
        base = row[j] * width + column[j]
        end = first[groups[j] + 1]
        last = np.int64(-1)
        for n in range(first[groups[j]], end + 1):
            at = base + pixel[n] if n < end else np.int64(-1)
            if at != last and last >= 0:
                for light in range(lights):
                    place = last * lights + light
                    if flat_free[place]:
                        product, square = own[light] * flat_z[place], own[light] * own[light]
                        sums[j, light] += product
                        energies[j, light] += square
                        if whole[light]:
                            shares[j, light, 0] += product
                            shares[j, light, 1] += square
                    own[light], whole[light] = np.float32(0.0), True
            last = at
            if at >= 0:
                place = at * lights * variants + variant[n]
                for light in range(lights):
                    code = flat[place + light * variants]
                    own[light] += weight[n] * unit * np.float32(code)
                    whole[light] &= abs(code) < CODES
