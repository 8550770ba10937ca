"""Whole defects as hypotheses: what each pixel around the middle of a defect sees of it.

An entry of the catalogue stands for defects of several sizes and orientations. Of a long scratch a segment is tested;
segments in a row are one scratch. Each piece of a defect makes the surface one of few variants: its normal leans by a
level of slope in one of several directions, or its reflectance is another. A pixel sees a mixture of variants.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64, Index, Int32, Int64
from lightopt.core.kernels import kernel
from lightopt.defects._shape import (
    SHAPE_KINDS,
    SIZES,
    CatalogueEntry,
    DefectShape,
    Profile,
    gradient_in_outline,
    place_in_outline,
    profile_of,
)

# cosines of the angle to the normal in so many steps of this ratio, and directions within half a turn
FORESHORTENING, COSINES, AZIMUTHS = 0.85, 11, 8

FORESHORTENINGS = COSINES * AZIMUTHS  # number of classes


def image_axes(views: Float64, right: Float64) -> tuple[Float64, Float64]:
    """Unit vectors to the right and up in the image, at right angles to the views, each of shape (k, 3).

    views: Unit vectors from the surface to the camera, shape (k, 3)
    right: The camera's, shape (3,)
    """
    across = right - (views @ right)[:, None] * views
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return across, np.cross(views, across).astype(np.float64)


def tangent_axis(normals: Float64, right: Float64) -> Float64:
    """The image's right in tangent planes, which turns of defects are counted from towards N × it, shape (k, 3)."""
    axis = right - np.einsum("ij,ij->i", right, normals)[:, None] * normals
    return axis / np.linalg.norm(axis, axis=1, keepdims=True)


def foreshortening_classes(normals: Float64, views: Float64, right: Float64, up: Float64) -> Index:
    """The class of each point of a surface, shape (k,); `right` and `up` from :func:`image_axes`."""
    x, y, z = (np.einsum("ij,ij->i", normals, axis) for axis in (right, up, views))
    cosine = np.clip(np.rint(np.log(np.maximum(z, 1e-6)) / math.log(FORESHORTENING)), 0, COSINES - 1)
    azimuth = np.rint(np.arctan2(y, x) / math.pi * AZIMUTHS) % AZIMUTHS
    return (cosine * AZIMUTHS + np.where(cosine > 0, azimuth, 0)).astype(np.intp)


def plane_to_image(foreshortening: int, footprint: float) -> Float64:
    """Pixels to the right and down by mm along the axes of a class' tangent plane, shape (2, 2).

    footprint: Side of a pixel on a plane that faces the camera [mm]
    """
    steps, azimuth = divmod(foreshortening, AZIMUTHS)
    cosine = FORESHORTENING**steps
    sine, angle = math.sqrt(1.0 - cosine**2), math.pi * azimuth / AZIMUTHS
    normal = np.array([[sine * math.cos(angle), sine * math.sin(angle), cosine]])
    first = tangent_axis(normal, np.array([[1.0, 0.0, 0.0]]))[0]
    second = np.cross(normal[0], first)
    return np.array([[first[0], second[0]], [-first[1], -second[1]]]) / footprint


ELLIPSE_TURNS = 4
SEGMENT_LENGTH = 6.0  # of a scratch a segment of so many widths is tested
ROUND = 1.5  # an outline that is less than so many times as long as wide is tested as a round one of the same area
WALL_LEVELS = (1.0,)

# points that a pixel is sampled at along each side: so many across the defect's width, within these limits
ACROSS_WIDTH, LEAST_SAMPLES, MOST_SAMPLES = 10.0, 3, 15

# a disc that the lens blurs over is left out where it is this narrow, and is sampled at so many places at most [px]
_LEAST_BLUR_PX, _MOST_PLACES = 0.1, 48

_MOST_FINER = 2  # directions are doubled so often at most
LEAST_SHARE = 0.06  # a variant with less than this share of the greatest one of any pixel is left out


@dataclass(frozen=True, kw_only=True)
class HypothesisGrid:
    """How finely surfaces that lean are told apart."""

    directions: int  # that a wall leans to, at least
    fine_slope: float  # steeper walls lean to twice or four times as many [rad]: what they reflect turns by more
    segment_turns: int  # orientations of a scratch within half a turn; each has walls that lean to both sides
    bowl_levels: tuple[float, ...]  # slopes of bowls by the steepest; what is less than half of the least is flat


INSPECTION_GRID = HypothesisGrid(
    directions=16, fine_slope=math.inf, segment_turns=16, bowl_levels=(1.0 / 3.0, 2.0 / 3.0, 1.0)
)
"""Of templates that images are compared with."""

PLANNING_GRID = HypothesisGrid(directions=8, fine_slope=math.radians(4.5), segment_turns=8, bowl_levels=(0.5, 1.0))
"""Of expected evidence: levels may be coarser where they are added up and not compared."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PixelMixture:
    """What pixels see of a defect, n pieces; those of a pixel follow each other."""

    row: Int32  # of the pixel, from that of the defect's middle, shape (n,)
    column: Int32  # likewise
    variant: Int32  # index among the variants of the hypotheses, shape (n,)
    weight: Float64  # share of the pixel, shape (n,)


@dataclass(frozen=True, eq=False, kw_only=True)
class DefectHypotheses:
    entry: CatalogueEntry
    shapes: tuple[DefectShape, ...]  # one for each of :data:`SIZES`; of a scratch the segment
    turns: Float64  # of the length, from the first axis of the tangent plane towards the second [rad], shape (n,)
    levels: tuple[float, ...]  # of the slope, as shares of the steepest
    slope: Float64  # by which the normal leans in each variant [rad], shape (t,)
    direction: Float64  # to which it leans [rad], shape (t,); for each level all directions
    R_d_factor: Float64  # of each variant, shape (t,)
    sigma_factor: Float64  # of each variant, shape (t,)

    def scales_px(self, footprint: float) -> tuple[float, ...]:
        """Widths of Gaussians that add up as many pixels as the shapes; `footprint` is the side of a pixel [mm]."""
        return tuple(0.25 * math.sqrt(one.length * one.width) / footprint for one in self.shapes)

    def seen_by_pixels(
        self, size: int, turn: int, to_image: Float64, *, off_px: tuple[float, float] = (0.0, 0.0), blur_px: float = 0.0
    ) -> PixelMixture:
        """What pixels see of a defect.

        size, turn: Indices of the shape and of the turn
        to_image: Pixels to the right and down by mm along the axes of the tangent plane, shape (2, 2)
        off_px: How far to the right and down the defect's middle is from that of its pixel
        blur_px: Diameter of the disc that the lens makes of a point
        """
        shape, angle = self.shapes[size], float(self.turns[turn])
        along = np.array([math.cos(angle), math.sin(angle)])
        across = np.array([-along[1], along[0]])
        # half the sides of the outline's box in the image
        half = np.abs(to_image @ along) * 0.5 * shape.length + np.abs(to_image @ across) * 0.5 * shape.width
        half = half + 0.5 * blur_px
        right, down = (math.floor(side + 0.5 + abs(off)) for side, off in zip(half, off_px, strict=True))
        width = shape.width * math.sqrt(abs(float(np.linalg.det(to_image))))
        samples = min(MOST_SAMPLES, max(LEAST_SAMPLES, math.ceil(ACROSS_WIDTH / width)))
        disc = _disc(blur_px)
        if len(disc[0]) > 1:  # whose places sample pixels, too
            samples = LEAST_SAMPLES
        row, column, variant, count = _sample_pixels(
            profile_of(shape),
            (down, right),
            np.stack([along, across]) @ np.linalg.inv(to_image),
            off_px,
            disc,
            samples,
            angle,
            np.array(self.levels),
            len(self.slope) // len(self.levels),
        )
        keep = count >= LEAST_SHARE * count.max(initial=0)
        weight = count[keep] / (samples**2 * len(disc[0]))
        return PixelMixture(row=row[keep], column=column[keep], variant=variant[keep], weight=weight)


@kernel
def _sample_pixels(
    profile: Profile,
    reach: tuple[int, int],
    to_defect: Float64,
    off: tuple[float, float],
    disc: tuple[Float64, Float64],
    samples: int,
    turn: float,
    levels: Float64,
    directions: int,
) -> tuple[Int32, Int32, Int32, Int64]:
    # Samples of each pixel that see each variant, where some do: rows, columns, variants and their number.
    # to_defect: place along and across the defect by pixels to the right and down. A wall that is less steep than half
    # of the least level is flat
    down, right = reach
    most = (2 * down + 1) * (2 * right + 1) * min(len(levels) * directions, samples * samples * len(disc[0]))
    rows, columns = np.empty(most, np.int32), np.empty(most, np.int32)
    variants, numbers = np.empty(most, np.int32), np.empty(most, np.int64)
    count, n, steepest = np.zeros(len(levels) * directions, np.int64), 0, abs(profile.rise)
    for row in range(-down, down + 1):
        for column in range(-right, right + 1):
            for i in range(samples * samples):
                inner_y, inner_x = (i // samples + 0.5) / samples - 0.5, (i % samples + 0.5) / samples - 0.5
                for k in range(len(disc[0])):
                    px, py = disc[0][k] + column + inner_x - off[0], disc[1][k] + row + inner_y - off[1]
                    x, y = to_defect[0, 0] * px + to_defect[0, 1] * py, to_defect[1, 0] * px + to_defect[1, 1] * py
                    if place_in_outline(profile, x, y) >= 1.0:
                        continue
                    if steepest == 0.0:
                        count[0] += 1
                        continue
                    along, across = gradient_in_outline(profile, x, y)
                    share = math.hypot(along, across) / steepest
                    if share < 0.5 * levels[0]:
                        continue
                    level = 0
                    for other in range(1, len(levels)):
                        if abs(share - levels[other]) < abs(share - levels[level]):
                            level = other
                    # the normal leans down the slope
                    lean = (math.atan2(-across, -along) + turn) * directions / (2.0 * math.pi)
                    count[level * directions + int(np.rint(lean)) % directions] += 1
            for variant in range(len(count)):
                if count[variant] > 0:
                    rows[n], columns[n], variants[n], numbers[n] = row, column, variant, count[variant]
                    count[variant] = 0
                    n += 1
    return rows[:n].copy(), columns[:n].copy(), variants[:n].copy(), numbers[:n].copy()


def _disc(diameter: float) -> tuple[Float64, Float64]:
    # places that are spread evenly over a disc (Vogel 1979); the middle alone for next to none
    count = 1 if diameter < _LEAST_BLUR_PX else min(_MOST_PLACES, 6 * math.ceil(1.0 + diameter))
    number = np.arange(count)
    radius = 0.5 * diameter * np.sqrt((number + 0.5) / count) * (count > 1)
    angle = number * math.pi * (3.0 - math.sqrt(5.0))
    return radius * np.cos(angle), radius * np.sin(angle)


def defect_hypotheses(entry: CatalogueEntry, grid: HypothesisGrid = INSPECTION_GRID) -> DefectHypotheses:
    shape = entry.shape
    levels, turns = WALL_LEVELS, 1
    finer = math.ceil(math.log2(max(shape.slope, 1e-9) / grid.fine_slope)) if math.isfinite(grid.fine_slope) else 0
    directions = grid.directions << min(max(finer, 0), _MOST_FINER)
    if shape.kind == "scratch":
        turns, directions = grid.segment_turns, 2 * grid.segment_turns
        shape = replace(shape, length=min(shape.length, SEGMENT_LENGTH * shape.width))
    elif shape.length >= ROUND * shape.width:
        turns = ELLIPSE_TURNS
    else:
        side = math.sqrt(shape.length * shape.width)
        shape = replace(shape, length=side, width=side)
    if shape.kind in ("dent", "bump", "blister"):
        levels = grid.bowl_levels
    if shape.kind not in SHAPE_KINDS:
        levels, directions = (0.0,), 1
    slope = np.arctan(math.tan(shape.slope) * np.repeat(levels, directions))
    shapes: list[DefectShape] = []
    for size in SIZES:
        width = size * shape.width
        # a narrower scratch is no shorter
        length = max(width, shape.length if shape.kind == "scratch" else size * shape.length)
        shapes.append(replace(shape, length=length, width=width))
    return DefectHypotheses(
        entry=entry,
        shapes=tuple(shapes),
        turns=np.arange(turns) * math.pi / turns,
        levels=levels,
        slope=slope,
        direction=np.tile(np.arange(directions) * 2.0 * math.pi / directions, len(levels)),
        R_d_factor=np.full(len(slope), shape.R_d_factor),
        sigma_factor=np.full(len(slope), shape.sigma_factor),
    )


# The narrowest size of a defect is so many pixels wide, and the middle size of a scratch; where they would be wider,
# the pixels are larger, up to so many times
_WIDTH_PX, _SCRATCH_PX, _MOST_RATIO = 8.0, 2.2, 15

_STEPS_PER_WIDTH = 8.0  # places to test are an eighth of the middle size's width apart

# Middles of defects less than so many pixels wide are sought between pixels, too: on a smaller part of their width
_FINE_PX, _HALVES = 5.0, ((0.0, 0.0), (0.5, 0.5), (0.5, 0.0), (0.0, 0.5))


@dataclass(frozen=True, kw_only=True)
class SearchGrid:
    ratio: int  # side of the larger pixels that images are reduced to [px]
    step: int  # places to test are so many of them apart
    halves: tuple[tuple[float, float], ...]  # places of the middle within its pixel, to the right and down


def search_grid(own: DefectHypotheses, footprint: float, blur_px: float = 0.0) -> SearchGrid:
    """Where hypotheses are tested.

    footprint: Side of a pixel on a plane that faces the camera [mm]
    blur_px: Diameter of the disc that the lens makes of a point, which makes defects wider
    """
    long = own.entry.shape.kind == "scratch"
    narrow, middle = (math.hypot(shape.width / footprint, blur_px) for shape in own.shapes[:2])
    ratio = max(1, min(round(middle / _SCRATCH_PX if long else narrow / _WIDTH_PX), _MOST_RATIO))
    middle_px = math.hypot(own.shapes[1].width / (ratio * footprint), blur_px / ratio)
    # along a scratch its place matters little
    halves = _HALVES[: (2 if long else 4) if middle_px < _FINE_PX else 1]
    return SearchGrid(ratio=ratio, step=max(1, int(middle_px / _STEPS_PER_WIDTH)), halves=halves)
