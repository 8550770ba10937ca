"""The result of an inspection, and the verdict by the limits of the part file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from lightopt.config import InspectionConfig
from lightopt.core.arrays import Float32, Int32
from lightopt.core.errors import counted
from lightopt.estimate.registration import Placement, Registration
from lightopt.estimate.verification import RigAdjustment
from lightopt.images import ImageSet
from lightopt.inspection.detection._coverage import REFERENCE_CONTRAST, PostureCoverage, SurfaceCoverage
from lightopt.inspection.detection._defects import Detection, FoundDefect
from lightopt.inspection.fusion._synthetic_image import SyntheticImage
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._predict import REFERENCES, ReferenceName
from lightopt.scene import Scene


@dataclass(frozen=True, kw_only=True)
class InspectedPosture:
    """One posture of an inspected part."""

    view: PostureView
    # makes the image without highlights and keeps it; None where none is wanted
    make_synthetic: Callable[[], SyntheticImage] | None
    score: Float32  # −log₁₀ of the probability that noise alone looks as much like a defect, shape (H, W)
    labels: Int32  # number of the region that each pixel belongs to, 0 for none, shape (H, W)
    threshold: float
    detections: tuple[Detection, ...]
    coverage: PostureCoverage

    @property
    def synthetic(self) -> SyntheticImage | None:
        """The image without highlights, made on first use; None where none is wanted.

        It takes several times as long as the verdict, which the residual detector reaches without it.
        """
        return None if self.make_synthetic is None else self.make_synthetic()

    def as_dict(self) -> dict[str, Any]:
        photometry = self.view.photometry
        return {
            "posture": self.view.posture.as_dict(),
            "lights": list(self.view.lights),
            "threshold": round(self.threshold, 3),
            "gains": {name: round(photometry.gains[name], 5) for name in self.view.lights},
            "dark_levels": round(photometry.dark, 4),
            **({} if self.synthetic is None else {"filled_px": int(self.synthetic.filled.sum())}),
            "surface": self.coverage.as_dict(),
        }


@dataclass(frozen=True, kw_only=True)
class InspectionResult:
    """The result of the inspection of one set of images."""

    defects: tuple[FoundDefect, ...]
    postures: tuple[InspectedPosture, ...]
    placement: Placement | None  # where the part lies from where its file has it; None where it was not searched for
    # the search that found it, or the part of the batch that it lies near; None where there was none
    registration: Registration | None = None
    adjustment: RigAdjustment | None = None  # of a calibrated rig, by the first set of the batch
    warnings: tuple[str, ...]  # missing lights and postures, and so on
    reference: ReferenceName = "model"  # what the images were compared with
    nominal: Scene = field(repr=False, compare=False)  # the scene with the part where its file has it
    surface: SurfaceCoverage  # of the part, each place counted once however many postures show it

    def as_dict(self) -> dict[str, Any]:
        reference = REFERENCES[self.reference]
        return {
            "defects": [defect.as_dict() for defect in self.defects],
            "postures": [posture.as_dict() for posture in self.postures],
            "reference": {"name": self.reference, "basis": reference.basis, "limits": reference.limits},
            "surface": self.surface.as_dict(),
            "placement": None if self.placement is None else self.placement.as_dict(),
            "registration": None if self.registration is None else self.registration.as_dict(),
            **({} if self.adjustment is None else {"rig_adjustment": self.adjustment.as_dict()}),
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True)
class Verdict:
    """Whether a part is good."""

    good: bool
    counting: tuple[int, ...]  # numbers of the defects that count
    # share of the visible surface that was inspected in one posture or several; where it is dark, for glints
    inspected: float
    reasons: tuple[str, ...]  # why it is not; empty for a good part
    limits: InspectionConfig = field(default_factory=InspectionConfig)
    # share of the visible surface where :data:`lightopt.inspection.REFERENCE_DEFECT` is found half of the time
    finds: float = 0.0
    glints: float = 0.0  # share of the visible surface that is dark, so that only glints show

    @property
    def word(self) -> str:
        """``OK`` or ``NG``."""
        return "OK" if self.good else "NG"

    @property
    def explanation(self) -> str:
        if self.reasons:
            return "; ".join(self.reasons)
        if self.counting:
            return _count_text(len(self.counting), self.limits.most_defects)
        return "nothing found that counts"

    def as_dict(self) -> dict[str, Any]:
        return {
            "verdict": self.word,
            "counting": list(self.counting),
            "inspected": round(self.inspected, 5),
            "finds_contrast": {f"{REFERENCE_CONTRAST:g}": round(self.finds, 5)},
            "only_glints": round(self.glints, 5),
            "reasons": list(self.reasons),
            "limits": self.limits.model_dump(exclude={"bounces"}),
        }


@dataclass(frozen=True, kw_only=True)
class BatchRow:
    """One part of a batch, in the batch's table."""

    name: str
    report: str = ""  # its own report, relative to the batch's; empty where it has none
    defects: int = 0  # number of those found, whether they count or not
    verdict: Verdict | None = None
    refused: tuple[str, ...] = ()  # why it was not inspected; then there is no verdict

    @property
    def word(self) -> str:
        """``OK``, ``NG`` or ``not inspected``."""
        return "not inspected" if self.verdict is None else self.verdict.word

    def as_dict(self) -> dict[str, Any]:
        if self.verdict is None:
            return {"folder": self.name, "verdict": self.word, "reasons": list(self.refused)}
        return {"folder": self.name, "defects": self.defects, **self.verdict.as_dict()}


def judge(result: InspectionResult, limits: InspectionConfig) -> Verdict:
    """Compare an inspection with the limits of the part file."""
    large = [one for one in result.defects if one.size[0] >= limits.least_size_mm]
    counting = [one.number for one in large if one.greatest_contrast >= limits.least_contrast]
    inspected = result.surface.share
    reasons: list[str] = []
    if len(counting) > limits.most_defects:
        reasons.append(_count_text(len(counting), limits.most_defects))
    if inspected == 0.0:
        reasons.append("nothing of the surface was inspected")
    elif inspected < limits.least_inspected:
        reasons.append(
            f"{100.0 * inspected:.1f} % of the visible surface was inspected, at least "
            f"{100.0 * limits.least_inspected:g} % are required"
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


def _count_text(count: int, allowed: int) -> str:
    return f"{counted(count, 'defect')} that count{'s' if count == 1 else ''}, {allowed} allowed"


def rejections(sets: Sequence[ImageSet], rows: Sequence[BatchRow]) -> list[str]:
    """The image sets whose part is NG, with reasons: a line for each."""
    return [
        f"{image_set.folder}: NG, {'; '.join(row.verdict.reasons)}"
        for image_set, row in zip(sets, rows, strict=True)
        if row.verdict is not None and not row.verdict.good
    ]
