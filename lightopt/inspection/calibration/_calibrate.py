"""Learn from good parts: what they have in common, and the highest scores that they reach."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.images import ImageSet, posture_folder
from lightopt.inspection._options import InspectOptions
from lightopt.inspection.calibration._calibration import CalibratedPosture, Calibration, made_for
from lightopt.inspection.calibration._false_alarm_rates import least_rate, too_few
from lightopt.inspection.calibration._systematic import (
    Residuals,
    Systematic,
    SystematicSums,
    without_systematic,
)
from lightopt.inspection.detection._deviation import deviations
from lightopt.inspection.detection._score import score_deviations
from lightopt.inspection.detection._template import score_posture
from lightopt.inspection.fusion._synthetic_image import synthetic_image
from lightopt.inspection.prediction._frames import nominal_pixels
from lightopt.inspection.prediction._prediction_cache import Predictions
from lightopt.inspection.prediction._registered_set import LaidSet, Progress, Shots, lay_set


@dataclass
class _Learning:
    """What is gathered of one posture while the good sets go by."""

    shots: Shots
    first: str
    kept: list[Path] = field(default_factory=list)
    peaks: list[float] = field(default_factory=list)
    sums: SystematicSums = field(default_factory=SystematicSums)


def calibrate(
    rig: RigConfig,
    part: PartConfig,
    sets: Sequence[ImageSet],
    *,
    options: InspectOptions,
    progress: Progress | None = None,
) -> Calibration:
    """Learn from image sets of good parts.

    Each set is judged by what the others have in common, so that its greatest score is that of a set which was not
    learned from.

    Parameters
    ----------
    rig, part
        What the images show.
    sets
        Of good parts, of one and the same postures and lights.
    options
        How later sets will be inspected; `false_alarms` is the rate that is to be held.
    progress
        Called as the learning goes on.

    Raises
    ------
    InputError
        Too few sets for the rate, sets that differ in their postures or images, or images that are not the part's.
    """
    if problems := options.problems():
        raise InputError(*problems)

    def laid() -> Iterator[tuple[str, LaidSet]]:
        predictions = Predictions()
        for number, one in enumerate(sets):
            if progress is not None:
                progress(f"good set {one.folder.name}", number / len(sets))
            yield str(one.folder), lay_set(rig, part, one, options=options, predictions=predictions)

    refuse_too_few(len(sets), options)
    names = tuple(one.folder.resolve().name for one in sets)
    return calibrate_laid(laid(), names, options=options, made=made_for(rig, part, options))


def calibrate_laid(
    sets: Iterator[tuple[str, LaidSet]],
    names: Sequence[str],
    *,
    options: InspectOptions,
    made: dict[str, object],
) -> Calibration:
    """Learn from good parts over whose images the model was laid.

    Parameters
    ----------
    sets
        Each with its name for messages; taken one at a time.
    names
        Of all sets.
    options
        As :func:`calibrate` takes them.
    made
        From :func:`lightopt.inspection.made_for`.
    """
    refuse_too_few(len(names), options)
    postures: dict[Posture, _Learning] = {}
    with tempfile.TemporaryDirectory(prefix="lightopt-calibration-") as folder:
        for number, (name, laid) in enumerate(sets):
            seen: list[Posture] = []
            for view, shots in laid.views:
                if number == 0:
                    postures[view.posture] = _Learning(shots, name)
                learning = _same(postures, view.posture, shots, name)
                seen.append(view.posture)
                found = deviations(view, threads=options.threads)
                if options.detector == "template":
                    score, _ = score_posture(
                        found, options, partial(synthetic_image, view, options, probes=0)
                    )
                    learning.peaks.append(float(score.max(initial=0.0)))
                    continue
                one = Residuals.of(found, nominal_pixels(view, laid.nominal, laid.placement))
                learning.sums.add(one)
                path = Path(folder) / f"{number}-{posture_folder(view.posture)}.npz"
                _keep(path, one)
                learning.kept.append(path)
            if missing := [posture for posture in postures if posture not in seen]:
                raise InputError(
                    f"{name}: no images of posture {', '.join(map(str, missing))}, which "
                    f"{postures[missing[0]].first} has; give good sets of the same postures"
                )
        return Calibration(
            rate=options.false_alarms,
            sets=tuple(names),
            postures=tuple(_learned(posture, one, options) for posture, one in postures.items()),
            made_for=made,
        )


def refuse_too_few(sets: int, options: InspectOptions) -> None:
    """Refuse a number of good sets that does not bear the rate of false alarms.

    Raises
    ------
    InputError
        Says how many it takes.
    """
    if options.false_alarms < least_rate(sets):
        raise InputError(too_few(sets, options.false_alarms, "--calibrate"))


def _same(postures: dict[Posture, _Learning], posture: Posture, shots: Shots, name: str) -> _Learning:
    learning = postures.get(posture)
    if learning is None or learning.shots != shots:
        what = "of a posture that the first lacks" if learning is None else "under other lights or exposures"
        first = next(iter(postures.values())).first
        raise InputError(
            f"{name}, posture {posture}: images {what} ({first}); give good sets that were all taken in the same way"
        )
    return learning


def _learned(posture: Posture, learning: _Learning, options: InspectOptions) -> CalibratedPosture:
    systematic = None
    peaks = learning.peaks
    if learning.kept:
        systematic = learning.sums.systematic()
        for path in learning.kept:
            one = _kept(path)
            others = learning.sums.systematic(but=one)
            peaks.append(_peak(one, others, options))
    return CalibratedPosture(posture=posture, shots=learning.shots, peaks=tuple(peaks), systematic=systematic)


def _peak(one: Residuals, others: Systematic, options: InspectOptions) -> float:
    found = without_systematic(one.in_own_image(), others, one.nominal_image())
    score = score_deviations(found, seen_by=options.seen_by)
    return float(score.max(initial=0.0))


def _keep(path: Path, one: Residuals) -> None:
    np.savez(
        path,
        shape=np.array(one.shape),
        own=one.own,
        nominal=one.nominal,
        z=one.z,
        usable=np.packbits(one.usable, axis=1),
        lit=np.packbits(one.lit, axis=1),
    )


def _kept(path: Path) -> Residuals:
    with np.load(path) as arrays:
        own = arrays["own"]
        rows, columns = (int(side) for side in arrays["shape"])
        usable, lit = (
            np.unpackbits(arrays[name], axis=1, count=len(own)).astype(np.bool_) for name in ("usable", "lit")
        )
        return Residuals((rows, columns), own, arrays["nominal"], arrays["z"], usable, lit)
