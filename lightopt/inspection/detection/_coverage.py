"""Coverage: share of the surface that was inspected, its sensitivity, and the reasons for the rest.

Of the pixels of each posture first, then of the part's surface over all postures, each place of it counted once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import Any, Final

import numpy as np
from scipy import special

from lightopt.core.arrays import Bool, Float32, Float64, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.transforms import Posture
from lightopt.geometry import face_areas
from lightopt.inspection._image_blocks import in_row_blocks
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._residual_score import deviation_of_score, disc_gain
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._predict import SurfaceMap
from lightopt.scene import Scene

CONTRASTS: Final = (0.05, 0.1, 0.2, 0.4)
"""Shares of the light that a defect takes away, for which the sensitivity is reported."""

REFERENCE_DISC_PX = 5.0  # diameter of the even disc that it is reported for
REFERENCE_CONTRAST: Final = 0.2
REFERENCE_DEFECT: Final = (
    f"a disc of {REFERENCE_DISC_PX:g} px that changes the light by {100.0 * REFERENCE_CONTRAST:g} %"
)
"""A defect that is reported as found or not beside the share that was inspected."""


class SurfaceState(IntEnum):
    """Class of a place by the result of its inspection, the least first; over several postures the best counts.

    What is seen at a grazing angle only (:data:`lightopt.rendering.GRAZING_DEG`) is left out of all shares.

    What is lit in fewer images than must show a defect, or is only reached by light and stays dark, is judged by these,
    as the detector does it. No pixel is missing, only patches of the surface:
    images show them at an edge at most, and a posture without images would show them better.
    """

    NO_PART = 0
    GRAZING = 1
    EDGE = 2
    MISSING = 3
    SHADOW = 4
    SATURATED = 5
    GLINTS = 6
    FEWER = 7
    INSPECTED = 8


# as plain numbers, for the kernel
_NO_PART, _GRAZING, _EDGE, _, _SHADOW, _SATURATED, _GLINTS, _FEWER, _INSPECTED = (int(state) for state in SurfaceState)
_STATES = len(SurfaceState)


@dataclass(frozen=True, kw_only=True)
class Shares:
    """Areas of a surface by class: the defects that a place can show, or the reason why it shows none."""

    seen: float  # by the camera, not at a grazing angle [mm²]
    inspected: float  # of it, judged [mm²]: the areas of :attr:`classes`
    # of what was inspected, dark under all lights that reach it [mm²]: what makes it brighter shows, what makes it
    # darker does not
    glints: float = 0.0
    # of what was inspected, lit in fewer images than a defect must show in, but in one at least [mm²]: it has to show
    # in these alone
    fewer: float = 0.0
    # of what is seen, not judged: image and prediction are saturated under each light that reaches it; no light does;
    # next to silhouettes and creases [mm²]
    saturated: float
    shadow: float
    edge: float
    grazing: float = 0.0  # seen at a grazing angle only, which is left out [mm²]
    # by contrast: of what was inspected, where an even disc of 5 pixels that changes the light by that share is found
    # half of the time [mm²]. The rest is dark, or shows stronger ones.
    sensitivity: dict[float, float]

    @property
    def share(self) -> float:
        """Of what the camera sees, the share that was inspected."""
        return self.inspected / self.seen if self.seen > 0.0 else 0.0

    @property
    def left_out(self) -> float:
        """Of all that the camera sees, the share that it sees at a grazing angle only."""
        return self.grazing / max(self.seen + self.grazing, 1e-9)

    @property
    def classes(self) -> tuple[float, ...]:
        """Areas [mm²], of what was inspected.

        Where a disc is found from each of :data:`CONTRASTS` on, the least first; where only stronger ones are; where
        only glints show.
        """
        found = [self.sensitivity.get(contrast, 0.0) for contrast in CONTRASTS]
        each = [more - less for less, more in zip([0.0, *found], found, strict=False)]
        return (*each, self.inspected - self.glints - found[-1], self.glints)

    def shares(self) -> dict[str, Any]:
        """JSON form: shares of what the camera sees without what is left out; that as a share of all that it sees."""

        def share(area: float) -> float:
            return round(area / max(self.seen, 1e-9), 5)

        return {
            "inspected": share(self.inspected),
            "finds_contrast": {f"{c:g}": share(a) for c, a in self.sensitivity.items()},
            "only_stronger": share(self.classes[-2]),
            "only_glints": share(self.glints),
            "fewer_lights": share(self.fewer),
            "saturated": share(self.saturated),
            "shadow": share(self.shadow),
            "edge": share(self.edge),
            "left_out": round(self.left_out, 5),
        }


def _class_areas(of_state: Float64, of_contrast: Float64) -> dict[str, Any]:
    # the fields of Shares, given the areas [mm²] in each SurfaceState, and of those where each contrast is found
    names = ("edge", "shadow", "saturated", "glints", "fewer", "grazing")
    return {
        **{name: float(of_state[SurfaceState[name.upper()]]) for name in names},
        "seen": float(of_state[SurfaceState.GRAZING + 1 :].sum()),
        "inspected": float(of_state[SurfaceState.GLINTS :].sum()),
        "sensitivity": {c: float(area) for c, area in zip(CONTRASTS, of_contrast, strict=True)},
    }


@dataclass(frozen=True, kw_only=True)
class PostureCoverage(Shares):
    """The surface that the camera sees in a posture."""

    state: UInt8 = field(compare=False, repr=False)  # :class:`SurfaceState` of each pixel, shape (H, W)
    # share of the light that a disc of 5 pixels must change to be found at a pixel, shape (H, W); infinite where it is
    # dark, or nothing was inspected
    least_contrast: Float32 = field(compare=False, repr=False)

    def as_dict(self) -> dict[str, Any]:
        return {"seen_mm2": round(self.seen, 3), **self.shares()}


def measure_coverage(
    view: PostureView, found: Deviations, *, min_images: int, high: float, threads: int | None = None
) -> PostureCoverage:
    """The surface of a posture that was inspected, given the threshold of the score.

    Each pixel's least contrast is that of the `min_images`-th most sensitive of the images that are lit there, or of
    the last of fewer: an even disc that takes away this share of the light is found half of the time.
    """
    images, height, width = view.predicted.shape
    state, least = np.empty((height, width), np.uint8), np.empty((height, width), np.float32)
    needed = _needed(images, min(min_images, images), high, found.correlation) / disc_gain(REFERENCE_DISC_PX)
    contrasts = np.array(CONTRASTS)

    surface = view.part, view.clean, view.prediction.grazing, view.prediction.area
    levels, judged = (view.predicted, view.limit, view.saturated), (found.usable, found.lit, found.scale)

    def judge(rows: slice) -> Float64:
        return _judge_rows(surface, levels, judged, min_images, needed, contrasts, rows.start, rows.stop, state, least)

    areas = np.sum(in_row_blocks(judge, height, threads), axis=0)
    of_state, of_contrast = areas[: len(SurfaceState)], areas[len(SurfaceState) :]
    return PostureCoverage(**_class_areas(of_state, of_contrast), state=state, least_contrast=least)


@kernel
def _judge_rows(
    surface: tuple[Bool, Bool, Bool, Float32],
    levels: tuple[Float32, Float32, Bool],
    judged: tuple[Bool, Bool, Float32],
    min_images: int,
    needed: Float64,
    contrasts: Float64,
    top: int,
    bottom: int,
    state: UInt8,
    least: Float32,
) -> Float64:
    # writes state and least contrast of some rows, and gives their area in each state, and in which a disc of each
    # contrast is found [mm²]. `needed`: share of a standard deviation, by the numbers of usable and of judging images
    (part, clean, grazing, area), (predicted, limit, saturated), (usable, lit, scale) = surface, levels, judged
    images, _, width = predicted.shape
    areas = np.zeros(_STATES + len(contrasts))
    shares = np.empty(images, np.float32)
    for y in range(top, bottom):
        for x in range(width):
            state[y, x], least[y, x] = _NO_PART, np.inf
            if not part[y, x] or area[y, x] <= 0.0:
                continue
            full, reached, bright = False, 0, 0
            for i in range(images):
                full = full or (saturated[i, y, x] and predicted[i, y, x] >= limit[i, y, x])
                reached += usable[i, y, x]
                if lit[i, y, x]:
                    # in order, the most sensitive image first
                    own = scale[i, y, x] / max(predicted[i, y, x], np.float32(1e-6))
                    k = bright
                    while k > 0 and shares[k - 1] > own:
                        shares[k] = shares[k - 1]
                        k -= 1
                    shares[k] = own
                    bright += 1
            if bright > 0:
                state[y, x] = _INSPECTED if bright >= min_images else _FEWER
                k = min(bright, min_images)
                contrast = needed[reached, k] * shares[k - 1]
                least[y, x] = contrast
                for j in range(len(contrasts)):
                    if contrast <= contrasts[j]:
                        areas[_STATES + j] += area[y, x]
            elif reached > 0:
                state[y, x] = _GLINTS
            elif clean[y, x]:
                state[y, x] = _SATURATED if full else _SHADOW
            else:
                state[y, x] = _GRAZING if grazing[y, x] else _EDGE
            areas[state[y, x]] += area[y, x]
    return areas


def _needed(images: int, min_images: int, high: float, correlation: float) -> Float64:
    # deviation that k of n images must show for the threshold, whatever the others do, all of them half of the time;
    # by n and k
    z = np.full((images + 1, min_images + 1), np.inf)
    for n in range(1, images + 1):
        for k in range(1, min(n, min_images) + 1):
            z[n, k] = float(special.ndtri(0.5 ** (1.0 / k))) + deviation_of_score(high, n, k, correlation)
    return z


@dataclass(frozen=True, kw_only=True)
class SurfaceCoverage(Shares):
    """The surface of the part, each place counted once, by the posture that shows it best."""

    # of the whole surface, undersides and insides too [mm²]; `seen` of it by the camera in at least one posture, with
    # images or without, not at a grazing angle
    area: float
    # of what is seen, not judged for want of images: what a posture without images shows, and those with images at an
    # edge at most [mm²]
    missing: float = 0.0

    @property
    def finds(self) -> float:
        """Of what the camera sees, the share on which :data:`REFERENCE_DEFECT` is found half of the time."""
        return self.sensitivity.get(REFERENCE_CONTRAST, 0.0) / self.seen if self.seen > 0.0 else 0.0

    def as_dict(self) -> dict[str, Any]:
        """JSON form: shares of what the camera sees, and that as a share of the whole."""
        return {
            "area_mm2": round(self.area, 3),
            "seen": round(self.seen / max(self.area, 1e-9), 5),
            **self.shares(),
            "missing": round(self.missing / max(self.seen, 1e-9), 5),
        }


def surface_coverage(
    scene: Scene, coverages: Sequence[tuple[Posture, PostureCoverage]], surface: SurfaceMap | None
) -> SurfaceCoverage:
    """What was inspected of the surface over all postures of a set.

    surface: of these postures and those that images are missing of; None for a single posture of which none is, whose
        own pixels are counted.
    """
    area = float(face_areas(scene.mesh).sum())
    if surface is None:
        ((_, only),) = coverages
        return SurfaceCoverage(area=area, **{each.name: getattr(only, each.name) for each in fields(Shares)})
    state = np.full(len(surface.areas), SurfaceState.NO_PART, np.uint8)
    least = np.full(len(surface.areas), np.inf, np.float32)
    inspected = dict(coverages)
    for posture, (patch, pixel) in surface.seen.items():
        judged = np.full(len(patch), SurfaceState.MISSING, np.uint8)
        if (coverage := inspected.get(posture)) is not None:
            # a patch beside the last pixel that shows the part is at its edge
            judged = np.maximum(coverage.state.ravel()[pixel], SurfaceState.EDGE)
            found = np.where(pixel < 0, np.inf, coverage.least_contrast.ravel()[pixel])
            least[patch] = np.minimum(least[patch], found.astype(np.float32))
        here = np.where(pixel < 0, SurfaceState.GRAZING, judged)
        state[patch] = np.maximum(state[patch], here.astype(np.uint8))
    return SurfaceCoverage(
        area=area,
        missing=float(surface.areas.sum(where=state == SurfaceState.MISSING)),
        **_class_areas(
            np.asarray(np.bincount(state, surface.areas, len(SurfaceState)), np.float64),
            np.array([surface.areas.sum(where=least <= contrast) for contrast in CONTRASTS]),
        ),
    )
