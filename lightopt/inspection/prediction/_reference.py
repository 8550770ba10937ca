"""What the images of a part are compared with."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

ReferenceName = Literal["model", "good-parts", "self"]


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Levels that a good part is expected to have.

    basis: what they come from, for people.
    remedy: what is wrong where far too much of a part deviates from them, and what to do.
    limits: what a comparison with them cannot show; empty for the model, whose limits are those of its files.
    """

    basis: str
    remedy: str
    limits: str = ""


REFERENCES: Final[Mapping[ReferenceName, Reference]] = {
    "model": Reference(
        basis="model of the part (mesh and reflectance)",
        remedy="the model does not describe the part; check the sensor's noise in the rig file and that the images "
        "have it, give a STEP file, fit the reflectance (lightopt fit-specular), or compare with good parts "
        "(option 'reference': good-parts)",
    ),
    "good-parts": Reference(
        basis="good parts of the calibration",
        remedy="the part is not like the good parts of the calibration; calibrate with good parts of each batch",
        limits="a deviation that good parts show at the same place to the same extent is not found; a shift or "
        "rotation that registration cannot observe must be that of the good parts",
    ),
    "self": Reference(
        basis="smooth neighbourhood of each place in the part's own images",
        remedy="the part is not smooth; compare with good parts (option 'reference': good-parts)",
        limits="deviations wider than the neighbourhood, slow changes of brightness, and defects at edges are not "
        "found; a feature that the surface has only once or twice looks like a defect",
    ),
}
"""By the name that :class:`lightopt.inspection.InspectOptions` takes."""
