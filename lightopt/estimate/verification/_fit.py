"""Fit faults to images: Gauss–Newton steps, each with the groups of parameters that the evidence is greatest for.

The model of the levels at some blocks of pixels is linear in the faults around the present ones. The evidence of a set
of groups (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572) counts what they explain, less what any group of
so many free parameters would.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError
from lightopt.core.least_squares import weighted_sums
from lightopt.core.threads import in_threads, threads_each
from lightopt.estimate import registration
from lightopt.estimate.registration import Agreement, PixelSet, agreement
from lightopt.estimate.verification._parameters import CoarseImage, Group, Parameters, Predictions, Work, blurred
from lightopt.optics import clipped_mean
from lightopt.scene import PartView

SIGMA_STEP = 0.01
MISFIT_SHARE = 0.01  # of the predicted level: models are no better than that, even of the right part
LEAST_BLOCKS = 200  # of each posture
CLEAR = 4.0  # blocks that the model has this many standard deviations of a pixel below saturation are used
BLUR_PX = 1.5  # blur for the difference
CELLS = 24  # of neighbouring blocks, along the width of an image
# derivatives serve rigs whose images differ by less than this, and whose lobes by this share
ALIKE_BLOCKS, ALIKE_SHARE = 0.15, 0.02


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """What is fitted, and how far images and model are trusted."""

    # of a calibrated rig from its file, independent ones of one standard deviation each, shape (K, D); a known good set
    # has them, too
    deviations: Float64
    groups: tuple[Group, ...] | None = None  # faults that there are; None for those that the evidence is greatest for
    blocks: int = 1500  # of each posture, at most
    rows: int = 16_000  # of all postures and lights together, about
    misfit_share: float = MISFIT_SHARE
    # blocks that change this many times as much as nine of ten do lie across the edge of a shadow or on the steep flank
    # of a highlight: few of them would outweigh all others
    steepest: float = 15.0
    few_steps: int = 4  # at most so many with few blocks come first
    most_steps: int = 6  # with all blocks
    settled: float = 0.1  # a step is the last if it changes no parameter by more than this share of its limit


class Model:
    """What the rig with some faults shows at n blocks of all images; arrays of shape (n,) unless said.

    Blocks are chosen at random, the same ones each time.

    measured: Level, black level included [sensor level].
    cell: Number of a cell of neighbouring blocks of an image.
    """

    def __init__(
        self, work: Work, images: Sequence[CoarseImage], predictions: Predictions, options: FitOptions
    ) -> None:
        self._work, self._options = work, options
        self.scene, self.parameters = work.coarse, work.parameters
        kinds = len({(image.source.posture, image.source.light) for image in images})
        budget = max(LEAST_BLOCKS, min(options.blocks, options.rows // kinds))
        self._sets: list[PixelSet] = []  # of each posture
        columns: list[list[NDArray[Any]]] = []  # of each image
        for posture, prediction in predictions.items():
            mine = [n for n, image in enumerate(images) if image.source.posture == posture]
            row, column = registration.random_pixels(prediction.clean, budget)
            if not len(row):
                continue
            levels = np.stack([images[n].levels[row, column] for n in mine]).astype(np.float64)
            full = np.stack([images[n].saturated[row, column] for n in mine])
            pixels = PixelSet(
                posture=posture,
                row=row,
                column=column,
                images=tuple(images[n].source for n in mine),
                levels=levels,
                saturated=full,
            )
            self._sets.append(pixels)
            width = max(8, prediction.clean.shape[1] // CELLS)
            for own, n in enumerate(mine):
                level = prediction.levels[images[n].source.light]
                change = (blurred(level, BLUR_PX / work.side) - level)[row, column].astype(np.float64) / BLUR_PX**2
                cell = n * 1e7 + (row // width) * 1000 + column // width
                top = images[n].top[row, column]
                columns.append([np.full(len(row), n), levels[own], top, ~full[own], cell, change])
        # blur: change of the grey level per px² of variance of a blur
        some = np.concatenate([np.zeros((6, 0)), *map(np.stack, columns)], axis=1)
        image, self.measured, self._top, unsaturated, cell, self._blur = some
        self._open = unsaturated > 0.0
        self.cell = np.unique(cell, return_inverse=True)[1].astype(np.int32)
        on = image.astype(np.intp)
        self._light = np.array([self.parameters.lights.index(i.source.light) for i in images], np.intp)[on]
        self._scale = np.array([registration.sensor_scale(self.scene, i.source) for i in images])[on]
        self._count = np.array([float(i.count) for i in images])[on]
        self._corrected = False
        self._correction = np.zeros(len(on))
        self._kept: tuple[Float64, Float64] | None = None  # changes per parameter, and where they were found
        # what blocks see of the lights at each place of `levels`, and where that was found
        self._seen: tuple[Float64, list[list[Float64]]] | None = None

    def levels(self, theta: Float64) -> Float64:
        """Grey level of each row at exposure 1, shape (n,): means over the blocks.

        0 off the part, NaN where only some of a panel is seen.
        """
        # the mean of a cubic over the centres of n pixels is that of its values at two points
        off = math.sqrt((1.0 - 1.0 / self._work.side**2) / 12.0)
        places = list(dict.fromkeys(product((-off, off), (-off, off))))
        threads = self._work.run.threads
        light_at = partial(self._light_at, theta, threads=threads_each(len(places), threads))
        if self._seen is None or not self._alike(theta, self._seen[0]):
            self._seen = theta, [self._shares_seen(theta, place, threads=threads) for place in places]
        seen = self._seen[1]

        def at(number: int) -> Float64:
            return light_at(places[number], shares=seen[number])[0][0]

        some = in_threads(at, range(len(places)), threads)
        return np.mean(some, axis=0) + theta[self.parameters.nuisance[-1]] * self._blur

    def _light_at(
        self,
        theta: Float64,
        place: tuple[float, float] = (0.0, 0.0),
        *,
        widths: Sequence[float] = (1.0,),
        shares: Sequence[Float64],
        threads: int | None = None,
    ) -> tuple[Float64, Float64]:
        # At a point so far off the middle of each block [block]: the grey level without the blur, and its specular
        # part, of lobes that are so many times as wide, shape (widths, n).
        # shares: As `_shares_seen` of a rig that hardly differs has them
        own, (factor_s, factor_sigma) = self.scene.reflectance, self.parameters.lobe_factors(theta)
        sigmas = [own.sigma * factor_sigma * width for width in widths]
        levels, speculars = [np.zeros((len(widths), 0))], [np.zeros((len(widths), 0))]
        for pixels, seen in zip(self._sets, shares, strict=True):
            view = self._view(pixels, theta, place)
            diffuse, specular = registration.light_at(
                self.scene, pixels, view, self._work.caster, sigmas=sigmas, shares=seen, threads=threads
            )
            specular = max(own.R_s, registration.LEAST_R_S) * factor_s * specular.reshape(len(widths), -1)
            levels.append(max(own.R_d, registration.LEAST_R_D) * diffuse.ravel() + specular)
            speculars.append(specular)
        return np.concatenate(levels, axis=1), np.concatenate(speculars, axis=1)

    def _shares_seen(
        self, theta: Float64, place: tuple[float, float] = (0.0, 0.0), *, threads: int | None
    ) -> list[Float64]:
        # of each posture what blocks see of the lights, at such a point
        sigma = self.scene.reflectance.sigma * self.parameters.lobe_factors(theta)[1]
        return [
            registration.shares_seen(
                self.scene, pixels, self._view(pixels, theta, place), self._work.caster, sigma=sigma, threads=threads
            )
            for pixels in self._sets
        ]

    def _view(self, pixels: PixelSet, theta: Float64, place: tuple[float, float]) -> PartView:
        view = self.parameters.view(self.scene, pixels.posture, theta)
        column, row = view.camera.axis_px
        return replace(view, camera=replace(view.camera, principal_point=(column - place[0], row - place[1])))

    def _changes(self, theta: Float64) -> Float64:
        # of the grey level per parameter that moves a body or changes the lobe or the blur, shape (n, K)
        if self._kept is not None:
            there, kept = self._kept
            if self._alike(theta, there):
                return kept
        p = self.parameters
        threads = self._work.run.threads
        seen = self._shares_seen(theta, threads=threads)
        (level, wider), (specular, _) = self._light_at(
            theta, widths=(1.0, 1.0 + SIGMA_STEP), shares=seen, threads=threads
        )
        changes = np.zeros((len(level), p.size))
        # panels are moved all at once: each image is of one of them
        moving: dict[str, list[Group]] = {}
        for group in p.groups:
            if group.step > 0.0:
                moving.setdefault(group.kind, []).append(group)
        steps = [(together, axis) for together in moving.values() for axis in range(together[0].size)]
        light_at = partial(self._light_at, shares=seen, threads=threads_each(len(steps), threads))

        def change(step: tuple[list[Group], int]) -> None:
            together, axis = step
            there = theta.copy()
            there[[group.first + axis for group in together]] += together[0].step
            by_step = (light_at(there)[0][0] - level) / together[0].step
            for group in together:
                changes[:, group.first + axis] = np.where(self._rows_of(group), by_step, 0.0)

        in_threads(change, steps, threads)
        changes[:, p.nuisance] = np.stack([specular, (wider - level) / math.log1p(SIGMA_STEP), self._blur], axis=1)
        self._kept = theta, changes
        return changes

    def _alike(self, a: Float64, b: Float64) -> bool:
        return self._work.alike(a, b, blocks=ALIKE_BLOCKS, share=ALIKE_SHARE)

    def _rows_of(self, group: Group) -> Bool:
        # which a fault changes
        if not group.light:
            return np.ones(len(self._light), np.bool_)
        return self._light == self.parameters.lights.index(group.light)

    def _unit(self, theta: Float64) -> Float64:
        # sensor levels per grey level
        p = self.parameters
        gains = np.array([theta[p.group("gain", name).first] for name in p.lights])
        return np.exp(theta[p.group("exposure").first] + gains)[self._light] * self._scale

    def _delivered(self, theta: Float64, level: Float64) -> tuple[Float64, Float64, Float64]:
        # what the camera delivers of grey levels, its change per sensor level of light, and its noise
        sensor = self.scene.sensor
        signal = self._unit(theta) * level
        black = sensor.black_level + float(theta[self.parameters.group("black").first])
        mean, share = clipped_mean(signal + black, sensor.read_noise_levels)
        sets = 2.0 if self._corrected else 1.0
        noise = sets * sensor.noise_variance(signal) / self._count + np.square(self._options.misfit_share * signal)
        return mean + self._correction, share, np.sqrt(noise)

    def predicted(self, theta: Float64) -> tuple[Float64, Float64]:
        """Level of each row with the correction by a baseline, and its noise [sensor level]."""
        mean, _, noise = self._delivered(theta, self.levels(theta))
        return mean, noise

    def correct(self, good: "Model", theta: Float64) -> None:
        """Let the prediction at some parameters be what a known good set shows at the same blocks."""
        self._open &= good._open
        self._correction = good.measured - self.predicted(theta)[0]
        self._corrected = True

    def linearise(self, theta: Float64) -> tuple[Float64, Float64, Bool]:
        """The model of n rows at some parameters, shape (K,).

        Measured minus predicted, shape (n,), and the derivatives of what is predicted, shape (n, K), both in standard
        deviations; rows that count, shape (n,).
        """
        p, sensor = self.parameters, self.scene.sensor
        changes, level = self._changes(theta), self.levels(theta)
        mean, share, noise = self._delivered(theta, level)
        unit = share * self._unit(theta)  # sensor level delivered per grey level
        slope = unit[:, None] * changes
        for group in p.groups:
            if group.kind == "black":
                slope[:, group.first] = share
            elif group.step == 0.0:
                slope[:, group.first] = np.where(self._rows_of(group), unit * level, 0.0)
        single = np.sqrt(sensor.noise_variance(np.maximum(mean - sensor.black_level, 0.0)))
        used = self._open & (mean + CLEAR * single < self._top)
        used &= np.isfinite(mean) & np.isfinite(slope).all(axis=1)
        for group in p.groups:
            if group.step == 0.0:
                continue
            size = np.abs(slope[:, group.where]).max(axis=1)
            own = used & self._rows_of(group)
            # a tenth of all rows change more; those of other lights do not change
            below = max(0.5, 1.0 - 0.1 * (len(p.lights) if group.light else 1))
            if own.any() and math.isfinite(self._options.steepest):
                used &= ~(size > self._options.steepest * np.quantile(size[own], below))
        residual = np.where(used, (self.measured - np.where(used, mean, 0.0)) / noise, 0.0)
        return residual, np.where(used[:, None], slope, 0.0) / np.where(used, noise, 1.0)[:, None], used


# twice the logarithm of how much more likely it is, before there are images, that a group is as it was
PRIOR_ODDS = 14.0
MOST_GROUPS = 6
HUBER, ROUNDS = 1.5, 5
# another group explains as much if it leaves no more than this share of what the group explains, or this evidence
SAME_SHARE, SAME_EVIDENCE = 0.05, 10.0
STALE_BLOCKS = 0.5  # blocks are chosen anew, and images rendered, where the part's image has moved by more than this
FEW = 4  # the rig is approached with this fraction of the blocks
AS_WELL = 1.02  # times the residual of another fit
LEAST_ROWS = 300  # fewer blocks of all images determine nothing
# an excess residual of more than this share of the level is not explained: the part may lie elsewhere
UNEXPLAINED_SHARE = 0.15
# the same where its image has moved by more than this, and the residual is still so many times the noise
FAR_BLOCKS, FAR_RESIDUAL = 4.0, 2.0
_Images = tuple[CoarseImage, ...]


@dataclass(frozen=True)
class Evidence:
    """Sums over all rows, which all sets of groups are compared with."""

    parameters: Parameters
    normal: Float64  # SᵀWS, shape (K, K), without what deviations of a calibrated rig explain as well
    pull: Float64  # SᵀWr, shape (K,), likewise, with r the residuals of the rig without faults
    inflation: float  # by how much neighbouring residuals that no fault explains exceed independent ones
    weight: Float64  # of each row, shape (n,)
    deviation_normal: Float64  # what `deviation` is linear in, shape (K, K), and (K,)
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


def gather(model: Model, theta: Float64, origin: Float64, deviations: Float64) -> Evidence:
    """Sums of the model linearised at some parameters, with weights by what no fault from the origin explains.

    deviations: Of a calibrated rig from its file, independent ones of one standard deviation each, shape (K, D)
    """
    parameters = model.parameters
    residual, slope, used = model.linearise(theta)
    target = residual + np.einsum("ij,j->i", slope, theta - origin)
    ridge = np.diag(1.0 / np.square(parameters.priors))
    weight = used.astype(np.float64)
    left = target
    for _ in range(ROUNDS):
        normal, toward = weighted_sums(slope, weight, target)
        left = target - np.einsum("ij,j->i", slope, np.linalg.solve(normal + ridge, toward))
        spread = max(1.0, 1.4826 * float(np.median(np.abs(left[used])))) if used.any() else 1.0
        weight = used * np.minimum(1.0, HUBER * spread / np.maximum(np.abs(left), 1e-12))
    pull = weight * left
    # sums over cells of neighbours, against what independent residuals would have
    sums = np.bincount(model.cell, pull)
    expected = np.bincount(model.cell, np.square(weight))
    counted = expected > 3.0
    ratio = np.square(sums[counted]) / expected[counted]
    inflation = max(1.0, float(np.mean(ratio)) if ratio.size else 1.0)
    normal, toward = weighted_sums(slope, weight, target)
    # Deviations are Gaussian beforehand. They are integrated out: what they explain is no evidence for a fault.
    through = normal @ deviations
    back = deviations @ np.linalg.inv(inflation * np.eye(deviations.shape[1]) + deviations.T @ through)
    by_normal, by_pull = back @ through.T, back @ (deviations.T @ toward)
    normal, pull = normal - normal @ by_normal, toward - normal @ by_pull
    return Evidence(parameters, normal, pull, inflation, weight, by_normal, by_pull)


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
    work: Work
    images: tuple[CoarseImage, ...]
    theta: Float64  # from the rig file, with what the rig file may be off, shape (K,)
    faults: Float64  # from the baseline, or from the rig file, shape (K,); covariance: Of these, (K, K)
    covariance: Float64
    chosen: tuple[Group, ...]
    evidence: Evidence
    left: Agreement  # what they leave
    registered: bool = False  # whether the part was searched for

    @cached_property
    def predictions(self) -> Predictions:
        """Images of the rig with these faults, rendered on first use."""
        return self.work.predict(self.theta)


def fit_faults(
    work: Work, images: _Images, good: Fit | None = None, *, options: FitOptions, where: str, register: bool
) -> Fit:
    """Find the faults that explain images, from those of a known good set or from the rig file.

    where: The set, for messages.
    register: Whether the part is searched for where it does not lie near its nominal placement.

    Raises InputError: images that show nothing, or that no faults explain.
    """
    observations = [image.source for image in images]
    registration.refuse_useless_images(work.scene, observations, caster=work.caster, threads=work.run.threads)
    origin = np.zeros(work.parameters.size) if good is None else good.theta
    if good is not None:
        options = replace(options, deviations=options.deviations[:, :0])
    fit_from = partial(descend, work, images, good, options, origin)
    fit = fit_from(origin)
    far = work.moved_blocks(fit.theta, origin) > FAR_BLOCKS
    if register and ((far and fit.left.residual > FAR_RESIDUAL * fit.left.noise) or fit.left.share > UNEXPLAINED_SHARE):
        found = registration.register(work.scene, observations, caster=work.caster, reduced=True, run=work.run)
        start = work.parameters.at_placement(work.scene, found.placement)
        fit = _simplest(fit, replace(fit_from(start), registered=True))
    motions = [group for group in fit.chosen if group.kind.startswith(("part", "camera"))]
    if far and len(motions) > 1 and options.groups is None:
        # from far off, several motions may take the place of a camera that has turned
        fit = _simplest(fit, fit_from(work.parameters.camera_instead(work.scene, fit.theta)))
    if (evaluable := int(np.count_nonzero(fit.evidence.weight))) < LEAST_ROWS:
        raise InputError(f"{where}: {evaluable} places are neither saturated nor at an edge, expected {LEAST_ROWS}")
    if fit.left.mismatch:
        raise InputError(
            f"{where}: the images do not look like this part on this rig: measured minus predicted is "
            f"{fit.left.residual:.3g} sensor levels rms with the faults that explain most, where the prediction is "
            f"{fit.left.level:.3g}; check that rig, part and postures are those of the images"
        )
    return fit


def _simplest(*fits: Fit) -> Fit:
    # that with the fewest faults of those that explain the images about as well as the best
    least = min(fit.left.residual for fit in fits)
    return min((fit for fit in fits if fit.left.residual <= AS_WELL * least), key=lambda fit: len(fit.chosen))


def descend(work: Work, images: _Images, good: Fit | None, options: FitOptions, origin: Float64, start: Float64) -> Fit:
    """Gauss–Newton steps from parameters to start at; what is found counts from the origin."""
    limits = np.concatenate([np.full(g.size, g.limit) for g in work.parameters.groups])
    report = work.run.stage("comparing with the prediction")
    theta = _approach(work, images, good, options, origin, start) if options.few_steps else start
    at = theta if work.moved_blocks(theta, start) > STALE_BLOCKS else start
    model, step = _model(work, images, good, at, options), 0
    while True:
        if report is not None:
            report(step / options.most_steps)
        before, step = theta, step + 1
        evidence, chosen, faults, covariance, theta = _step(model, before, origin, options)
        if (np.abs(theta - before)[: len(limits)] / limits).max() < options.settled or step == options.most_steps:
            break
        if work.moved_blocks(theta, at) > STALE_BLOCKS:
            at, model = theta, _model(work, images, good, theta, options)
    mean, noise = model.predicted(theta)
    black = work.scene.sensor.black_level
    known = np.isfinite(mean) & (evidence.weight > 0.0)
    left = agreement(model.measured[known] - black, mean[known] - black, noise[known])
    return Fit(work, images, theta, faults, covariance, chosen, evidence, left)


def _approach(
    work: Work, images: _Images, good: Fit | None, options: FitOptions, origin: Float64, start: Float64
) -> Float64:
    # parameters after steps with few blocks
    few = replace(options, blocks=options.blocks // FEW, rows=options.rows // FEW)
    model, theta = _model(work, images, good, start, few), start
    for _ in range(options.few_steps):
        before, theta = theta, _step(model, theta, origin, few)[-1]
        if work.moved_blocks(theta, before) <= STALE_BLOCKS:
            break
    return theta


def _step(
    model: Model, theta: Float64, origin: Float64, options: FitOptions
) -> tuple[Evidence, tuple[Group, ...], Float64, Float64, Float64]:
    # the evidence at some parameters, the groups with faults, these and their covariance, and the parameters with them
    evidence = gather(model, theta, origin, options.deviations)
    chosen = choose(evidence) if options.groups is None else options.groups
    _, faults, covariance = evidence.solve(chosen)
    return evidence, chosen, faults, covariance, origin + faults + evidence.deviation(faults)


def _model(work: Work, images: Sequence[CoarseImage], good: Fit | None, at: Float64, options: FitOptions) -> Model:
    # of blocks that are clean with some faults
    predictions = work.predict(at)
    model = Model(work, images, predictions, options)
    if good is not None:
        model.correct(Model(work, good.images, predictions, options), good.theta)
    return model
