"""Learn from good parts: their common deviations, and the highest scores that they reach."""

import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError, refuse
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.images import ImageSet, posture_folder
from lightopt.inspection._options import InspectOptions
from lightopt.inspection.calibration import _calibration, _systematic
from lightopt.inspection.detection._registry import DETECTORS
from lightopt.inspection.detection._texture import GREATEST_LEARNED_Z, compare, whiten_texture
from lightopt.inspection.fusion._synthetic_image import synthetic_image
from lightopt.inspection.prediction._prediction_cache import PredictionCache
from lightopt.inspection.prediction._registered_set import ExposuresByLight, RegisteredSet, nominal_pixels, register_set
from lightopt.inspection.prediction._template_bank import TemplateBank
from lightopt.scene import build_catalogue


@dataclass
class _GoodPosture:
    """What is gathered of one posture from good set to good set."""

    exposures: ExposuresByLight
    first_set: str
    packed: list[Path] = field(default_factory=list)
    peaks: list[float] = field(default_factory=list)
    sums: _systematic.SystematicSums = field(default_factory=_systematic.SystematicSums)
    # of the deviations from the model, where good parts are the reference and not the model; the others are then
    # deviations from that
    mean: _systematic.SystematicDeviations | None = None

    def refer_to_mean(self, threads: int | None) -> None:
        """Replace the deviations of each set from the model by those from the mean of the others."""
        from_model, self.sums = self.sums, _systematic.SystematicSums()
        self.mean = from_model.systematic().where_known()
        for path in self.packed:
            one = _read(path)
            nominal = one.nominal_image()
            found = _systematic.subtract_mean(
                one.at_pixels(one.own), from_model.systematic(but=one).where_known(), nominal
            )
            packed = _systematic.PackedDeviations.of(whiten_texture(found, threads=threads), nominal)
            self.sums.add(packed)
            path.write_bytes(pickle.dumps(packed))

    @property
    def systematic(self) -> _systematic.SystematicDeviations | None:
        """What the sets have in common; None for a detector that does not use deviations."""
        if not self.packed:
            return None
        common = self.sums.systematic()
        return common if self.mean is None else replace(common, mean=self.mean.mean)

    def judge_next(self, options: InspectOptions, bank: TemplateBank, threads: int | None) -> None:
        """Judge the first set that is not judged yet by what the others have in common."""
        one = _read(self.packed[len(self.peaks)])
        common, found = self.sums.systematic(but=one), one.at_pixels(one.own)
        subtract = _systematic.subtract_systematic if self.mean is None else _systematic.divide_spread
        found = subtract(found, common, one.nominal_image())
        scores = DETECTORS[options.scored_by].score(found, options.min_images, None, bank, threads)
        self.peaks.append(float(scores.score.max(initial=0.0)))


def _read(path: Path) -> _systematic.PackedDeviations:
    return pickle.loads(path.read_bytes())  # noqa: S301 - a temporary file of this run


def calibrate(
    rig: RigConfig, part: PartConfig, sets: Sequence[ImageSet], options: InspectOptions, run: RunContext | None = None
) -> _calibration.Calibration:
    """Learn from image sets of good parts.

    Each set is judged by what the others have in common, so that its greatest score is that of a set which was not
    learned from.

    sets: Of good parts, all of the same postures and lights.
    options: How later sets will be inspected; `false_alarms` is the rate that is to be held.
    Raises InputError: too few sets for the rate, sets that differ in their postures or images, or images that are not
        the part's.
    """
    run = run or RunContext()
    refuse(options.problems())
    cache = PredictionCache()
    catalogue = build_catalogue(part) if DETECTORS[options.scored_by].uses_catalogue else ()
    how: dict[str, Any] = {"register": options.register, "reference": options.reference, "cache": cache}

    def registered() -> Iterator[tuple[str, RegisteredSet]]:
        for one in sets:
            yield str(one.folder), register_set(rig, part, one, **how, run=run.within(f"good set {one.folder.name}"))

    def banks() -> Iterator[tuple[Posture, TemplateBank]]:
        for _, one in registered():
            for view, exposures in one.views:
                yield view.posture, cache.template_bank(one.scene, view, exposures, catalogue, threads=run.threads)

    names = tuple(one.folder.resolve().name for one in sets)
    fingerprint = _calibration.calibration_fingerprint(rig, part, options)
    return calibrate_registered(
        registered(), names, options=options, fingerprint=fingerprint, banks=banks, threads=run.threads
    )


def calibrate_registered(
    sets: Iterator[tuple[str, RegisteredSet]],
    names: Sequence[str],
    *,
    options: InspectOptions,
    fingerprint: dict[str, object],
    banks: Callable[[], Iterator[tuple[Posture, TemplateBank]]] | None = None,
    threads: int | None = None,
) -> _calibration.Calibration:
    """Learn from registered image sets of good parts.

    sets: Each with its name for messages; taken one at a time.
    names: Of all sets.
    fingerprint: What the calibration is valid for, from :func:`calibration_fingerprint`.
    banks: Makes what the catalogue's defects would change in each posture of each set, in the order of the sets, for a
        detector that tests for them. A set is judged when it is known what all have in common, and the banks of all
        sets at once would fill the memory.
    """
    require_good_sets(len(names), options)
    detector, learned = DETECTORS[options.scored_by], options.reference == "good-parts"
    postures: dict[Posture, _GoodPosture] = {}
    with tempfile.TemporaryDirectory(prefix="lightopt-calibration-") as folder:
        for number, (name, registered) in enumerate(sets):
            seen: list[Posture] = []
            for view, exposures in registered.views:
                if number == 0:
                    postures[view.posture] = _GoodPosture(exposures, name)
                gathered = _same_images(postures, view.posture, exposures, name)
                seen.append(view.posture)
                view, found = compare(view, options.reference, registered.neighbourhood_px, threads=threads)
                if detector.uses_synthetic:
                    assert options.fusion is not None
                    make_synthetic = partial(synthetic_image, view, options.fusion, probes=0, threads=threads)
                    scores = detector.score(found, options.min_images, make_synthetic, (), threads)
                    gathered.peaks.append(float(scores.score.max(initial=0.0)))
                    continue
                nominal = nominal_pixels(view, registered.nominal, registered.placement)
                packed = _systematic.PackedDeviations.of(
                    found, nominal, greatest=GREATEST_LEARNED_Z if learned else _systematic.GREATEST_Z
                )
                gathered.sums.add(packed)
                path = Path(folder) / f"{number}-{posture_folder(view.posture)}.pickle"
                path.write_bytes(pickle.dumps(packed))
                gathered.packed.append(path)
            if missing := [posture for posture in postures if posture not in seen]:
                raise InputError(
                    f"{name}: no images of posture {', '.join(map(str, missing))}, which "
                    f"{postures[missing[0]].first_set} has; give good sets of the same postures"
                )
        if learned:
            for gathered in postures.values():
                gathered.refer_to_mean(threads)
        if detector.uses_catalogue:
            assert banks is not None
            for posture, bank in banks():
                postures[posture].judge_next(options, bank, threads)
        elif not detector.uses_synthetic:
            for gathered in postures.values():
                for _ in gathered.packed:
                    gathered.judge_next(options, (), threads)
        learned_of = tuple(
            _calibration.CalibratedPosture(posture, one.exposures, tuple(one.peaks), one.systematic)
            for posture, one in postures.items()
        )
        rate = options.false_alarms
        return _calibration.Calibration(rate=rate, sets=tuple(names), postures=learned_of, fingerprint=fingerprint)


def require_good_sets(sets: int, options: InspectOptions) -> None:
    """Refuse a number of good sets that is too small for the rate of false alarms.

    Raises InputError: too few; the message names how many are needed.
    """
    if options.false_alarms < _calibration.least_rate(sets):
        raise InputError(_calibration.too_few_good_sets(sets, options.false_alarms, "the calibration"))


def _same_images(
    postures: dict[Posture, _GoodPosture], posture: Posture, exposures: ExposuresByLight, name: str
) -> _GoodPosture:
    gathered = postures.get(posture)
    if gathered is None or gathered.exposures != exposures:
        what = "of a posture that the first lacks" if gathered is None else "under other lights or exposures"
        first = next(iter(postures.values())).first_set
        raise InputError(
            f"{name}, posture {posture}: images {what} ({first}); give good sets that were all taken in the same way"
        )
    return gathered
