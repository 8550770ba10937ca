"""What the images of a part are compared with."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

ReferenceName = Literal["model", "good-parts", "self"]


@dataclass(frozen=True)
class Reference:
    """Levels that a good part is expected to have.

    basis: what they come from, for people.
    limits: what a comparison with them cannot show; empty for the model, whose limits are those of its files.
    """

    basis: str
    limits: str = ""


REFERENCES: Final[Mapping[ReferenceName, Reference]] = {
    "model": Reference("model of the part (mesh and reflectance)"),
    "good-parts": Reference(
        "good parts of the calibration",
        "a deviation that good parts show at the same place to the same extent is not found; a rotation or shift that "
        "registration cannot observe must be that of the good parts",
    ),
    "self": Reference(
        "smooth neighbourhood of each place in the part's own images",
        "deviations wider than the neighbourhood, slow changes of brightness, and defects at edges are not found; a "
        "feature that the surface has only once or twice looks like a defect",
    ),
}
"""By the name that :class:`lightopt.inspection.InspectOptions` takes."""
