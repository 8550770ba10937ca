"""Fit faults to images: Gauss–Newton steps, each with the groups of parameters that the evidence is greatest for.

The model is linear in the faults around the present ones. The evidence of a set of groups (Kass and Raftery 1995,
doi:10.1080/01621459.1995.10476572) counts what they explain, less what any group of so many free parameters would.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.errors import InputError
from lightopt.core.least_squares import weighted_sums
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Agreement, agreement, refuse_useless_images, register as register_part
from lightopt.estimate.verification._coarse import CoarseImage, CoarsePrediction, Work
from lightopt.estimate.verification._model import Linearised, Model
from lightopt.estimate.verification._parameters import Group, Parameters

# twice the logarithm of how much more likely it is, before there are images, that a group is as it was
PRIOR_ODDS = 14.0

MOST_GROUPS = 6
HUBER = 1.5
ROUNDS = 5

# another group explains as much if it leaves no more than this share of what the group explains, or this evidence
SAME_SHARE, SAME_EVIDENCE = 0.05, 10.0

MOST_STEPS = 6
SETTLED = 0.05  # a step is the last if it changes no parameter by more than this share of its limit
STALE_BLOCKS = 0.5  # blocks are chosen anew, and images rendered, where the part's image has moved by more than this
LEAST_ROWS = 300  # fewer blocks of all images determine nothing

# an excess residual of more than this share of the level is not explained: the part may lie elsewhere
UNEXPLAINED_SHARE = 0.15
# the same where its image has moved by more than this, and the residual is still so many times the noise
FAR_BLOCKS, FAR_RESIDUAL = 4.0, 2.0


@dataclass(frozen=True)
class Evidence:
    """Sums over all rows, which all sets of groups are compared with.

    normal: SᵀWS, shape (K, K); pull: SᵀWr, shape (K,), with r the residuals of the rig without faults. Both without
        what deviations of a calibrated rig explain as well.
    deviation_normal, deviation_pull: What :meth:`deviation` is linear in, shapes (K, K) and (K,).
    """

    parameters: Parameters
    normal: Float64
    pull: Float64
    inflation: float  # by how much neighbouring residuals that no fault explains exceed independent ones
    weight: Float64  # of each row, shape (n,)
    deviation_normal: Float64
    deviation_pull: Float64

    def solve(self, groups: Sequence[Group]) -> tuple[float, Float64, Float64]:
        """Twice the log evidence of some groups, the parameters, shape (K,), and their covariance (K, K)."""
        p = self.parameters
        at = [*itertools.chain.from_iterable(range(g.where.start, g.where.stop) for g in groups), *p.nuisance]
        scale = p.priors[at]
        inner = self.normal[np.ix_(at, at)] / self.inflation * np.outer(scale, scale) + np.eye(len(at))
        outer = self.pull[at] / self.inflation * scale
        found = np.linalg.solve(inner, outer)
        theta, covariance = np.zeros(p.size), np.zeros((p.size, p.size))
        theta[at] = scale * found
        covariance[np.ix_(at, at)] = np.linalg.inv(inner) * np.outer(scale, scale)
        value = float(outer @ found) - float(np.linalg.slogdet(inner)[1]) - PRIOR_ODDS * len(groups)
        return value, theta, covariance

    def deviation(self, theta: Float64) -> Float64:
        """How the calibrated rig deviates from its file if it has these faults, shape (K,)."""
        return self.deviation_pull - self.deviation_normal @ theta

    def visible(self, group: Group) -> bool:
        """Whether the images would show the group at its limit, all others being as they were."""
        at, p = np.arange(group.first, group.where.stop), self.parameters
        rest = p.nuisance
        normal = self.normal / self.inflation
        held = normal[np.ix_(rest, rest)] + np.diag(1.0 / np.square(p.priors[rest]))
        cross = normal[np.ix_(at, rest)]
        own = normal[np.ix_(at, at)] - cross @ np.linalg.solve(held, cross.T)
        return float(np.linalg.eigvalsh(own)[-1]) * group.limit**2 > 2.0 * PRIOR_ODDS


def gather(parameters: Parameters, model: Linearised, theta: Float64, cells: Int32, deviations: Float64) -> Evidence:
    """Sums of the model linearised at some parameters, with weights by what no fault explains.

    deviations: Of a calibrated rig from its file, independent ones of one standard deviation each, shape (K, D)
    """
    slope, target = model.slope, model.residual + np.einsum("ij,j->i", model.slope, theta)
    ridge = np.diag(1.0 / np.square(parameters.priors))
    weight = model.used.astype(np.float64)
    left = target
    for _ in range(ROUNDS):
        normal, toward = weighted_sums(slope, weight, target)
        left = target - np.einsum("ij,j->i", slope, np.linalg.solve(normal + ridge, toward))
        spread = max(1.0, 1.4826 * float(np.median(np.abs(left[model.used])))) if model.used.any() else 1.0
        weight = model.used * np.minimum(1.0, HUBER * spread / np.maximum(np.abs(left), 1e-12))
    pull = weight * left
    # sums over cells of neighbours, against what independent residuals would have
    sums = np.bincount(cells, pull)
    expected = np.bincount(cells, np.square(weight))
    counted = expected > 3.0
    ratio = np.square(sums[counted]) / expected[counted]
    inflation = max(1.0, float(np.mean(ratio)) if ratio.size else 1.0)
    normal, toward = weighted_sums(slope, weight, target)
    # Deviations are Gaussian beforehand. They are integrated out: what they explain is no evidence for a fault.
    through = normal @ deviations
    back = deviations @ np.linalg.inv(inflation * np.eye(deviations.shape[1]) + deviations.T @ through)
    by_normal, by_pull = back @ through.T, back @ (deviations.T @ toward)
    return Evidence(
        parameters, normal - normal @ by_normal, toward - normal @ by_pull, inflation, weight, by_normal, by_pull
    )


def choose(evidence: Evidence) -> tuple[Group, ...]:
    """The groups with the greatest evidence: from none, groups are added, exchanged and removed while that grows."""
    groups = evidence.parameters.groups
    chosen: tuple[Group, ...] = ()
    best = evidence.solve(chosen)[0]
    while True:
        others = [g for g in groups if g not in chosen]
        trials = [tuple(g for g in chosen if g is not out) for out in chosen]
        trials += [(*kept, new) for kept in [*trials] for new in others]
        if len(chosen) < MOST_GROUPS:
            trials += [(*chosen, new) for new in others]
        values = [evidence.solve(trial)[0] for trial in trials]
        at = int(np.argmax(values))
        if values[at] <= best + 1e-9:
            return chosen
        chosen, best = trials[at], values[at]


def alternatives(evidence: Evidence, chosen: Sequence[Group], group: Group) -> tuple[Group, ...]:
    """Groups that explain about as much as one of those chosen, in its stead."""
    rest = tuple(g for g in chosen if g is not group)
    whole, without = evidence.solve(chosen)[0], evidence.solve(rest)[0]
    allowed = max(SAME_EVIDENCE, SAME_SHARE * (whole - without))
    others = [g for g in evidence.parameters.groups if g not in chosen]
    values = [(evidence.solve((*rest, g))[0], g) for g in others]
    return tuple(g for value, g in sorted(values, key=lambda v: -v[0]) if whole - value < allowed)


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
