"""A surface by how far its inspection got and what it shows there: the classes, and their areas."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

CONTRASTS: Final = (0.05, 0.1, 0.2, 0.4)
"""Shares of the light that a defect takes away, for which the sensitivity is told."""

TOLD_SIZE_PX = 5.0
"""Diameter of the even disc that it is told for."""


class Reached(IntEnum):
    """How far the inspection of a place got, the least first; with several postures the furthest counts.

    What is seen at a grazing angle only (:data:`lightopt.rendering.GRAZING_DEG`) is left out of all shares.

    What is lit in fewer images than must show a defect, or is only reached by light and stays dark, is judged by these,
    as :func:`lightopt.inspection.score_deviations` does it. No pixel is missing, only patches of the surface:
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
    """A surface by what each place of it can show, and why nothing where it can show nothing.

    Attributes
    ----------
    seen
        By the camera, not at a grazing angle [mm²].
    inspected
        Of it, judged [mm²]: the areas of :attr:`classes`.
    glints
        Of what was inspected, dark under all lights that reach it [mm²]: what makes it brighter shows, what makes it
        darker does not.
    fewer
        Of what was inspected, lit in fewer images than a defect must show in, but in one at least [mm²]: it has to
        show in these alone.
    saturated, shadow, edge
        Of what is seen, not judged: image and prediction are saturated under each light that reaches it; no light
        does; next to silhouettes and creases [mm²].
    grazing
        Seen at a grazing angle only, which is left out [mm²].
    sensitivity
        By contrast: of what was inspected, where an even disc of 5 pixels that changes the light by that share is found
        half of the time [mm²]. The rest is dark, or shows stronger ones.
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
    areas: NDArray[np.floating[Any]], reached: NDArray[np.uint8], least_contrast: NDArray[np.floating[Any]]
) -> dict[str, Any]:
    """The attributes of :class:`Shares`, added up over places.

    Parameters
    ----------
    areas
        Of each place [mm²].
    reached
        :class:`Reached` of each, same shape.
    least_contrast
        Share of the light that a disc of 5 pixels must change to be found there, same shape; infinite where none is.
    """

    def of(which: NDArray[np.bool_]) -> float:
        return float(areas[which].sum())

    return {
        "seen": of(reached > Reached.GRAZING),
        "inspected": of(reached >= Reached.GLINTS),
        "glints": of(reached == Reached.GLINTS),
        "fewer": of(reached == Reached.FEWER),
        "saturated": of(reached == Reached.SATURATED),
        "shadow": of(reached == Reached.SHADOW),
        "edge": of(reached == Reached.EDGE),
        "grazing": of(reached == Reached.GRAZING),
        "sensitivity": {contrast: of(least_contrast <= contrast) for contrast in CONTRASTS},
    }
