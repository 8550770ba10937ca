"""OK or NG, by the limits of the part's file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lightopt.config import InspectionConfig
from lightopt.core.errors import counted
from lightopt.inspection._results import Inspection
from lightopt.inspection._surface import TOLD_CONTRAST


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
        Share of the visible surface that was inspected in one posture or several; where it is dark, for glints.
    reasons
        Why it is not; empty for a good part.
    limits
        That it was judged by.
    finds
        Share of the visible surface where :data:`lightopt.inspection.TOLD_DISC` is found half of the time.
    glints
        Share of the visible surface that is dark, so that only glints show.
    """

    good: bool
    counting: tuple[int, ...]
    inspected: float
    reasons: tuple[str, ...]
    limits: InspectionConfig = field(default_factory=InspectionConfig)
    finds: float = 0.0
    glints: float = 0.0

    @property
    def word(self) -> str:
        """``OK`` or ``NG``."""
        return "OK" if self.good else "NG"

    @property
    def told(self) -> str:
        """The reasons, or what speaks for the part."""
        if self.reasons:
            return "; ".join(self.reasons)
        return (
            _told(len(self.counting), self.limits.most_defects)
            if self.counting
            else "nothing found that counts"
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "verdict": self.word,
            "counting": list(self.counting),
            "inspected": round(self.inspected, 5),
            "finds_contrast": {f"{TOLD_CONTRAST:g}": round(self.finds, 5)},
            "only_glints": round(self.glints, 5),
            "reasons": list(self.reasons),
            "limits": self.limits.model_dump(),
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
        reasons.append(_told(len(counting), limits.most_defects))
    if inspected == 0.0:
        reasons.append("nothing of the surface was inspected")
    elif inspected < limits.least_inspected:
        reasons.append(
            f"{100.0 * inspected:.1f} % of the visible surface was inspected, at least "
            f"{100.0 * limits.least_inspected:g} % are asked for"
        )
    return Verdict(
        good=not reasons,
        counting=tuple(counting),
        inspected=inspected,
        reasons=tuple(reasons),
        limits=limits,
        finds=result.surface.finds,
        glints=result.surface.glints / max(result.surface.seen, 1e-9),
    )


def _told(count: int, allowed: int) -> str:
    return f"{counted(count, 'defect')} that count{'s' if count == 1 else ''}, {allowed} allowed"
