"""Inspect the images of a part: from rig, part and image set to defects and inspected surface."""

from __future__ import annotations

from functools import cache, partial

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError, counted
from lightopt.images import ImageSet
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._results import InspectedPosture, Inspection
from lightopt.inspection._warnings import inspection_words
from lightopt.inspection.calibration._calibration import CalibratedPosture, Calibration
from lightopt.inspection.calibration._systematic import without_systematic
from lightopt.inspection.detection._coverage import coverage_in_blocks
from lightopt.inspection.detection._defects import gather
from lightopt.inspection.detection._deviation import deviations
from lightopt.inspection.detection._measurement import measure_regions
from lightopt.inspection.detection._regions import find_regions, separate_pieces
from lightopt.inspection.detection._score import SCALES_PX, threshold
from lightopt.inspection.detection._surface_coverage import surface_coverage
from lightopt.inspection.detection._template import score_posture
from lightopt.inspection.fusion._synthetic_image import synthetic_image
from lightopt.inspection.prediction._frames import nominal_pixels
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._prediction_cache import Predictions
from lightopt.inspection.prediction._registered_set import LaidSet, Progress, lay_set
from lightopt.scene import part_postures

MOST_REGIONS = 1000
"""A posture with more regions than this is not a part with so many defects: its model does not describe it."""


def inspect_set(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: InspectOptions | None = None,
    predictions: Predictions | None = None,
    calibration: Calibration | None = None,
    progress: Progress | None = None,
) -> Inspection:
    """Find the defects of the part that a set of images shows.

    Parameters
    ----------
    rig, part
        What the images show; the defects that the part's file names are not looked at.
    image_set
        Rendered or captured.
    options
        How to inspect.
    predictions
        Kept from part to part of a batch.
    calibration
        What good parts taught: thresholds are theirs, and what they have in common is no defect.
    progress
        Called as the inspection goes on.

    Raises
    ------
    InputError
        Images that are not the rig's or not the part's, or not as those of the calibration.
    """
    options = options or InspectOptions()
    if problems := options.problems():
        raise InputError(*problems)
    if calibration is not None:
        calibration.refuse_others(rig, part, options)
    predictions = predictions or Predictions()
    laid = lay_set(rig, part, image_set, options=options, predictions=predictions, progress=progress)
    where = str(image_set.folder)
    postures: list[InspectedPosture] = []
    for view, shots in laid.views:
        learned = None if calibration is None else calibration.of(view.posture, shots, where=where)
        postures.append(_inspect_posture(view, options, laid, learned, where=where))
    placement = laid.placement if options.shift else None
    asked = part_postures(part)
    told = () if laid.registration is None else laid.registration.warnings
    words = inspection_words(
        rig, postures, options, asked=asked, registration=told, calibrated=calibration is not None
    )
    coverages = [(p.view.posture, p.coverage) for p in postures]
    return Inspection(
        defects=gather([s for p in postures for s in p.sightings]),
        postures=tuple(postures),
        placement=placement,
        registration=laid.registration,
        words=words,
        nominal=laid.nominal,
        surface=surface_coverage(laid.nominal, coverages, predictions.surface_of(laid.scene, asked)),
    )


def _inspect_posture(
    view: PostureView,
    options: InspectOptions,
    laid: LaidSet,
    learned: CalibratedPosture | None,
    *,
    where: str,
) -> InspectedPosture:
    found = deviations(view, threads=options.threads)
    if learned is not None and learned.systematic is not None:
        nominal = nominal_pixels(view, laid.nominal, laid.placement)
        found = without_systematic(found, learned.systematic, nominal)
    make_synthetic = None if options.fusion is None else cache(partial(synthetic_image, view, options))
    score, tests = score_posture(found, options, make_synthetic)
    if learned is None:
        high = threshold(options.false_alarms, int(view.clean.sum()), tests)
    else:
        high = learned.threshold(options.false_alarms)
    labels, count = find_regions(score, high)
    if count > MOST_REGIONS:
        raise InputError(
            f"{where}, posture {view.posture}: {counted(count, 'region')} that differ from a good part, expected at "
            f"most {MOST_REGIONS:,}: the model does not describe the part; check the sensor's noise in the rig file "
            "and that the images have it, give a STEP file, and fit the reflectance (lightopt fit-specular)"
        )
    labels, count = separate_pieces(labels, count, score, found, high)
    return InspectedPosture(
        view=view,
        make_synthetic=make_synthetic,
        score=score,
        labels=labels,
        threshold=high,
        sightings=measure_regions(
            labels, count, score, view, found, scene=laid.nominal, placement=laid.placement
        ),
        coverage=coverage_in_blocks(
            view,
            found,
            seen_by=options.seen_by,
            # templates have no deviations to tell a contrast by: theirs is what the other detector would find
            high=high
            if options.detector == "residual"
            else threshold(options.false_alarms, int(view.clean.sum()), len(SCALES_PX)),
            threads=options.threads,
        ),
    )
