"""The detectors: each scores the pixels of a posture by how much they look like a defect."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from lightopt.core.arrays import Float32
from lightopt.defects import CATALOGUE_SHARE, SCALES_PX
from lightopt.inspection.detection._catalogue_score import ExplainedDefect, explain_deviations
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._matched_filter import TEMPLATES, score_templates
from lightopt.inspection.detection._residual_score import score_deviations
from lightopt.inspection.fusion._synthetic_image import SyntheticImage
from lightopt.inspection.prediction._template_bank import TemplateBank

_Make = Callable[[], SyntheticImage] | None  # makes the synthetic image


@dataclass(frozen=True, kw_only=True)
class Scores:
    """How much the pixels of a posture look like a defect."""

    score: Float32  # −log₁₀ of the probability that noise alone looks as much like one, shape (H, W)
    # defects of the catalogue, where the detector tests for these, by descending score
    explained: tuple[ExplainedDefect, ...] = ()
    unexplained: Float32  # the score without these, shape (H, W)
    handicap: float = 0.0  # by how much scores of deviations are less than those of the residual detector


@dataclass(frozen=True, kw_only=True)
class Detector:
    """A way to find defects in the images of a posture."""

    # takes the deviations from the good part, in how many lights a defect must show, what makes the synthetic image (it
    # is made where a detector calls this), what the catalogue's defects would change (empty for others), and the number
    # of threads
    score: Callable[[Deviations, int, _Make, TemplateBank, int | None], Scores]
    tests: int  # how many scores of a pixel the one that it gets is the greatest of
    # whether it scores the synthetic image. Else it scores deviations, and a calibration learns which of them good
    # parts have in common.
    uses_synthetic: bool = False
    uses_catalogue: bool = False  # whether it tests for the defects of the part's catalogue
    caveat: str = ""  # warning where there is no calibration; empty for none


def _score_deviations(found: Deviations, least: int, _make: _Make, _bank: TemplateBank, threads: int | None) -> Scores:
    score = score_deviations(found, min_images=least, threads=threads)
    return Scores(score=score, unexplained=score)


def _score_synthetic(_found: Deviations, _least: int, make: _Make, _bank: TemplateBank, _threads: int | None) -> Scores:
    assert make is not None
    score = score_templates(make())
    return Scores(score=score, unexplained=score)


def _score_catalogue(found: Deviations, least: int, _make: _Make, bank: TemplateBank, threads: int | None) -> Scores:
    explained = explain_deviations(found, bank, share=CATALOGUE_SHARE, min_images=least, threads=threads)
    handicap = math.log10(len(SCALES_PX) / (1.0 - CATALOGUE_SHARE))
    unexplained = score_deviations(found, min_images=least, threads=threads)
    unexplained = np.maximum(unexplained - np.float32(handicap), np.float32(0.0))
    score = unexplained.copy()
    for one in explained:
        place = one.rows, one.columns
        score[place] = np.maximum(score[place], np.float32(one.score))
    return Scores(score=score, explained=explained, unexplained=unexplained, handicap=handicap)


RESIDUAL: Final = Detector(score=_score_deviations, tests=len(SCALES_PX))

DETECTORS: Final[Mapping[str, Detector]] = {
    "residual": RESIDUAL,
    # its scores allow for all tests of a pixel
    "catalogue": Detector(score=_score_catalogue, tests=1, uses_catalogue=True),
    "template": Detector(
        score=_score_synthetic,
        tests=TEMPLATES,
        uses_synthetic=True,
        caveat="its rate of false alarms is that of an image of even texture; on this part it is known only with a "
        "calibration",
    ),
}
"""By the name that :class:`lightopt.inspection.InspectOptions` takes."""
