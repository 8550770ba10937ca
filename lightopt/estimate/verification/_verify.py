"""Verify a rig: from rig, part and images to the faults that explain what the images show instead of the prediction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Float32, Float64
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation, observed_postures, read_observations
from lightopt.estimate.verification._coarse import CoarsePrediction
from lightopt.estimate.verification._findings import (
    Finding,
    dark_findings,
    focus_findings,
    group_finding,
    group_name,
    spot_findings,
    swap_findings,
)
from lightopt.estimate.verification._fit import Fit, Work, fit_faults
from lightopt.estimate.verification._focus import outline_blur
from lightopt.estimate.verification._lights import Compared, LightComparison, compare_image, compare_lights
from lightopt.estimate.verification._limits import VerifyLimits
from lightopt.estimate.verification._parameters import Parameters
from lightopt.estimate.verification._selection import alternatives
from lightopt.estimate.verification._spots import Spot, find_spots
from lightopt.estimate.verification._swaps import exchanged_lights, renamed
from lightopt.images import ImageSet
from lightopt.scene import Scene, build_scene

_MANY_SPOTS = (
    "the images differ from the prediction in more places than dust explains: check that the part file's mesh and "
    "reflectance are those of the part, or give a known good set (option 'baseline')"
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Verification:
    """How captured images differ from those predicted, and why.

    findings: Those that exceed their limits first.
    lights: Predicted against captured.
    unseen: Faults that these images would not show at their limits, in words.
    differences: By posture, light and exposure, measured minus predicted in standard deviations of noise and of what a
        model is off, without and with the faults in the prediction, shape (2, h, w).
    """

    findings: tuple[Finding, ...]
    lights: tuple[LightComparison, ...]
    unseen: tuple[str, ...]
    spots: tuple[Spot, ...]
    warnings: tuple[str, ...]
    limits: VerifyLimits
    registered: bool
    differences: Mapping[tuple[Posture, str, float], Float32]

    @property
    def within_tolerances(self) -> bool:
        """Whether no finding exceeds its limit."""
        return not any(finding.exceeds for finding in self.findings)

    @property
    def answer(self) -> str:
        """The result in a sentence."""
        beyond = [f for f in self.findings if f.exceeds]
        if beyond:
            return "the rig has left its tolerances: " + "; ".join(f"{f.cause}: {f.amount}" for f in beyond)
        return "the rig is within its tolerances"

    def as_dict(self) -> dict[str, Any]:
        return {
            "within_tolerances": self.within_tolerances,
            "answer": self.answer,
            "findings": [finding.as_dict() for finding in self.findings],
            "lights": [light.as_dict() for light in self.lights],
            "not_observable": list(self.unseen),
            "registered": self.registered,
            "warnings": list(self.warnings),
        }


def verify_set(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    baseline: ImageSet | None = None,
    limits: VerifyLimits | None = None,
    register: bool = True,
    run: RunContext | None = None,
) -> Verification:
    """Compare a set of images with what rig and part files predict, and name the causes of what differs.

    baseline: A known good set of the same part, postures, lights and exposures: changes since then are reported, and
        what the model is off does not count.
    limits: Within which the rig is in tolerance.
    register: Whether the part is searched for where it does not lie near its nominal placement.
    Raises InputError: images that are not the rig's or not the part's.
    """
    run = run or RunContext()
    used = {entry.light for entry in image_set.images}
    names = tuple(light.name for light in rig.lights if light.name in used)
    observations = read_observations(image_set, rig, part, threads=run.threads)
    scene = build_scene(rig, part, postures=observed_postures(image_set), lights=names, defects=False)
    good = None
    if baseline is not None:
        good = read_observations(baseline, rig, part, threads=run.threads)
        good = _matching(observations, good, str(image_set.folder), str(baseline.folder))
    return verify_observations(
        scene, observations, baseline=good, limits=limits, register=register, where=str(image_set.folder), run=run
    )


def verify_observations(
    scene: Scene,
    observations: Sequence[Observation],
    *,
    baseline: Sequence[Observation] | None = None,
    limits: VerifyLimits | None = None,
    register: bool = True,
    where: str = "images",
    run: RunContext | None = None,
) -> Verification:
    """As :func:`verify_set`, of images that are read, and the scene with their postures and lights.

    baseline: In the order of `observations`; `where`: The set, for messages.
    """
    run, limits = run or RunContext(), limits or VerifyLimits()
    work = Work(scene, Parameters.of(scene, limits), run)
    good = None
    if baseline is not None:
        good = fit_faults(work, work.blocks(baseline), where="the known good set", register=register)
    images = work.blocks(observations)
    exchanged = exchanged_lights(work.coarse, images, work.predict(np.zeros(work.parameters.size)))
    found = fit_faults(work, renamed(images, exchanged), good, where=where, register=register)
    return _report(work, found, good, exchanged, limits)


def _matching(
    observations: Sequence[Observation], good: Sequence[Observation], where: str, folder: str
) -> tuple[Observation, ...]:
    # the images of a known good set in the order of the others
    by_key = {(o.light, o.posture, round(o.exposure, 6)): o for o in good}
    keys = [(o.light, o.posture, round(o.exposure, 6)) for o in observations]
    missing = [o.name for o, key in zip(observations, keys, strict=True) if key not in by_key]
    if missing:
        raise InputError(
            f"{folder}: the known good set has no image {missing[0]}"
            f"{f' (and {len(missing) - 1} more)' if len(missing) > 1 else ''}, which {where} has; capture it with the "
            "same lights, postures and exposures"
        )
    return tuple(by_key[key] for key in keys)


def _report(work: Work, fit: Fit, good: Fit | None, exchanged: Mapping[str, str], limits: VerifyLimits) -> Verification:
    p, theta = work.parameters, fit.theta
    origin = np.zeros(p.size) if good is None else good.theta
    # the rig file with the part where it was found
    plain = origin.copy()
    for kind in ("part_shift", "part_turn"):
        plain[p.group(kind).where] = theta[p.group(kind).where]
    predictions = work.predict(plain)
    before = _compare(work, fit, good, plain, predictions)
    after = _compare(work, fit, good, theta, fit.predictions)
    by_posture: dict[Posture, list[Float32]] = {}
    for one in after:
        by_posture.setdefault(one.image.source.posture, []).append(one.deviation)
    spots, many = find_spots(work.coarse, p, theta, by_posture, fit.predictions, side=work.side)
    blur = _blur(work, fit, good)
    distances = {light.name: float(np.linalg.norm(light.centre)) for light in work.scene.lights}
    findings = [
        *swap_findings(exchanged),
        *(
            group_finding(
                group, theta - origin, fit.covariance, alternatives(fit.evidence, fit.chosen, group),
                distance=distances.get(group.light, 0.0),
            )
            for group in fit.chosen
        ),
        *dark_findings(
            [image.source for image in fit.images], [i.source for i in good.images] if good else (), limits.black
        ),
        *focus_findings(blur, limits.blur_px),
        *spot_findings(spots),
    ]  # fmt: skip
    unseen = [group_name(group) for group in p.groups if group not in fit.chosen and not fit.evidence.visible(group)]
    return Verification(
        findings=tuple(sorted(findings, key=lambda f: not f.exceeds)),
        lights=compare_lights(work.coarse, before, after, predictions, side=work.side),
        unseen=(*unseen, *(("focus",) if blur is None else ())),
        spots=spots,
        warnings=(_MANY_SPOTS,) if many else (),
        limits=limits,
        registered=fit.registered,
        differences={a.key: np.stack([b.deviation, a.deviation]) for b, a in zip(before, after, strict=True)},
    )


def _compare(
    work: Work, fit: Fit, good: Fit | None, theta: Float64, predictions: Mapping[Posture, CoarsePrediction]
) -> list[Compared]:
    found: list[Compared] = []
    for number, image in enumerate(fit.images):
        posture = image.source.posture
        other = None if good is None else (good.images[number], good.predictions[posture], good.theta)
        found.append(compare_image(work.coarse, work.parameters, theta, image, predictions[posture], other))
    return found


def _blur(work: Work, fit: Fit, good: Fit | None) -> float | None:
    # beyond that of the pixel, or of the known good set
    widths = [
        outline_blur(
            work.scene, work.parameters, one.theta, [image.source for image in one.images], one.predictions,
            caster=work.caster, side=work.side, threads=work.run.threads,
        )
        for one in (fit, good)
        if one is not None
    ]  # fmt: skip
    own = widths[0]
    if own is None or len(widths) == 1 or widths[1] is None:
        return own
    return math.sqrt(max(own**2 - widths[1] ** 2, 0.0))
