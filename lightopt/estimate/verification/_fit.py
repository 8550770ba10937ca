"""Fit faults to images: Gauss–Newton steps, each with the groups of parameters that the evidence is greatest for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Agreement, agreement, refuse_useless_images, register as register_part
from lightopt.estimate.verification._coarse import CoarseImage, CoarsePrediction, Work
from lightopt.estimate.verification._model import Model
from lightopt.estimate.verification._parameters import Group
from lightopt.estimate.verification._selection import Evidence, choose, gather

MOST_STEPS = 6
SETTLED = 0.05  # a step is the last if it changes no parameter by more than this share of its limit

STALE_BLOCKS = 0.5  # blocks are chosen anew, and images rendered, where the part's image has moved by more than this

LEAST_ROWS = 300  # fewer blocks of all images determine nothing

# an excess residual of more than this share of the level is not explained: the part may lie elsewhere
UNEXPLAINED_SHARE = 0.15
# the same where its image has moved by more than this, and the residual is still so many times the noise
FAR_BLOCKS, FAR_RESIDUAL = 4.0, 2.0


@dataclass(frozen=True)
class Fit:
    """The faults that explain a set."""

    images: tuple[CoarseImage, ...]
    theta: Float64  # from the rig file, with what the rig file may be off, shape (K,)
    faults: Float64  # from the baseline, or from the rig file, shape (K,); covariance: Of these, (K, K)
    covariance: Float64
    chosen: tuple[Group, ...]
    evidence: Evidence
    predictions: dict[Posture, CoarsePrediction]  # of the rig with these faults
    left: Agreement  # what they leave
    registered: bool = False  # whether the part was searched for


def fit_faults(
    work: Work,
    images: tuple[CoarseImage, ...],
    good: Fit | None = None,
    *,
    deviations: Float64,
    where: str,
    register: bool,
) -> Fit:
    """Find the faults that explain images, from those of a known good set or from the rig file.

    deviations: Of a calibrated rig from its file, independent ones of one standard deviation each, shape (K, D); a
        known good set has them, too
    where: The set, for messages.
    register: Whether the part is searched for where it does not lie near its nominal placement.

    Raises InputError: images that show nothing, or that no faults explain.
    """
    observations = [image.source for image in images]
    refuse_useless_images(work.scene, observations, caster=work.caster, threads=work.run.threads)
    origin = np.zeros(work.parameters.size) if good is None else good.theta
    deviations = deviations if good is None else deviations[:, :0]
    fit = _descend(work, images, good, deviations, origin, origin)
    far = work.moved_blocks(fit.theta, origin) > FAR_BLOCKS and fit.left.residual > FAR_RESIDUAL * fit.left.noise
    if register and (far or fit.left.share > UNEXPLAINED_SHARE):
        found = register_part(work.scene, observations, caster=work.caster, reduced=True, run=work.run)
        start = work.parameters.at_placement(work.scene, found.placement)
        other = replace(_descend(work, images, good, deviations, origin, start), registered=True)
        fit = min(fit, other, key=lambda one: one.left.residual)
    if (evaluable := int(np.count_nonzero(fit.evidence.weight))) < LEAST_ROWS:
        raise InputError(
            f"{where}: only {evaluable} places of all images are neither saturated nor at an edge, expected at least "
            f"{LEAST_ROWS}; capture them with a shorter exposure, or of a larger part"
        )
    if fit.left.mismatch:
        raise InputError(
            f"{where}: the images do not look like this part on this rig: measured minus predicted is "
            f"{fit.left.residual:.3g} sensor levels rms with the faults that explain most, where the prediction is "
            f"{fit.left.level:.3g}; check that rig, part and postures are those of the images"
        )
    return fit


def _descend(
    work: Work, images: tuple[CoarseImage, ...], good: Fit | None, deviations: Float64, origin: Float64, start: Float64
) -> Fit:
    p = work.parameters
    limits = np.concatenate([np.full(g.size, g.limit) for g in p.groups])
    report = work.run.stage("comparing with the prediction")
    at, predictions = start, work.predict(start)
    model = _model(work, images, good, predictions)
    theta, step = start, 0
    while True:
        if report is not None:
            report(step / MOST_STEPS)
        if step and work.moved_blocks(theta, at) > STALE_BLOCKS:
            at, predictions = theta, work.predict(theta)
            model = _model(work, images, good, predictions)
        evidence = gather(p, model.linearise(theta), theta - origin, model.cell, deviations)
        chosen = choose(evidence)
        _, faults, covariance = evidence.solve(chosen)
        before, theta = theta, origin + faults + evidence.deviation(faults)
        change = np.abs(theta - before)[: len(limits)] / limits
        step += 1
        if change.max() < SETTLED or step == MOST_STEPS:
            break
    mean, noise = model.predicted(theta)
    black = work.scene.sensor.black_level
    known = np.isfinite(mean) & (evidence.weight > 0.0)
    left = agreement(model.measured[known] - black, mean[known] - black, noise[known])
    return Fit(images, theta, faults, covariance, chosen, evidence, work.predict(theta), left)


def _model(
    work: Work, images: Sequence[CoarseImage], good: Fit | None, predictions: Mapping[Posture, CoarsePrediction]
) -> Model:
    model = Model(work, images, predictions)
    if good is not None:
        model.correct(Model(work, good.images, predictions), good.theta)
    return model
