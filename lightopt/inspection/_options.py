"""How to inspect: the detectors to choose from, and all that a user chooses."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from lightopt.inspection.detection._matched_filter import TEMPLATES
from lightopt.inspection.detection._residual_score import SCALES_PX
from lightopt.inspection.fusion._gradient_fusion import FUSIONS, Fusion

DETECTORS: Final[Mapping[str, int]] = {"residual": len(SCALES_PX), "template": TEMPLATES}
"""Of each detector, how many scores of a pixel the one that it gets is the greatest of."""


@dataclass(frozen=True, kw_only=True)
class InspectOptions:
    """How to inspect.

    detector: ``residual``: measured against predicted; ``template``: dots and lines in the synthetic image.
    fusion: rule that the synthetic image is made by; None for no such image, which the template detector needs.
    false_alarms: expected number of false alarms per posture where noise is all that differs from the good part.
    min_images: in how many images of a posture a defect must show.
    register: whether the part is searched for around its nominal place.
    """

    detector: str = "residual"
    fusion: Fusion | None = "paper"
    false_alarms: float = 0.05
    min_images: int = 2
    register: bool = True

    @property
    def uses_synthetic(self) -> bool:
        """Whether the detector scores the synthetic image; else deviations, some of which good parts have in common."""
        return self.detector == "template"

    def problems(self) -> list[str]:
        """Messages about wrong options."""
        found: list[str] = []
        if self.detector not in DETECTORS:
            found.append(f"option 'detector': expected {' or '.join(DETECTORS)}, found \"{self.detector}\"")
        if self.fusion is not None and self.fusion not in FUSIONS:
            found.append(f"option 'fusion': expected {', '.join(FUSIONS)} or none, found \"{self.fusion}\"")
        if self.uses_synthetic and self.fusion is None:
            found.append(
                f"option 'detector': {self.detector} uses the synthetic image; option 'fusion' must not be none"
            )
        if not 1e-9 <= self.false_alarms <= 1.0:
            found.append(f"option 'false_alarms': expected a number from 1e-9 to 1, found {self.false_alarms:g}")
        if self.min_images < 1:
            found.append(f"option 'min_images': expected 1 or more, found {self.min_images}")
        return found
