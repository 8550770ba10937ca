"""OK or NG, by the limits of the part's file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lightopt.config import InspectionConfig
from lightopt.errors import counted
from lightopt.inspection._inspect import Inspection

__all__ = ["Verdict", "judge"]


@dataclass(frozen=True)
class Verdict:
    """Whether a part is good.

    Attributes
    ----------
    good
        Whether it is.
    counting
        Numbers of the defects that count.
    inspected
        Share of the visible surface that was inspected in one posture or several.
    reasons
        Why it is not; empty for a good part.
    """

    good: bool
    counting: tuple[int, ...]
    inspected: float
    reasons: tuple[str, ...]

    @property
    def word(self) -> str:
        """``OK`` or ``NG``."""
        return "OK" if self.good else "NG"

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "verdict": self.word,
            "counting": list(self.counting),
            "inspected": round(self.inspected, 5),
            "reasons": list(self.reasons),
        }


def judge(result: Inspection, limits: InspectionConfig) -> Verdict:
    """Hold an inspection against the part's limits.

    Parameters
    ----------
    result
        Of a set of images.
    limits
        From the part's file.
    """
    counting = [
        defect.number
        for defect in result.defects
        if defect.size[0] >= limits.least_size_mm and defect.greatest_contrast >= limits.least_contrast
    ]
    inspected = result.surface.share
    reasons: list[str] = []
    if len(counting) > limits.most_defects:
        reasons.append(f"{counted(len(counting), 'defect')} where {limits.most_defects} are allowed")
    if inspected == 0.0:
        reasons.append("nothing of the surface was inspected")
    elif inspected < limits.least_inspected:
        reasons.append(
            f"{100.0 * inspected:.1f} % of the visible surface was inspected, at least "
            f"{100.0 * limits.least_inspected:g} % are asked for"
        )
    return Verdict(good=not reasons, counting=tuple(counting), inspected=inspected, reasons=tuple(reasons))
