"""Inspect image sets of parts: from rig, part and images to defects, inspected surface, verdict and warnings."""

import functools
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError, counted, percent, refuse
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import DARK_SPREAD, refuse_mismatch
from lightopt.images import ImageSet
from lightopt.inspection._files import InspectionFolder
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._results import InspectedPosture, InspectionResult, Verdict, judge
from lightopt.inspection.calibration._calibration import CalibratedPosture, Calibration
from lightopt.inspection.calibration._systematic import divide_spread, learned_view, subtract_mean, subtract_systematic
from lightopt.inspection.detection._coverage import (
    REFERENCE_CONTRAST,
    REFERENCE_DEFECT,
    measure_coverage,
    surface_coverage,
)
from lightopt.inspection.detection._defects import join_explained, merge_detections
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._regions import find_regions, measure_regions, split_regions
from lightopt.inspection.detection._registry import DETECTORS, RESIDUAL, Detector
from lightopt.inspection.detection._residual_score import threshold
from lightopt.inspection.detection._texture import compare, evaluable, texture_threshold, whiten_texture
from lightopt.inspection.evaluation._evaluation import SetEvaluation, TruthSource, evaluate_set
from lightopt.inspection.fusion._synthetic_image import synthetic_image
from lightopt.inspection.prediction._posture_view import PostureView, some_pixels
from lightopt.inspection.prediction._predict import REFERENCES
from lightopt.inspection.prediction._prediction_cache import PredictionCache
from lightopt.inspection.prediction._registered_set import RegisteredSet, nominal_pixels, register_set
from lightopt.inspection.prediction._template_bank import TemplateBank
from lightopt.scene import build_catalogue, part_postures, place_defects

# a posture with more regions than this is not a part with so many defects: its model does not describe it
MOST_REGIONS = 1000

LEAST_SENSITIVE = 0.5  # texture that hides the reference defect on more of the surface than the rest is reported
MOST_DARK_SHARE = 0.01  # a black level that is further off than this share of the sensor's range is reported


def inspect_set(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: InspectOptions | None = None,
    cache: PredictionCache | None = None,
    calibration: Calibration | None = None,
    run: RunContext | None = None,
) -> InspectionResult:
    """Find the defects of the part that a set of images shows.

    image_set: Rendered or captured.
    cache: Of predictions, for the sets of a batch.
    calibration: Learned from good parts: thresholds are theirs, and what they have in common is no defect.
    Raises InputError: images that are not the rig's or not the part's, or not as those of the calibration.
    """
    inspector = Inspector(
        rig, part, options or InspectOptions(), cache or PredictionCache(), calibration, run or RunContext()
    )
    inspector.require_valid()
    result = inspector.inspect(image_set)
    inspector.run.warn(*result.warnings)
    return result


@dataclass(frozen=True, kw_only=True)
class InspectedSet:
    """The result of the inspection of one image set of a batch."""

    name: str
    # None where the set was refused
    result: InspectionResult | None = None
    verdict: Verdict | None = None
    evaluation: SetEvaluation | None = None  # against ground truth, where that was given
    warnings: tuple[str, ...] = ()
    error: InputError | None = None


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
    inspector = Inspector(rig, part, options or InspectOptions(), PredictionCache(), calibration, run or RunContext())
    inspector.require_valid()
    for number, image_set in enumerate(sets):
        source = None if truth is None else truth[number]
        folder = nullcontext() if folders is None else folders[number].created()
        name = image_set.folder.resolve().name
        try:
            with folder:
                result = inspector.inspect(image_set)
                evaluation = None
                if source is not None:
                    known = () if source.part is None else place_defects(result.nominal, rig, source.part)
                    evaluation = evaluate_set(image_set, result, known=known)
        except InputError as error:
            yield InspectedSet(name=name, error=error)
            continue
        warnings = (*(() if source is None else source.warnings), *result.warnings)
        inspector.run.warn(*(f"{name}: {text}" if len(sets) > 1 else text for text in warnings))
        yield InspectedSet(
            name=name, result=result, verdict=judge(result, part.inspection), evaluation=evaluation, warnings=warnings
        )


@dataclass(frozen=True)
class Inspector:
    """Inspects sets; takes what :func:`inspect_set` takes, and warns in the results only."""

    rig: RigConfig
    part: PartConfig
    options: InspectOptions
    cache: PredictionCache
    calibration: Calibration | None
    run: RunContext

    @property
    def detector(self) -> Detector:
        return DETECTORS.get(self.options.scored_by, RESIDUAL)

    def require_valid(self) -> None:
        """Refuse wrong options, and a calibration of another rig, part or way to inspect."""
        refuse(self.options.problems())
        if self.calibration is not None:
            self.calibration.require_match(self.rig, self.part, self.options)
        elif self.options.reference == "good-parts":
            raise InputError(
                "option 'reference': good-parts needs a calibration that was made from good parts with the same "
                "reference; make one with option 'calibrate', and give it by option 'calibration'"
            )

    def inspect(self, image_set: ImageSet) -> InspectionResult:
        how: dict[str, Any] = {"register": self.options.register, "reference": self.options.reference}
        adjustment = self.cache.adjustment
        try:
            registered = register_set(self.rig, self.part, image_set, **how, cache=self.cache, run=self.run)
            return self.inspect_registered(registered, str(image_set.folder))
        except InputError:
            self.cache.restore_adjustment(adjustment)  # a set that is refused says nothing about the rig
            raise

    def inspect_registered(self, registered: RegisteredSet, where: str) -> InspectionResult:
        """Find the defects of a set whose part is registered; `where` names the set in messages."""
        options, calibration, threads = self.options, self.calibration, self.run.threads
        postures: list[InspectedPosture] = []
        catalogue = build_catalogue(self.part) if self.detector.uses_catalogue else ()
        for view, exposures in registered.views:
            calibrated = None if calibration is None else calibration.of(view.posture, exposures, where=where)
            bank: TemplateBank = ()
            if catalogue:
                bank = self.cache.template_bank(registered.scene, view, exposures, catalogue, threads=threads)
            place = f"{where}, posture {view.posture}"
            postures.append(self._inspect_posture(view, registered, bank, calibrated, place))
        expected, found, adjustment = part_postures(self.part), registered.registration, self.cache.adjustment
        warnings = inspection_warnings(
            self.rig,
            postures,
            options,
            expected=expected,
            registration=(*registered.warnings, *(() if adjustment is None else adjustment.warnings)),
            calibrated=calibration is not None,
        )
        surface_map = self.cache.surface_map(registered.scene, expected, threads=threads)
        coverages = [(p.view.posture, p.coverage) for p in postures]
        return InspectionResult(
            defects=merge_detections([detection for p in postures for detection in p.detections]),
            postures=tuple(postures),
            placement=None if found is None else registered.placement,
            registration=found,
            adjustment=adjustment,
            warnings=warnings,
            reference=options.reference,
            nominal=registered.nominal,
            surface=surface_coverage(registered.nominal, coverages, surface_map),
        )

    def _inspect_posture(
        self,
        view: PostureView,
        registered: RegisteredSet,
        bank: TemplateBank,
        calibrated: CalibratedPosture | None,
        where: str,
    ) -> InspectedPosture:
        options, detector, threads = self.options, self.detector, self.run.threads
        make_synthetic = None
        if options.fusion is not None:
            make = functools.partial(synthetic_image, view, options.fusion, threads=threads)
            make_synthetic = functools.cache(make)
        view, found = self._compare(view, registered, calibrated, where)
        scores = detector.score(found, options.min_images, make_synthetic, bank, threads)
        pixels = int(view.clean.sum())
        if calibrated is None:
            high = threshold(options.false_alarms, pixels, detector.tests)
            if options.reference == "self":
                high = texture_threshold(scores.score, found, high, options.false_alarms)
        else:
            high = calibrated.threshold(options.false_alarms)
        explained = [one for one in scores.explained if one.score >= high]
        labels, count = find_regions(scores.unexplained, high)
        if count + len(explained) > MOST_REGIONS:
            raise InputError(
                f"{where}: {counted(count, 'region')} that differ from a good part, expected at "
                f"most {MOST_REGIONS:,}: {REFERENCES[options.reference].remedy}"
            )
        labels, count = split_regions(labels, count, scores.unexplained, found, high)
        labels, count, owners = join_explained(labels, count, explained)
        place: dict[str, Any] = {"scene": registered.nominal, "placement": registered.placement}
        detections = measure_regions(labels, count, scores.score, view, found, **place, owners=owners)
        judged = evaluable(found, view) if options.reference == "good-parts" else found
        # the synthetic image has no deviations to measure a contrast by: what the residual detector would find
        residual = threshold(options.false_alarms, pixels, RESIDUAL.tests)
        least = residual if detector.uses_synthetic else high + scores.handicap
        return InspectedPosture(
            view=view,
            make_synthetic=make_synthetic,
            score=scores.score,
            labels=labels,
            threshold=high,
            detections=detections,
            coverage=measure_coverage(view, judged, min_images=options.min_images, high=least, threads=threads),
        )

    def _compare(
        self, view: PostureView, registered: RegisteredSet, calibrated: CalibratedPosture | None, where: str
    ) -> tuple[PostureView, Deviations]:
        # a view with the levels of the reference, and the deviations from them
        reference, threads = self.options.reference, self.run.threads
        view, found = compare(view, reference, registered.neighbourhood_px, threads=threads)
        if calibrated is None or calibrated.systematic is None:
            return view, found
        nominal = nominal_pixels(view, registered.nominal, registered.placement)
        if reference != "good-parts":
            return view, subtract_systematic(found, calibrated.systematic, nominal)
        learned = learned_view(view, found, calibrated.systematic, nominal)
        pixels = some_pixels(learned.clean)
        refuse_mismatch(learned.level, learned.predicted, learned.limit, learned.deviation, pixels, where)
        found = whiten_texture(subtract_mean(found, calibrated.systematic, nominal), threads=threads)
        return learned, divide_spread(found, calibrated.systematic, nominal)


def inspection_warnings(
    rig: RigConfig,
    postures: Sequence[InspectedPosture],
    options: InspectOptions,
    *,
    expected: Sequence[Posture] = (),
    registration: Sequence[str] = (),
    calibrated: bool = False,
) -> tuple[str, ...]:
    """Warnings of an inspection; `expected` are the postures of which there should be images."""
    limits, sensor = REFERENCES[options.reference].limits, rig.camera.sensor
    warnings = [f"reference {options.reference}: {limits}"] if limits else []
    if options.scored_by != options.detector:
        warnings.append(
            f"detector {options.detector}: tests for whole defects in noise that is independent from pixel to pixel, "
            f"which texture is not; with reference {options.reference}, detector {options.scored_by} is used"
        )
    if not calibrated and (caveat := DETECTORS[options.detector].caveat):
        warnings.append(f"detector {options.detector}: {caveat}")
    if not calibrated and sensor.read_noise_levels == 0.0 and not sensor.electrons_per_level:
        warnings.append(
            f"{rig.source.at('camera', 'sensor')}: no read_noise_levels and no electrons_per_level, so the only "
            "noise is rounding, and good parts may show regions; give the values of the sensor"
        )
    warnings += registration
    for one in postures:
        warnings += [f"posture {one.view.posture}: {text}" for text in _posture_warnings(rig, one, options)]
    there = {one.view.posture for one in postures}
    missing = [posture for posture in expected if posture not in there]
    warnings += [f"posture {one}: no images; surface that only this posture shows was not inspected" for one in missing]
    return tuple(warnings)


def _posture_warnings(rig: RigConfig, inspected: InspectedPosture, options: InspectOptions) -> list[str]:
    view, warnings = inspected.view, list[str]()
    sensor, dark = rig.camera.sensor, view.photometry.dark
    if abs(dark) > max(DARK_SPREAD, MOST_DARK_SHARE * 2**sensor.bit_depth):
        side = "above" if dark > 0.0 else "below"
        warnings.append(
            f"black is {abs(dark):.3g} sensor levels {side} the rig's black_level of {sensor.black_level:g}; the "
            "difference was subtracted; correct the rig file, or keep other light off the part"
        )
    if missing := [light.name for light in rig.lights if light.name not in view.lights]:
        warnings.append(f"no image under {', '.join(missing)}; inspected without it")
    if len(view.lights) < options.min_images:
        warnings.append(
            f"fewer images than the {options.min_images} that must show a defect; a defect must show in all of these"
        )
    if not view.clean.any():
        warnings.append("no pixel shows the part off its edges; nothing was inspected")
    elif inspected.coverage.inspected == 0.0:
        warnings.append("no pixel is reached by light and unsaturated in any image; nothing was inspected")
    elif options.reference == "self":
        share = inspected.coverage.sensitivity[REFERENCE_CONTRAST] / inspected.coverage.inspected
        if share < LEAST_SENSITIVE:
            warnings.append(
                f"texture or relief hides {REFERENCE_DEFECT} on {percent(1.0 - share)} of the inspected surface; "
                "compare with good parts (option 'reference': good-parts)"
            )
    return warnings
