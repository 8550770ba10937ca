"""Options of an inspection."""

from dataclasses import dataclass

from lightopt.defects import DEFAULT_FALSE_ALARMS, false_alarms_problem
from lightopt.inspection.detection._registry import DETECTORS
from lightopt.inspection.fusion._gradient_fusion import FUSIONS, Fusion
from lightopt.inspection.prediction._predict import REFERENCES, ReferenceName


@dataclass(frozen=True, kw_only=True)
class InspectOptions:
    """Options of an inspection."""

    # ``residual``: measured against predicted; ``catalogue``: that, and whole defects of the part's catalogue;
    # ``template``: dots and lines in the synthetic image
    detector: str = "catalogue"
    # rule that the synthetic image is made by; None for no such image, which the template detector needs
    fusion: Fusion | None = "paper"
    # what the images are compared with: ``model``: the mesh and the reflectance; ``good-parts``: levels that a
    # calibration learned; ``self``: the smooth neighbourhood of each place in the images themselves
    reference: ReferenceName = "model"
    # expected number of false alarms per posture where noise is all that differs from the good part
    false_alarms: float = DEFAULT_FALSE_ALARMS
    min_images: int = 2  # in how many images of a posture a defect must show
    register: bool = True  # whether the part is searched for around its nominal place

    @property
    def scored_by(self) -> str:
        """The detector in use.

        Defects of a catalogue are tested for in noise that is independent from pixel to pixel, which texture is not.
        """
        replaced = self.detector == "catalogue" and self.reference != "model"
        return "residual" if replaced else self.detector

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
        if self.reference not in REFERENCES:
            found.append(f"option 'reference': expected {' or '.join(REFERENCES)}, found \"{self.reference}\"")
        elif self.reference != "model" and detector is not None and detector.uses_synthetic:
            found.append(
                f"option 'reference': {self.reference} is not for detector {self.detector}, which evaluates the "
                "synthetic image; use detector residual"
            )
        if problem := false_alarms_problem(self.false_alarms):
            found.append(problem)
        if self.min_images < 1:
            found.append(f"option 'min_images': expected 1 or more, found {self.min_images}")
        return found
