"""Coverage: share of the surface that was inspected, its sensitivity, and the reasons for the rest.

Of the pixels of each posture first, then of the part's surface over all postures, each place of it counted once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import special

from lightopt.core.arrays import Float32, Float64, UInt8
from lightopt.core.transforms import Posture
from lightopt.geometry import face_areas
from lightopt.inspection._image_blocks import in_row_blocks
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._residual_score import disc_gain
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


@dataclass(frozen=True, kw_only=True)
class Shares:
    """Areas of a surface by class: the defects that a place can show, or the reason why it shows none.

    seen: by the camera, not at a grazing angle [mm²].
    inspected: of it, judged [mm²]: the areas of :attr:`classes`.
    glints: of what was inspected, dark under all lights that reach it [mm²]: what makes it brighter shows, what makes
        it darker does not.
    fewer: of what was inspected, lit in fewer images than a defect must show in, but in one at least [mm²]: it has to
        show in these alone.
    saturated, shadow, edge: of what is seen, not judged: image and prediction are saturated under each light that
        reaches it; no light does; next to silhouettes and creases [mm²].
    grazing: seen at a grazing angle only, which is left out [mm²].
    sensitivity: by contrast: of what was inspected, where an even disc of 5 pixels that changes the light by that
        share is found half of the time [mm²]. The rest is dark, or shows stronger ones.
    """

    seen: float
    inspected: float
    glints: float = 0.0
    fewer: float = 0.0
    saturated: float
    shadow: float
    edge: float
    grazing: float = 0.0
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


def class_areas(
    areas: NDArray[np.floating[Any]], state: UInt8, least_contrast: NDArray[np.floating[Any]]
) -> dict[str, Any]:
    """The fields of :class:`Shares`, added up over places.

    areas: of each place [mm²].
    state: :class:`SurfaceState` of each, same shape.
    least_contrast: share of the light that a disc of 5 pixels must change to be found there, same shape; infinite
        where none is.
    """
    total = np.bincount(state.ravel(), areas.ravel(), len(SurfaceState))
    names = ("edge", "shadow", "saturated", "glints", "fewer", "grazing")
    return {
        **{name: float(total[SurfaceState[name.upper()]]) for name in names},
        "seen": float(total[SurfaceState.GRAZING + 1 :].sum()),
        "inspected": float(total[SurfaceState.GLINTS :].sum()),
        "sensitivity": {c: float(areas.sum(where=least_contrast <= c, dtype=np.float64)) for c in CONTRASTS},
    }


@dataclass(frozen=True, kw_only=True)
class PostureCoverage(Shares):
    """The surface that the camera sees in a posture.

    state: :class:`SurfaceState` of each pixel, shape (H, W).
    least_contrast: share of the light that a disc of 5 pixels must change to be found at a pixel, shape (H, W);
        infinite where it is dark, or nothing was inspected.
    """

    state: UInt8 = field(compare=False, repr=False)
    least_contrast: Float32 = field(compare=False, repr=False)

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {"seen_mm2": round(self.seen, 3), **self.shares()}


def measure_coverage(
    view: PostureView, found: Deviations, *, min_images: int, high: float, threads: int | None = None
) -> PostureCoverage:
    """The surface of a posture that was inspected, given the threshold of the score."""

    def judge(rows: slice) -> tuple[UInt8, Float64]:
        return _judge_rows(view, found.in_box(rows), rows, min_images, high)

    # block by block of rows, since small arrays stay in a processor's cache
    blocks = in_row_blocks(judge, len(view.clean), threads)
    state, least = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    areas = class_areas(view.prediction.area, state, least)
    return PostureCoverage(**areas, state=state, least_contrast=least.astype(np.float32))


def _judge_rows(
    view: PostureView, found: Deviations, rows: slice, min_images: int, high: float
) -> tuple[UInt8, Float64]:
    # state and least contrast of some rows, given the deviations in these
    predicted, clean = view.predicted[:, rows], view.clean[rows]
    part = view.part[rows] & (view.prediction.area[rows] > 0.0)
    lit = found.lit.sum(axis=0)
    full = (view.saturated[:, rows] & (predicted >= view.limit[:, rows])).any(axis=0)
    state = np.zeros(part.shape, np.uint8)
    state[part] = SurfaceState.EDGE
    state[part & view.prediction.grazing[rows]] = SurfaceState.GRAZING
    state[part & clean] = SurfaceState.SHADOW
    state[part & clean & full] = SurfaceState.SATURATED
    state[part & found.usable.any(axis=0)] = SurfaceState.GLINTS
    state[part & (lit > 0)] = SurfaceState.FEWER
    state[part & (lit >= min_images)] = SurfaceState.INSPECTED
    least = least_contrast(found, predicted, min_images=min_images, high=high)
    least[state < SurfaceState.FEWER] = np.inf
    return state, least


def least_contrast(found: Deviations, predicted: Float32, *, min_images: int, high: float) -> Float64:
    """Share of the light that an even disc of 5 pixels must take away to be found half of the time, shape (H, W).

    Infinite where no image is lit.

    predicted: of the good part [grey level], shape (lights, H, W).
    """
    images = len(predicted)
    k = np.clip(found.lit.sum(axis=0), 1, min(min_images, images))
    needed = _needed(images, min(min_images, images), high)[found.usable.sum(axis=0), k]
    share = np.where(found.lit, found.scale / np.maximum(predicted, 1e-6), np.inf)
    weakest = np.take_along_axis(np.sort(share, axis=0), k[None] - 1, axis=0)[0]
    return needed / disc_gain(REFERENCE_DISC_PX) * weakest


def _needed(images: int, min_images: int, high: float) -> Float64:
    # deviation that k of n images must show for the threshold, whatever the others do, all of them half of the time;
    # by n and k
    z = np.full((images + 1, min_images + 1), np.inf)
    for n in range(1, images + 1):
        for k in range(1, min(n, min_images) + 1):
            each = (10.0**-high / float(special.binom(n, k))) ** (1.0 / k)
            z[n, k] = float(special.ndtri(0.5 ** (1.0 / k)) - special.ndtri(0.5 * each))
    return z


@dataclass(frozen=True, kw_only=True)
class SurfaceCoverage(Shares):
    """The surface of the part, each place counted once, by the posture that shows it best.

    area: of the whole surface, undersides and insides too [mm²]; `seen` of it by the camera in at least one posture,
        with images or without, not at a grazing angle.
    missing: of what is seen, not judged for want of images: what a posture without images shows, and those with
        images at an edge at most [mm²].
    """

    area: float
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
        **class_areas(surface.areas, state, least),
    )
