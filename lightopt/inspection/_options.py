"""How to inspect: the detectors to choose from, and all that a user chooses."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from lightopt.core.arrays import Float32
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._matched_filter import TEMPLATES, score_templates
from lightopt.inspection.detection._residual_score import SCALES_PX, score_deviations
from lightopt.inspection.fusion._gradient_fusion import FUSIONS, Fusion
from lightopt.inspection.fusion._synthetic_image import SyntheticImage

MakeSynthetic = Callable[[], SyntheticImage]


@dataclass(frozen=True, kw_only=True)
class Detector:
    """A way to find defects in the images of a posture.

    score: Gives each pixel −log₁₀ of the probability that noise alone looks as much like a defect, shape (H, W). Takes
        the deviations from the good part, in how many lights a defect must show, what makes the synthetic image (it is
        made where a detector calls this), and the number of threads.
    tests: How many scores of a pixel the one that it gets is the greatest of.
    uses_synthetic: Whether it scores the synthetic image. Else it scores deviations, and a calibration learns which of
        them good parts have in common.
    caveat: Warning where there is no calibration; empty for none.
    """

    score: Callable[[Deviations, int, MakeSynthetic | None, int | None], Float32]
    tests: int
    uses_synthetic: bool = False
    caveat: str = ""


def _score_deviations(
    found: Deviations, min_images: int, _make_synthetic: MakeSynthetic | None, threads: int | None
) -> Float32:
    return score_deviations(found, min_images=min_images, threads=threads)


def _score_synthetic(
    _found: Deviations, _seen_by: int, make_synthetic: MakeSynthetic | None, _threads: int | None
) -> Float32:
    assert make_synthetic is not None
    return score_templates(make_synthetic())


RESIDUAL: Final = Detector(score=_score_deviations, tests=len(SCALES_PX))
TEMPLATE: Final = Detector(
    score=_score_synthetic,
    tests=TEMPLATES,
    uses_synthetic=True,
    caveat="its rate of false alarms is that of an image of even texture; on this part it is known only with a "
    "calibration",
)

DETECTORS: Final[Mapping[str, Detector]] = {"residual": RESIDUAL, "template": TEMPLATE}
"""By the name that :class:`lightopt.inspection.InspectOptions` takes."""


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

    def problems(self) -> list[str]:
        """Messages about wrong options."""
        found: list[str] = []
        detector = DETECTORS.get(self.detector)
        if detector is None:
            found.append(f"option 'detector': expected {' or '.join(DETECTORS)}, found \"{self.detector}\"")
        if self.fusion is not None and self.fusion not in FUSIONS:
            found.append(f"option 'fusion': expected {', '.join(FUSIONS)} or none, found \"{self.fusion}\"")
        if detector is not None and detector.uses_synthetic and self.fusion is None:
            found.append(
                f"option 'detector': {self.detector} uses the synthetic image; option 'fusion' must not be none"
            )
        if not 1e-9 <= self.false_alarms <= 1.0:
            found.append(f"option 'false_alarms': expected a number from 1e-9 to 1, found {self.false_alarms:g}")
        if self.min_images < 1:
            found.append(f"option 'min_images': expected 1 or more, found {self.min_images}")
        return found
