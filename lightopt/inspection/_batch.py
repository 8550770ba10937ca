"""Inspect several image sets of one kind of part: a set that is refused does not stop the rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.images import ImageSet
from lightopt.inspection._files import InspectionFolder
from lightopt.inspection._inspect import find_defects
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._results import InspectionResult, Verdict, judge
from lightopt.inspection.calibration._calibration import Calibration
from lightopt.inspection.evaluation._evaluation import SetEvaluation, evaluate_set
from lightopt.inspection.evaluation._ground_truth import TruthSource
from lightopt.inspection.prediction._prediction_cache import PredictionCache
from lightopt.scene import place_defects


@dataclass(frozen=True, kw_only=True)
class InspectedSet:
    """What the inspection of one image set of a batch gave.

    result, verdict: None where the set was refused.
    evaluation: against ground truth, where that was given.
    """

    name: str
    result: InspectionResult | None = None
    verdict: Verdict | None = None
    evaluation: SetEvaluation | None = None
    warnings: tuple[str, ...] = ()
    error: InputError | None = None


@dataclass(frozen=True, kw_only=True)
class BatchRow:
    """One part of a batch, in the batch's table.

    name: of its folder.
    report: its own report, relative to the batch's; empty where it has none.
    defects: number of those found, whether they count or not.
    verdict: None where the part was refused.
    refused: why it was not inspected.
    """

    name: str
    report: str = ""
    defects: int = 0
    verdict: Verdict | None = None
    refused: tuple[str, ...] = ()

    @property
    def word(self) -> str:
        """``OK``, ``NG`` or ``not inspected``."""
        return "not inspected" if self.verdict is None else self.verdict.word

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        if self.verdict is None:
            return {"folder": self.name, "verdict": self.word, "reasons": list(self.refused)}
        return {"folder": self.name, "defects": self.defects, **self.verdict.as_dict()}


def inspect_batch(
    rig: RigConfig,
    part: PartConfig,
    sets: Sequence[ImageSet],
    *,
    options: InspectOptions | None = None,
    calibration: Calibration | None = None,
    truth: Sequence[TruthSource] | None = None,
    folders: Sequence[InspectionFolder] | None = None,
    run: RunContext | None = None,
) -> Iterator[InspectedSet]:
    """Inspect image sets one after the other; each is inspected when its result is requested.

    Predictions are reused from set to set. A set of unusable images is refused, and the others are inspected.

    sets: Rendered or captured.
    calibration: Learned from good parts.
    truth: From :func:`truth_sources`: the results are evaluated against it.
    folders: That the results will be written to: each is made before its set is inspected, and removed where the set is
        refused and the folder is new.
    Raises InputError: wrong options, or a calibration of another rig, part or way to inspect; before the first set.
    """
    options, run = options or InspectOptions(), run or RunContext()
    if problems := options.problems():
        raise InputError(*problems)
    if calibration is not None:
        calibration.require_match(rig, part, options)
    cache = PredictionCache()
    for number, image_set in enumerate(sets):
        source = None if truth is None else truth[number]
        folder = nullcontext() if folders is None else folders[number].made()
        name = image_set.folder.resolve().name
        try:
            with folder:
                result = find_defects(rig, part, image_set, options, cache, calibration, run)
                evaluation = None if source is None else _evaluate(image_set, result, rig, source)
        except InputError as error:
            yield InspectedSet(name=name, error=error)
            continue
        warnings = (*(() if source is None else source.warnings), *result.warnings)
        run.warn(*(f"{name}: {text}" if len(sets) > 1 else text for text in warnings))
        yield InspectedSet(
            name=name,
            result=result,
            verdict=judge(result, part.inspection),
            evaluation=evaluation,
            warnings=warnings,
        )


def _evaluate(
    image_set: ImageSet, result: InspectionResult, rig: RigConfig, source: TruthSource
) -> SetEvaluation:
    known = () if source.part is None else place_defects(result.nominal, rig, source.part)
    return evaluate_set(image_set, result, known=known)
