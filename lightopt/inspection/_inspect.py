"""Inspect the images of a part: from rig, part and image set to defects and inspected surface."""

from __future__ import annotations

from functools import cache, partial

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError, counted
from lightopt.core.run_context import RunContext
from lightopt.images import ImageSet
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._results import InspectedPosture, InspectionResult
from lightopt.inspection._warnings import inspection_warnings
from lightopt.inspection.calibration._calibration import CalibratedPosture, Calibration
from lightopt.inspection.calibration._systematic import subtract_systematic
from lightopt.inspection.detection._coverage import measure_coverage
from lightopt.inspection.detection._defects import merge_detections
from lightopt.inspection.detection._deviation import deviations
from lightopt.inspection.detection._measurement import measure_regions
from lightopt.inspection.detection._regions import find_regions, split_regions
from lightopt.inspection.detection._score import SCALES_PX, threshold
from lightopt.inspection.detection._surface_coverage import surface_coverage
from lightopt.inspection.detection._template import score_posture
from lightopt.inspection.fusion._synthetic_image import synthetic_image
from lightopt.inspection.prediction._frames import nominal_pixels
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._prediction_cache import PredictionCache
from lightopt.inspection.prediction._registered_set import RegisteredSet, register_set
from lightopt.scene import part_postures

MOST_REGIONS = 1000
"""A posture with more regions than this is not a part with so many defects: its model does not describe it."""


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
    options, run = options or InspectOptions(), run or RunContext()
    if problems := options.problems():
        raise InputError(*problems)
    if calibration is not None:
        calibration.require_match(rig, part, options)
    result = find_defects(rig, part, image_set, options, cache or PredictionCache(), calibration, run)
    run.warn(*result.warnings)
    return result


def find_defects(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    options: InspectOptions,
    cache: PredictionCache,
    calibration: Calibration | None,
    run: RunContext,
) -> InspectionResult:
    """As :func:`inspect_set`, with options and calibration that are checked; warnings are in the result only."""
    registered = register_set(rig, part, image_set, options=options, cache=cache, run=run)
    where = str(image_set.folder)
    postures: list[InspectedPosture] = []
    for view, exposures in registered.views:
        calibrated = None if calibration is None else calibration.of(view.posture, exposures, where=where)
        postures.append(_inspect_posture(view, options, registered, calibrated, where, run.threads))
    placement = registered.placement if options.shift else None
    expected = part_postures(part)
    warnings = inspection_warnings(
        rig,
        postures,
        options,
        expected=expected,
        registration=() if registered.registration is None else registered.registration.warnings,
        calibrated=calibration is not None,
    )
    surface_map = cache.surface_map(registered.scene, expected)
    coverages = [(p.view.posture, p.coverage) for p in postures]
    return InspectionResult(
        defects=merge_detections([detection for p in postures for detection in p.detections]),
        postures=tuple(postures),
        placement=placement,
        registration=registered.registration,
        warnings=warnings,
        nominal=registered.nominal,
        surface=surface_coverage(registered.nominal, coverages, surface_map),
    )


def _inspect_posture(
    view: PostureView,
    options: InspectOptions,
    registered: RegisteredSet,
    calibrated: CalibratedPosture | None,
    where: str,
    threads: int | None,
) -> InspectedPosture:
    found = deviations(view, threads=threads)
    if calibrated is not None and calibrated.systematic is not None:
        nominal = nominal_pixels(view, registered.nominal, registered.placement)
        found = subtract_systematic(found, calibrated.systematic, nominal)
    make_synthetic = None
    if options.fusion is not None:
        make_synthetic = cache(partial(synthetic_image, view, options.fusion, threads=threads))
    score, tests = score_posture(found, options, make_synthetic, threads=threads)
    if calibrated is None:
        high = threshold(options.false_alarms, int(view.clean.sum()), tests)
    else:
        high = calibrated.threshold(options.false_alarms)
    labels, count = find_regions(score, high)
    if count > MOST_REGIONS:
        raise InputError(
            f"{where}, posture {view.posture}: {counted(count, 'region')} that differ from a good part, expected at "
            f"most {MOST_REGIONS:,}: the model does not describe the part; check the sensor's noise in the rig file "
            "and that the images have it, give a STEP file, and fit the reflectance (lightopt fit-specular)"
        )
    labels, count = split_regions(labels, count, score, found, high)
    return InspectedPosture(
        view=view,
        make_synthetic=make_synthetic,
        score=score,
        labels=labels,
        threshold=high,
        detections=measure_regions(
            labels, count, score, view, found, scene=registered.nominal, placement=registered.placement
        ),
        coverage=measure_coverage(
            view,
            found,
            seen_by=options.seen_by,
            # templates have no deviations to measure a contrast by: theirs is what the other detector would find
            high=high
            if options.detector == "residual"
            else threshold(options.false_alarms, int(view.clean.sum()), len(SCALES_PX)),
            threads=threads,
        ),
    )
