"""From a rig, a part and its images to defects, places and shares of the surface."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.align import Observation, Placement
from lightopt.config import PartConfig, RigConfig
from lightopt.errors import InputError, counted
from lightopt.images import ImageSet
from lightopt.inspection._calibration import CalibratedPosture, Calibration
from lightopt.inspection._coverage import Coverage
from lightopt.inspection._coverage_blocks import coverage_in_blocks
from lightopt.inspection._deviation import deviations
from lightopt.inspection._measure import measure_regions
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._photometry import DARK_SPREAD
from lightopt.inspection._pieces import separate_pieces
from lightopt.inspection._predictions import Predictions, lights_of
from lightopt.inspection._regions import find_regions
from lightopt.inspection._register import Progress, good_part, lay_over
from lightopt.inspection._score import SCALES_PX, threshold
from lightopt.inspection._scored import score_posture, synthetic_image
from lightopt.inspection._shots import Shots, shots_of
from lightopt.inspection._sightings import FoundDefect, Sighting, gather
from lightopt.inspection._slopes import node_steps
from lightopt.inspection._surface import SurfaceCoverage, surface_coverage
from lightopt.inspection._synthetic import SyntheticImage
from lightopt.inspection._systematic import nominal_pixels, without_systematic
from lightopt.inspection._view import PostureView, posture_view
from lightopt.scene import Scene
from lightopt.transforms import Posture

__all__ = ["InspectedPosture", "Inspection", "LaidSet", "inspect_set", "lay_set"]

Float32 = NDArray[np.float32]

MOST_DARK_SHARE = 0.01
"""A black level that is further off than this share of the sensor's range is told."""

MOST_REGIONS = 1000

UNKNOWN_TURN_RAD = math.radians(0.5)
"""Beyond this standard error the images do not tell how the part is turned."""
"""A posture with more regions than this is not a part with so many defects: its model does not describe it."""


@dataclass(frozen=True, kw_only=True)
class InspectedPosture:
    """One posture of an inspected part.

    Attributes
    ----------
    view
        Images and prediction.
    make_synthetic
        Makes the image without highlights; None where none was asked for.
    score
        −log₁₀ of the probability that noise alone looks as much like a defect, shape (H, W).
    labels
        Number of the region that each pixel belongs to, 0 for none, shape (H, W).
    threshold
        Score from which a region counts.
    sightings
        One per region.
    coverage
        Of the surface.
    """

    view: PostureView
    make_synthetic: Callable[[], SyntheticImage] | None
    score: Float32
    labels: NDArray[np.int32]
    threshold: float
    sightings: tuple[Sighting, ...]
    coverage: Coverage

    @cached_property
    def synthetic(self) -> SyntheticImage | None:
        """The image without highlights; None where none was asked for.

        It is made when it is first asked for: it takes several times as long as the verdict, which the residual
        detector reaches without it.
        """
        return None if self.make_synthetic is None else self.make_synthetic()

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
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
class Inspection:
    """What an inspection of one set of images found.

    Attributes
    ----------
    defects
        The highest score first.
    postures
        In the set's order.
    placement
        Where the part lies from where its file has it; None where it was not looked for.
    words
        What a person should know: missing lights and postures, and so on.
    nominal
        The scene with the part where its file has it.
    surface
        Of the part, each place counted once however many postures show it.
    """

    defects: tuple[FoundDefect, ...]
    postures: tuple[InspectedPosture, ...]
    placement: Placement | None
    words: tuple[str, ...]
    nominal: Scene = field(repr=False, compare=False)
    surface: SurfaceCoverage

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "defects": [defect.as_dict() for defect in self.defects],
            "postures": [posture.as_dict() for posture in self.postures],
            "surface": self.surface.as_dict(),
            "placement": None if self.placement is None else self.placement.as_dict(),
            "warnings": list(self.words),
        }


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
    coverages = [(p.view.posture, p.coverage) for p in postures]
    return Inspection(
        defects=gather([s for p in postures for s in p.sightings]),
        postures=tuple(postures),
        placement=placement,
        words=tuple(
            _words(rig, part, postures, options, placement=placement, calibrated=calibration is not None)
        ),
        nominal=laid.nominal,
        surface=surface_coverage(laid.nominal, coverages, predictions.surface_of(laid.scene, _asked(part))),
    )


@dataclass(frozen=True)
class LaidSet:
    """A set of images over which the model was laid.

    Attributes
    ----------
    nominal
        The scene with the part where its file has it.
    placement
        Where it lies from there.
    scene
        That the model is predicted from: the part lies where it was found, or nearly there.
    views
        Of each posture, in the set's order, made one at a time; with the exposures of its images.
    """

    nominal: Scene
    placement: Placement
    scene: Scene
    views: Iterator[tuple[PostureView, Shots]]


def lay_set(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: InspectOptions,
    predictions: Predictions,
    progress: Progress | None = None,
) -> LaidSet:
    """Look for the part of a set, and lay the good part over its images; takes what :func:`inspect_set` takes."""
    nominal, observations = good_part(
        rig, part, image_set, known=predictions.nominal, threads=options.threads
    )
    scene, placement, off = _find(nominal, observations, predictions, options, progress)

    def views() -> Iterator[tuple[PostureView, Shots]]:
        for number, posture in enumerate(scene.postures):
            if progress is not None:
                progress(f"posture {posture}", number / len(scene.postures))
            mine = [o for o in observations if o.posture == posture]
            lights = lights_of(scene, mine)
            prediction = predictions.of(scene, posture, lights, threads=options.threads)
            if off is not None:
                prediction = predictions.shifted(scene, posture, lights, off, threads=options.threads)
            where = str(image_set.folder)
            view = posture_view(scene, mine, prediction, where=where, threads=options.threads)
            yield view, shots_of(mine, view.lights)
        if options.shift and off is None:
            predictions.measure_misfit(scene, observations)

    return LaidSet(nominal, placement, scene, views())


def _find(
    nominal: Scene,
    observations: Sequence[Observation],
    predictions: Predictions,
    options: InspectOptions,
    progress: Progress | None,
) -> tuple[Scene, Placement, NDArray[np.float64] | None]:
    # the scene to predict with, where the part lies, and how many node steps off that scene
    if not options.shift:
        return *predictions.moved_to(nominal, Placement()), None
    near = predictions.nearby(nominal, observations, threads=options.threads)
    if near is None:
        scene, placement = lay_over(nominal, observations, threads=options.threads, progress=progress)
        return *predictions.moved_to(scene, placement), None
    scene, before, off = near
    x, y, turn = off * node_steps(scene)
    return scene, replace(before, x=before.x + x, y=before.y + y, turn=before.turn + turn), off


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


def _words(
    rig: RigConfig,
    part: PartConfig,
    postures: Sequence[InspectedPosture],
    options: InspectOptions,
    *,
    placement: Placement | None = None,
    calibrated: bool = False,
) -> list[str]:
    words: list[str] = []
    sensor = rig.camera.sensor
    if options.detector == "template" and not calibrated:
        words.append(
            "--detector template: its rate of false alarms is that of an image of even texture; on this part it is "
            "known only with --calibration"
        )
    if not calibrated and sensor.read_noise_levels == 0.0 and not sensor.electrons_per_level:
        words.append(
            f"{rig.source.at('camera', 'sensor')}: no read_noise_levels and no electrons_per_level, so that rounding "
            "is all the noise there is; good parts may show regions; give what the sensor has"
        )
    if placement is not None and placement.errors[2] > UNKNOWN_TURN_RAD:
        words.append(
            "the images do not tell how the part is turned about the stage's axis "
            f"(± {math.degrees(placement.errors[2]):.2g}°): it is taken to lie as its file has it, and places on it "
            "are by that; a body of revolution has no other"
        )
    for p in postures:
        dark = p.view.photometry.dark
        if abs(dark) > max(DARK_SPREAD, MOST_DARK_SHARE * 2**sensor.bit_depth):
            side = "above" if dark > 0.0 else "below"
            words.append(
                f"posture {p.view.posture}: black is {abs(dark):.3g} sensor levels {side} the rig's black_level of "
                f"{sensor.black_level:g}; judged with that taken out; correct the rig file, or keep other light off "
                "the part"
            )
        missing = [light.name for light in rig.lights if light.name not in p.view.lights]
        if missing:
            words.append(f"posture {p.view.posture}: no image under {', '.join(missing)}; judged without")
        if len(p.view.lights) < options.seen_by:
            words.append(
                f"posture {p.view.posture}: fewer images than the {options.seen_by} that a defect must show in; what "
                "shows in all there are counts"
            )
        if not p.view.clean.any():
            words.append(
                f"posture {p.view.posture}: no pixel shows the part off its edges; nothing was inspected"
            )
        elif p.coverage.inspected == 0.0:
            words.append(
                f"posture {p.view.posture}: no pixel is reached by light and unsaturated in any image; nothing "
                "was inspected"
            )
    there = {p.view.posture for p in postures}
    words.extend(
        f"posture {posture}: no images; what only it shows was not inspected"
        for posture in _asked(part)
        if posture not in there
    )
    return words


def _asked(part: PartConfig) -> list[Posture]:
    return [Posture(elevation_deg=p.elevation_deg, rotation_deg=p.rotation_deg) for p in part.postures]
