"""Evidence of whole defects: sums over the pixels around each patch, left out where a bound says that they are small.

The variants of an entry of the catalogue change a patch by so much at most. Where this is no more than M for all
patches that a defect's pixels may see, its evidence is no more than M² · Σ (share of the pixel in the defect)². So what
lies in shadow or far from a highlight is decided without a sum.
"""

import math
from typing import NamedTuple

import numpy as np

from lightopt.core.arrays import Float32, Float64, Index, Int16, Int32, UInt8
from lightopt.core.kernels import kernel
from lightopt.defects import FORESHORTENINGS
from lightopt.design.responses._pairs import Words

CODES_PER_DEVIATION = 16  # changes are stored as whole numbers of 16 bits: of walls that glint, many deviations
_MANY = 255  # code of changes that are bounded by nothing
_AT_ONCE = 256  # patches whose evidence is added up together
_ROUNDING = 1.001  # bounds are this much greater than needed: sums are rounded
_Changes = tuple[Int16, Float32]  # codes and bounds, as :func:`evidence_flags` has them
_Reach = tuple[UInt8, UInt8]  # most change of each patch, and of what a defect's pixels may see around each cell


class Stencils(NamedTuple):
    """What pixels see of each planned defect h in each class c of foreshortening."""

    # pixels of group g = h · classes + c are those from first[g] to first[g + 1], shape (groups + 1,); those that see
    # most of the defect come first
    first: Int32
    # steps to the right and down between the segments of a long defect that are tested, 0 for one that is tested whole,
    # shape (groups, 2)
    along: Float32
    right: Float32  # of the pixel from the defect's middle, shape (n,)
    down: Float32  # likewise
    piece: Int32  # pieces in pixel i are those from piece[i] to piece[i + 1], shape (n + 1,)
    variant: Int32  # of the piece, shape (m,)
    share: Float32  # how much of its pixel the piece is, shape (m,)
    ratio: Float32  # side of these pixels by that of the camera's, shape (groups,)
    square: Float64  # Σ (share of the pixel in the defect)², shape (groups,)

    def in_cells(self, cell: float) -> "Stencils":
        """The same with lengths in cells of so many of their unit."""
        return self._replace(**{name: in_cells(getattr(self, name), cell) for name in ("along", "right", "down")})


def in_cells(lengths: Float32 | Float64, cell: float) -> Float32:
    """Lengths in cells of so many of their unit."""
    return (lengths.astype(np.float32) / np.float32(cell)).astype(np.float32)


class ImagePatches(NamedTuple):
    """The p patches of a posture in its image."""

    column: Float32  # columns of their middles [cells], shape (p,)
    row: Float32  # rows of their middles [cells], shape (p,)
    owner: Int32  # patch that each cell of the image sees, −1 for none, shape (rows, columns)
    cell: float  # side of a cell [px]
    classes: Int32  # of foreshortening, shape (p,); patches of a class follow each other where that is to be fast
    angle: Float64  # from the image's axes to those that turns are counted from [rad], shape (p,)
    pad: int = 0  # cells around the image that see no patch

    def in_order(self, order: Index) -> "ImagePatches":
        number = np.empty(len(order) + 1, np.int32)
        number[order], number[-1] = np.arange(len(order)), -1
        column, row, owner, _, classes, angle, _ = self
        own = {"column": column[order], "row": row[order], "classes": classes[order], "angle": angle[order]}
        return self._replace(owner=number[owner], **own)


class PlannedTurns(NamedTuple):
    """The hypotheses h, entry after entry."""

    entry: Int32  # of each, shape (h,)
    turns: Int32  # of each entry, shape (entries,)
    variants: Int32  # those of entry e are from variants[e] to variants[e + 1], shape (entries + 1,)


@kernel
def owner_at(column: float, row: float, owner: Int32) -> int:
    """The patch that a place in the image sees [cells], −1 for none."""
    if column < 0.0 or row < 0.0 or column >= owner.shape[1] or row >= owner.shape[0]:
        return -1
    return owner[int(row), int(column)]


def evidence_flags(
    codes: Int16, bounds: Float32, image: ImagePatches, planned: PlannedTurns, stencils: Stencils, limits: Float64
) -> Words:
    """Flags of the units of evidence, shape (units, p, words).

    codes: Changes by the variants, and those of no patch, which are 0, shape (t, p + 1)
    bounds: What the camera delivers of them, of each entry or alike for all, shape (entries or 1, p + 1, 3)
    stencils: In cells
    limits: Evidence from which on an image counts for one unit and more, shape (entries, units)
    """
    patches = len(image.classes)
    most = np.zeros((len(planned.turns), patches + 1), np.uint8)
    _fill_most(codes, bounds, planned.variants, most)
    reach = np.maximum(np.abs(stencils.right), np.abs(stencils.down))
    pad = int(reach.max(initial=0.0)) + 1
    # what sees no patch sees the last one, which changes nothing
    padded = np.full([side + 2 * pad for side in image.owner.shape], patches, np.int32)
    padded[pad:-pad, pad:-pad] = np.where(image.owner < 0, patches, image.owner)
    near = most[:, padded]
    groups = np.cumsum([0, *planned.turns]) * FORESHORTENINGS
    for e in range(len(most)):
        begin, end = (stencils.first[groups[i]] for i in (e, e + 1))
        near[e] = greatest_within(near[e], int(reach[begin:end].max(initial=0.0)) + 1)
    image = image._replace(owner=padded, pad=pad)
    found = _evidence((codes, bounds), image, planned.entry, stencils, limits, (most, near))
    return _flags(found, image, planned.turns, stencils.along, limits)


def greatest_within(cells: UInt8, radius: int) -> UInt8:
    """The greatest of the cells at most so many rows and columns away, of each cell."""
    for _ in range(2):
        # of 1, 2, 4, … cells in a row, then of two such windows that together are as wide as wanted
        side, width = len(cells), 1
        most = np.zeros((side + 2 * radius, cells.shape[1]), np.uint8)
        most[radius : radius + side] = cells
        while 2 * width <= 2 * radius + 1:
            most = np.maximum(most[:-width], most[width:])
            width *= 2
        cells = np.ascontiguousarray(np.maximum(most[:side], most[-side:]).T)
    return cells


@kernel
def _fill_most(codes: Int16, bounds: Float32, variants: Int32, most: UInt8) -> None:
    # most change that the variants of each entry make of each patch, in codes; 0 where the camera delivers too little
    # of it to count, and 255 for that much and more
    low, high = np.empty(codes.shape[1], np.int16), np.empty(codes.shape[1], np.int16)
    for e in range(len(most)):
        low[:] = high[:] = 0
        own = bounds[min(e, len(bounds) - 1)]
        for v in range(variants[e], variants[e + 1]):
            for p in range(len(low)):
                low[p] = min(low[p], codes[v, p])
            for p in range(len(high)):
                high[p] = max(high[p], codes[v, p])
        for p in range(len(low)):
            delivered = max(
                min(high[p] / np.float32(CODES_PER_DEVIATION), own[p, 1]),
                -max(low[p] / np.float32(CODES_PER_DEVIATION), own[p, 0]),
            )
            none = delivered < own[p, 2] or delivered == 0.0
            most[e, p] = 0 if none else min(_MANY, max(np.int64(high[p]), -np.int64(low[p])))


@kernel
def _cell(place: float, side: int, pad: int) -> np.uint64:
    # row or column of an array of cells with a margin; indices without a sign need no test for those from the end
    return np.uint64(max(0, min(side - 1, pad + int(np.floor(place)))))


@kernel
def _evidence(
    changes: _Changes, image: ImagePatches, entry: Int32, stencils: Stencils, limits: Float64, reach: _Reach
) -> Float32:
    # Evidence of each defect in each turn as the image counts it: up to what is enough, 0 where it is too little.
    # Patches of a class see the same pixels of a defect: pixel after pixel is added for all of them that have not yet
    # enough, without branches
    (codes, bounds), (most, near) = changes, reach
    first, _, right, down, piece, variant, share, ratio, square = stencils
    columns, rows, owner, _, classes, _, pad = image
    height, width = owner.shape
    found = np.zeros((len(entry), len(classes) + 1), np.float32)
    active, energies = np.empty(_AT_ONCE, np.uint64), np.empty(_AT_ONCE, np.float32)
    start = 0
    while start < len(classes):
        end = start + 1
        while end < min(len(classes), start + _AT_ONCE) and classes[end] == classes[start]:
            end += 1
        for h in range(len(found)):
            e, group = entry[h], h * FORESHORTENINGS + classes[start]
            delivered = bounds[min(e, len(bounds) - 1)]
            # in units of a pixel
            area = ratio[group] * ratio[group]
            enough = np.float32(limits[e, limits.shape[1] - 1]) / area
            least = CODES_PER_DEVIATION**2 * limits[e, 0] / (_ROUNDING * area * square[group])
            count = 0
            for p in range(start, end):
                change = np.int64(max(most[e, p], near[e, _cell(rows[p], height, pad), _cell(columns[p], width, pad)]))
                energies[p - start], active[count] = 0.0, p
                count += change * change >= least or change == _MANY
            for i in range(first[group], first[group + 1]):
                here_right, here_down = right[i], down[i]
                own = max(abs(here_right), abs(here_down)) < np.float32(0.5)
                left = np.uint64(0)
                for k in range(np.uint64(count)):
                    p = q = active[k]
                    if not own:
                        y, x = _cell(rows[p] + here_down, height, pad), _cell(columns[p] + here_right, width, pad)
                        q = np.uint64(owner[y, x])
                    change = np.float32(0.0)
                    for n in range(np.uint64(piece[i]), np.uint64(piece[i + 1])):
                        change += share[n] * np.float32(codes[np.uint64(variant[n]), q])
                    change /= np.float32(CODES_PER_DEVIATION)
                    change = max(min(change, delivered[q, np.uint64(1)]), delivered[q, np.uint64(0)])
                    more = change * change if abs(change) > delivered[q, np.uint64(2)] else np.float32(0.0)
                    energy = energies[p - np.uint64(start)] + more
                    energies[p - np.uint64(start)] = energy
                    active[left] = p
                    left += np.uint64(energy < enough)
                count = np.int64(left)
                if count == 0:
                    break
            for p in range(start, end):
                found[h, p] = energies[p - start] * area
        start = end
    return found


@kernel
def _flags(found: Float32, image: ImagePatches, turns: Int32, along: Float32, limits: Float64) -> Words:
    # the greatest along each defect: what its segments have is what the patches that they lie on have
    columns, rows, owner, _, classes, angle, pad = image
    height, width = owner.shape
    words = np.zeros((limits.shape[1], len(classes), (len(found) + 63) // 64), np.uint64)
    energies, turn = np.empty(len(classes), np.float32), np.empty(len(classes), np.int32)
    first = 0
    for e in range(len(turns)):
        count, enough = turns[e], limits[e, limits.shape[1] - 1]
        for p in range(len(turn)):
            # the same turn as the image counts it
            turn[p] = int(np.rint(angle[p] / math.pi * count)) % count if count > 1 else 0
        for h in range(first, first + count):
            for p in range(len(turn)):
                own = first + turn[p]
                turn[p] = turn[p] + 1 if turn[p] + 1 < count else 0
                energy = found[own, p]
                if energy < enough:
                    group = own * FORESHORTENINGS + classes[p]
                    dx, dy = along[group, 0], along[group, 1]
                    if dx != 0.0 or dy != 0.0:
                        for side in (-2, -1, 1, 2):
                            y, x = _cell(rows[p] + side * dy, height, pad), _cell(columns[p] + side * dx, width, pad)
                            energy = max(energy, found[own, owner[y, x]])
                energies[p] = energy
            for unit in range(len(words)):
                limit, bit = limits[e, unit], np.uint64(h % 64)
                for p in range(len(energies)):
                    words[unit, p, h // 64] |= np.uint64(energies[p] >= limit) << bit
        first += count
    return words
