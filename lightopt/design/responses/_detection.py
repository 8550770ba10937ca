"""When a defect is visible in an image: its level differs from the good surface's by more than the sensor's noise.

With v the level that the sensor would deliver before rounding, ``black + exposure · scale · I`` clipped at the
saturation level, v₀ of the good surface and v_d of the defect, a hypothesis is visible where

    |v_d − v₀| ≥ threshold · √(read noise² + (v₀ − black) / electrons per level + 1/12),

the noise of read-out, of photons and of rounding (EMVA Standard 1288, release 4.0, section 2) at the good surface's
level: it decides how often a good surface is taken for a defect. Where both are saturated the difference is 0. A
pixel that the defect does not fill sees the defect and its surroundings; walls that face each other cancel in part:

    I_d = I₀ + F · (D − M) + A · M,   D = I_wall − I₀,

with M the mean of D over the directions of the defect's walls, and the shares F and A of the two pixels that may show
it best (:mod:`lightopt.defects._pixel_shares`); a hypothesis is visible where one of them shows it. The shares depend
on the side of the pixel's footprint over the defect's width. The footprint is taken as a square of its area on the
surface; its side is that on a plane facing the camera / √cosθ, with θ between normal and view. Surface seen at a
grazing angle (:data:`lightopt.rendering.GRAZING_DEG`) is excluded before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64, Int64
from lightopt.core.errors import InputError
from lightopt.core.kernels import kernel
from lightopt.core.transforms import Posture
from lightopt.defects import PIXEL_RATIOS, DefectShape, pixel_shares, tangent_references
from lightopt.design.responses._defect_hypotheses import DefectHypothesis
from lightopt.design.responses._packed_bits import Words
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight
from lightopt.optics import Sensor
from lightopt.rendering import SurfacePoints, converged_panel, shade_variants, surface_variants
from lightopt.scene import Scene, pixel_footprint, view_from_part

# Default multiple of the noise by which a level must be off. Of the two million pixels of an image noise alone takes
# one for a defect at 5, and five thousand at 3. Rose found the same 5 for what people make out in pictures (J. Opt.
# Soc. Am. 38, 1948, doi:10.1364/JOSA.38.000196).
DEFAULT_CONTRAST = 5.0


LEAST_RATIO, GREATEST_RATIO = float(PIXEL_RATIOS[0]), float(PIXEL_RATIOS[-1])
_AT_ONCE = 256  # patches whose levels are in the processor's nearest caches together
PER_OCTAVE = (len(PIXEL_RATIOS) - 1) / math.log2(GREATEST_RATIO / LEAST_RATIO)


def threshold_problem(threshold: float) -> str | None:
    """What is wrong with a multiple of the noise; None where nothing is."""
    if math.isfinite(threshold) and threshold > 0.0:
        return None
    return f"option 'threshold': expected a number above 0, times the sensor's noise, found {threshold:g}"


@dataclass(frozen=True, kw_only=True)
class Contrast:
    """The contrast at which a defect is visible to the sensor.

    full_scale: Grey level that makes a full-scale sensor level at exposure 1.
    threshold: Multiple of the noise.
    Raises InputError: A threshold that is not above 0.
    """

    sensor: Sensor
    full_scale: float
    threshold: float = DEFAULT_CONTRAST

    def __post_init__(self) -> None:
        if problem := threshold_problem(self.threshold):
            raise InputError(problem)


# Bits of the visible hypotheses on k patches from number `start` on, shape (k, words): of linear levels where the
# surface is good and where a hypothesis fills the pixel [grey level at exposure 1], shapes (k,) and (t, k), and of the
# shares of _pixel_shares. The processor works on several patches at once in loops without branches.
@kernel
def _contrast_words(
    good: Float64,
    varied: Float64,
    first: Int64,
    facing: Bool,
    shares: Float64,
    start: int,
    scale: float,
    black: float,
    saturation: float,
    threshold: float,
    read_noise: float,
    electrons: float,
) -> Words:
    tries, count = varied.shape
    words = np.zeros((count, (tries + 63) // 64), np.uint64)
    rows, flags = np.zeros(9 * _AT_ONCE), np.zeros(_AT_ONCE, np.uint64)
    for begin in range(0, count, _AT_ONCE):
        number = min(_AT_ONCE, count - begin)
        for j in range(number):
            rows[j] = good[begin + j]
        for j in range(number):
            level = min(black + scale * rows[j], saturation)
            noise = math.sqrt(read_noise * read_noise + (level - black) / electrons + 1.0 / 12.0)
            rows[_AT_ONCE + j], rows[2 * _AT_ONCE + j] = level, threshold * noise
        for e in range(len(facing)):
            most = first[e + 1] - first[e]
            for j in range(number):
                for n in range(4):
                    rows[(4 + n) * _AT_ONCE + j] = shares[e, n, start + begin + j]
            if not facing[e]:
                _average(varied, first[e], first[e + 1], 1, begin, number, rows)
            for t in range(first[e], first[e + 1]):
                if facing[e]:
                    opposite = first[e] + (t - first[e] + most // 2) % most
                    low, high = min(t, opposite), max(t, opposite)
                    _average(varied, low, high + 1, high - low, begin, number, rows)
                _test(varied, t, begin, number, scale, black, saturation, rows, flags)
                if t % 64 == 63 or t == tries - 1:
                    for j in range(number):
                        words[begin + j, t // 64] = flags[j]
                        flags[j] = 0
    return words


@kernel
def _average(varied: Float64, low: int, high: int, step: int, begin: int, number: int, rows: Float64) -> None:
    # the mean level of every so many of the hypotheses from `low` to `high`, into the fourth row
    count = (high - low + step - 1) // step
    for j in range(number):
        rows[3 * _AT_ONCE + j] = 0.0
    for t in range(low, high, step):
        for j in range(number):
            rows[3 * _AT_ONCE + j] += varied[t, begin + j] / count


@kernel
def _test(
    varied: Float64,
    t: int,
    begin: int,
    number: int,
    scale: float,
    black: float,
    saturation: float,
    rows: Float64,
    flags: Words,
) -> None:
    # sets the flag of hypothesis t where it is visible. Rows: the surface's linear and delivered level, the least
    # difference that is visible, the mean level of the walls that share the pixel, the shares, and the wall's level
    bit = np.uint64(1) << np.uint64(t % 64)
    for j in range(number):
        rows[8 * _AT_ONCE + j] = varied[t, begin + j]
    for j in range(number):
        good, level, least = rows[j], rows[_AT_ONCE + j], rows[2 * _AT_ONCE + j]
        common = rows[3 * _AT_ONCE + j] - good
        own = rows[8 * _AT_ONCE + j] - good - common
        best = good + rows[4 * _AT_ONCE + j] * own + rows[5 * _AT_ONCE + j] * common
        other = good + rows[6 * _AT_ONCE + j] * own + rows[7 * _AT_ONCE + j] * common
        off = abs(min(black + scale * best, saturation) - level)
        other_off = abs(min(black + scale * other, saturation) - level)
        flags[j] |= bit if max(off, other_off) >= least else np.uint64(0)


@kernel
def _pixel_shares(tables: Float64, widths: Float64, footprints: Float64, cosines: Float64) -> Float64:
    # shares of the pixel that e defects fill, by a pixel's footprint on a plane that faces the camera [mm]; (e, 4, k)
    found = np.empty((len(widths), 4, len(footprints)))
    for i in range(len(footprints)):
        side = footprints[i] / math.sqrt(cosines[i])
        for e in range(len(widths)):
            found[e, 0, i], found[e, 1, i], found[e, 2, i], found[e, 3, i] = _shares(tables[e], side / widths[e])
    return found


@kernel
def _shares(table: Float64, ratio: float) -> tuple[float, float, float, float]:
    # between the tabulated ratios, linear in their logarithm; below them the defect fills the pixel, beyond
    # them its share falls as the pixel's area grows
    place = PER_OCTAVE * math.log2(ratio / LEAST_RATIO)
    if place < 0.0:
        return 1.0, 1.0, 1.0, 1.0
    last = len(table) - 1
    if place >= last:
        less = (GREATEST_RATIO / ratio) ** 2
        return less * table[last, 0], less * table[last, 1], less * table[last, 2], less * table[last, 3]
    at = int(place)
    rest = place - at
    low, high = table[at], table[at + 1]
    return (
        low[0] + rest * (high[0] - low[0]),
        low[1] + rest * (high[1] - low[1]),
        low[2] + rest * (high[2] - low[2]),
        low[3] + rest * (high[3] - low[3]),
    )


@dataclass(frozen=True, kw_only=True)
class DetectionModel:
    """The defect hypotheses that images are tested for, and the contrast at which one is visible."""

    hypotheses: tuple[DefectHypothesis, ...]
    contrast: Contrast

    @cached_property
    def pixel_fill(self) -> tuple[Int64, Bool, Float64, Float64]:
        """How far e defects fill a pixel; the hypotheses of a defect are adjacent.

        Index of each defect's first hypothesis and the number of hypotheses, shape (e + 1,); whether only walls that
        face each other share a pixel, as a scratch's two do, or else those of all directions, shape (e,); widths [mm],
        shape (e,); shares from :func:`lightopt.defects.pixel_shares`, shape (e, n, 4).
        """
        # hypotheses of a defect differ by weight and direction only
        groups = [
            list(some) for _, some in groupby(self.hypotheses, key=lambda one: replace(one, weight=0, direction=0.0))
        ]
        defects = [some[0] for some in groups]
        shapes = [DefectShape(kind=one.kind, length=one.length, width=one.width, slope=one.slope) for one in defects]
        return (
            np.cumsum([0, *map(len, groups)]).astype(np.int64),
            np.array([defect.kind == "scratch" for defect in defects], np.bool_),
            np.array([defect.width for defect in defects]),
            np.stack([pixel_shares(shape) for shape in shapes]),
        )


class PatchDetection:
    """The inspectable patches of a posture, tested for defects."""

    def __init__(self, scene: Scene, surface: SurfacePoints, posture: Posture, detection: DetectionModel) -> None:
        self.detection = detection
        self.reflectance = scene.reflectance
        cosines = np.einsum("ij,ij->i", surface.normals, surface.views)
        camera = view_from_part(scene, posture).camera
        footprints = pixel_footprint(camera, 1.0) * ((surface.points - camera.position) @ camera.forward)
        self._first, self._facing, widths, tables = detection.pixel_fill
        self._shares = _pixel_shares(tables, widths, footprints, cosines)
        # the mesh file's axes in the part's frame
        axes = scene.placement.rotation
        self._references = tangent_references(surface.normals, x_axis=axes[:, 0], y_axis=axes[:, 1])
        hypotheses = detection.hypotheses
        self._variants = surface_variants(
            slope=np.array([hypothesis.slope for hypothesis in hypotheses]),
            direction=np.array([hypothesis.direction for hypothesis in hypotheses]),
            R_d_factor=np.array([hypothesis.R_d_factor for hypothesis in hypotheses]),
            sigma_factor=np.array([hypothesis.sigma_factor for hypothesis in hypotheses]),
            reflectance=scene.reflectance,
        )

    def evaluate(
        self,
        block: SurfacePoints,
        panel: PanelLight,
        here: slice,
        caster: RayCaster,
        blocker: RayCaster | None,
        exposures: Sequence[float],
    ) -> tuple[Float32, list[Words]]:
        """Levels of a block of patches, and which hypotheses an image at each exposure shows on them."""
        shaded = shade_variants(
            block,
            self._references[here],
            converged_panel(panel, centre=caster.centre, radius=caster.radius) if panel.points == "auto" else panel,
            self._variants,
            reflectance=self.reflectance,
            caster=blocker,
        )
        contrast = self.detection.contrast
        sensor = contrast.sensor
        return shaded.plain, [
            _contrast_words(
                shaded.good,
                shaded.varied,
                self._first,
                self._facing,
                self._shares,
                here.start,
                exposure * sensor.max_level / contrast.full_scale,
                sensor.black_level,
                sensor.saturated_from,
                contrast.threshold,
                sensor.read_noise_levels,
                sensor.electrons_per_level or math.inf,
            )
            for exposure in exposures
        ]
