"""The detectors: each scores the pixels of a posture by how much they look like a defect."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from lightopt.core.arrays import Float32
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._matched_filter import TEMPLATES, score_templates
from lightopt.inspection.detection._residual_score import SCALES_PX, score_deviations
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
