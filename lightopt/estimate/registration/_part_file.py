"""A placement in the words of a part file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import rotation_z
from lightopt.estimate.registration._placement import Placement


@dataclass(frozen=True)
class PlacementInFile:
    """What ``placement`` of a part file says of a part where it really lies.

    Attributes
    ----------
    rotate_deg
        About the fixed X, then Y, then Z axis, before the anchor [°].
    translate_mm
        After the anchor [mm].
    """

    rotate_deg: tuple[float, float, float]
    translate_mm: tuple[float, float, float]


def placement_in_file(
    vertices: NDArray[np.float64],
    placement: Placement,
    *,
    anchor: Literal["as_modelled", "rest_on_table", "centred"],
    rotate_deg: tuple[float, float, float],
    translate_mm: tuple[float, float, float],
    pivot: NDArray[np.float64],
) -> PlacementInFile:
    """Turn and shift that put a part where it was found, through its file.

    The anchor looks at the bounding box of the turned part, so the shift takes back what the anchor moves.

    Parameters
    ----------
    vertices
        Of the part where its file has it so far, world frame at posture (0, 0), shape (n, 3) [mm].
    placement
        From there to where the part lies.
    anchor, rotate_deg, translate_mm
        As the file has them so far.
    pivot
        Of the stage [mm].
    """
    turn = rotation_z(placement.turn)
    turned = vertices @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    middle = 0.5 * (low + high)
    if anchor == "rest_on_table":
        anchored = np.array([middle[0], middle[1], low[2]])
    elif anchor == "centred":
        anchored = middle
    else:
        anchored = turn @ np.array(translate_mm, dtype=np.float64)
    shift = pivot - turn @ pivot + np.array([placement.x, placement.y, 0.0]) + anchored
    about_z = rotate_deg[2] + math.degrees(placement.turn)
    return PlacementInFile(
        rotate_deg=(rotate_deg[0], rotate_deg[1], math.remainder(about_z, 360.0)),
        translate_mm=(float(shift[0]), float(shift[1]), float(shift[2])),
    )
