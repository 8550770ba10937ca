"""The part coloured by why defects on it stay invisible."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightopt.optimize import Blind, BlindReport, BlindSpots
from lightopt.report._surface import SurfaceClass, SurfaceLayer

__all__ = ["blind_layers"]

# Okabe and Ito; what is seen and what no camera sees as in the view of what the images show
KINDS = (
    (Blind.SEEN, "all defects seen", "#56b4e9"),
    (Blind.CONTRAST, "contrast under noise", "#f0e442"),
    (Blind.SATURATED, "saturated by a light", "#d55e00"),
    (Blind.SHADOWED, "shadowed", "#0b3c5d"),
    (Blind.GRAZING, "seen at a grazing angle", "#cc79a7"),
    (Blind.CAMERA, "never seen by the camera", "#c9ced6"),
)

# matplotlib's cividis (Nuñez, Anderton and Renslow, 2018) in equal steps: the brighter the more is seen
SHARES = (
    (0.0, "none", "#00224e"),
    (0.25, "up to a quarter", "#35456c"),
    (0.5, "up to a half", "#666970"),
    (0.75, "up to three quarters", "#948e77"),
    (1.0, "more, not all", "#c8b866"),
    (np.inf, "all", "#fee838"),
)


def blind_layers(report: BlindReport) -> list[SurfaceLayer]:
    """How many defects are seen, and why the others are not: all postures together, wherever the lights stand, each."""
    layers = [share_layer("all postures, how many defects are seen", report.chosen)]
    for posture, chosen, possible in report.parts() if len(report.postures) > 1 else report.parts()[:1]:
        where = "all postures" if posture is None else f"posture {posture}"
        layers.append(blind_layer(f"{where}, why not", chosen))
        if posture is None:
            layers.append(blind_layer(f"{where}, why not, wherever the lights can stand", possible))
    return layers


def share_layer(name: str, spots: BlindSpots) -> SurfaceLayer:
    """How large a share of the defects is seen on every patch."""
    limits = np.array([limit for limit, *_ in SHARES])
    of_face = np.searchsorted(limits, spots.share, side="left").astype(np.uint8)
    of_face[spots.share >= 1.0] = len(SHARES) - 1
    of_face[spots.codes == Blind.CAMERA] = len(SHARES)
    kinds = [*((label, colour) for _, label, colour in SHARES), KINDS[-1][1:]]
    return _layer(name, spots, of_face, kinds)


def blind_layer(name: str, spots: BlindSpots) -> SurfaceLayer:
    """The reasons of every patch; which light saturates it is told by the table."""
    codes = np.minimum(spots.codes, Blind.SATURATED)
    of_face = np.zeros(len(codes), np.uint8)
    for index, (code, *_) in enumerate(KINDS):
        of_face[codes == code] = index
    return _layer(name, spots, of_face, [(label, colour) for _, label, colour in KINDS])


def _layer(
    name: str, spots: BlindSpots, of_face: NDArray[np.uint8], kinds: Sequence[tuple[str, str]]
) -> SurfaceLayer:
    areas = np.bincount(of_face, weights=spots.areas, minlength=len(kinds)) / spots.areas.sum()
    classes = tuple(
        SurfaceClass(label=label, colour=colour, amount=f"{100.0 * area:.1f} %")
        for (label, colour), area in zip(kinds, areas, strict=True)
    )
    return SurfaceLayer(name=name, classes=classes, of_face=of_face)
