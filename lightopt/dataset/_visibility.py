"""Which defects images can show, by the statistic with which inspections are planned and done.

The change that a defect makes is known here pixel by pixel, so that Z is expected to be √Σ m²
(:mod:`lightopt.defects`). As in an inspection a scratch is found by its best segment, and no image alone decides.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lightopt import defects
from lightopt.core.arrays import Float32, Float64
from lightopt.inspection import InspectOptions

MIN_IMAGES = InspectOptions.min_images  # must show a defect where more than one light reaches it


def thresholds(
    catalogue: Sequence[defects.CatalogueEntry], pixels: int, footprint: float, blur: float, false_alarms: float
) -> Mapping[str, float]:
    """Z from which on a defect counts as found, by the name of its entry.

    pixels: Of a posture's images that can be judged
    footprint: Side of a pixel [mm]
    blur: Diameter of the lens' disc [px]
    """
    every = [(entry.name, defects.defect_hypotheses(one)) for entry in catalogue for one in entry.in_sizes()]
    found: dict[str, float] = {}
    for name, own in every:
        grid = defects.search_grid(own, footprint, blur)
        places = pixels / (grid.ratio * grid.step) ** 2
        tests = places * len(own.turns) * len(grid.halves) * len(defects.SIZES)
        found[name] = max(found.get(name, 0.0), defects.least_z(tests, len(every), false_alarms))
    return found


@dataclass(frozen=True)
class Visibility:
    """How much a defect is expected to stand out of noise, and whether that is enough for it to be found."""

    z: float
    visible: bool


def visibility_in_images(
    entry: defects.CatalogueEntry,
    threshold: float,
    good: Float64,
    varied: Float64,
    *,
    deviation: Float64,
    limit: Float64,
    along: Float64,
) -> tuple[Visibility, tuple[Visibility, ...]]:
    """The visibility of a defect in all images of a posture together, and in each alone.

    threshold: From :func:`thresholds`
    good, varied: Levels of the good part and of the defect before the camera clips, in the k pixels that show it and
        can be judged, shape (lights, k) [grey level]
    deviation, limit: Standard deviation of the good part's level, and level at which the camera clips, same shape
    along: Place along the defect's length [mm], shape (k,)
    """
    energy = defects.expected_change(good, varied, deviation=deviation, limit=limit) ** 2
    of_segments = _energy_of_segments(entry, energy, along)
    own = of_segments[:, of_segments.sum(axis=0).argmax()]
    lit = int((((good >= defects.DARK * deviation) & (good < limit)).mean(axis=1) >= 0.5).sum()) if good.size else 0
    images = min(MIN_IMAGES, max(1, lit))
    energies: Float32 = own[None].astype(np.float32)
    confirmed = images == 1 or float(defects.rest_of_images(energies, energies, images)[0]) >= defects.CONFIRMED
    z = math.sqrt(float(own.sum()))
    alone = [math.sqrt(one) for one in of_segments.max(axis=1).tolist()]
    return Visibility(z, z >= threshold and confirmed), tuple(Visibility(one, one >= threshold) for one in alone)


def visibility_of_change(
    entry: defects.CatalogueEntry, threshold: float, change: Float64, along: Float64
) -> Visibility:
    """The visibility of a defect in one image, by its change in standard deviations in k pixels, shape (k,)."""
    energy = np.clip(change, -defects.MOST_CHANGE, defects.MOST_CHANGE)[None] ** 2
    z = math.sqrt(float(_energy_of_segments(entry, energy, along).max()))
    return Visibility(z, z >= threshold)


def _energy_of_segments(entry: defects.CatalogueEntry, energy: Float64, along: Float64) -> Float64:
    # Σ m² of each image over the segment that begins at each pixel, shape (images, k)
    if not len(along):
        return np.zeros((len(energy), 1))
    length = defects.defect_hypotheses(entry).shapes[1].length if entry.shape.kind == "scratch" else np.inf
    order = np.argsort(along, kind="stable")
    sums = np.concatenate([np.zeros((len(energy), 1)), np.cumsum(energy[:, order], axis=1)], axis=1)
    return sums[:, np.searchsorted(along[order], along[order] + length, side="right")] - sums[:, :-1]
