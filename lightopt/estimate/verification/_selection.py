"""Which faults explain the images: the set of groups with the greatest evidence, and those that explain as much.

The model is linear in the faults around the present ones. The evidence of a set of groups (Kass and Raftery 1995,
doi:10.1080/01621459.1995.10476572) counts what they explain, less what any group of so many free parameters would.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.least_squares import weighted_sums
from lightopt.estimate.verification._model import Linearised
from lightopt.estimate.verification._parameters import Group, Parameters

# twice the logarithm of how much more likely it is, before there are images, that a group is as it was
PRIOR_ODDS = 14.0

MOST_GROUPS = 6
HUBER = 1.5
ROUNDS = 5

# another group explains as much if it leaves no more than this share of what the group explains, or this evidence
SAME_SHARE, SAME_EVIDENCE = 0.05, 10.0


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
