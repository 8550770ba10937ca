"""Weights of lights that are on together: evidence of the images that the camera takes, weights, and their bound.

Weights w are exposures of the lights relative to those of the samples. An image must not saturate: the level Σ w·L that
0.1 % of the part's pixels exceed is at most `room`. No w exceeds 1: longer exposures than those of the samples show no
less, so evidence is at least that of these weights. With the covariance V of good parts, the defect's contrasts Δ and
its levels L, all in levels of the samples' images, the images W (N × K) have

    E(W) = tr((W V Wᵀ + S)⁻¹ W Δ Δᵀ Wᵀ),   S = diag(a + b·w·L)

for a sensor whose noise has the variance a + b·level. An image with room for few photons is noisy: E of images of one
light each, added in software, would not be that of an image that the camera takes.

The bound. E = tr(Δᵀ (G⁻¹ + V)⁻¹ Δ) with G = Σ w wᵀ / s² over the images, which grows with G and is concave in it. A
mean over pixels c that leaves out the brightest 0.1 % is below their quantile, so c·w ≤ room and a ≥ a·c·w / room. By
Cauchy and Schwarz w wᵀ / s² ≤ diag(w / q), q = a·c / room + b·L. With u = Σ w over the images, E(W) ≤ F(u) =
tr(Δᵀ (diag(q / u) + V)⁻¹ Δ): as if each light had an image of its own, with u of the exposure. F is concave, and so is
the score of it. Its tangent plane at any u, maximised over 0 ≤ u ≤ N and C·u ≤ N·room, a linear programme, is a bound.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import optimize

from lightopt.core.arrays import Float32, Float64
from lightopt.core.kernels import kernel
from lightopt.design.from_images._choice import FOUND, score
from lightopt.design.from_images._evidence import TOP, Evidence

_STEPS = 60  # of each ascent
_QUICK_STEPS = 10
_BOUND_STEPS = 30
_SPREAD = 0.2  # weight of all other lights in the second start
_LEAST = 0.01  # weights below this share of an image's greatest are left out
_KINK = 0.05  # the score bends at the threshold; over so much of it in the search for a tangent plane
_OWN = 0.01  # share of the variance that is taken to be of parts where all of it is noise
_BRIGHTEST = (3, 10, 30, 100)  # times 0.1 % of the pixels: the brightest ones, whose means are bounded


@dataclass(frozen=True)
class Mixture:
    weights: Float64  # exposures of the lights relative to those of the samples, at most 1, shape (N, K)
    score: float
    single_score: float  # of the images of one light each, from which the search starts
    bound: float  # a score that no weights of as many images exceed


class MixedImages:
    """Evidence of images of several lights, as the camera takes them."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        deviations, levels = evidence.deviations.T, evidence.levels.T  # (J, K)
        self.levels: Float64 = levels
        self.contrasts: Float64 = evidence.contrasts * deviations[:, :, None]
        sensor = evidence.sensor[0] + evidence.sensor[1] * levels
        # what the sensor's noise leaves of the variance at the place of each defect
        varied = np.sqrt(np.maximum(deviations**2 - sensor, 0.0))
        parts = _correlation_of_parts(evidence.correlation, sensor.sum(axis=0) / np.sum(deviations**2, axis=0))
        parts = parts * varied[:, :, None] * varied[:, None, :]
        # neighbouring windows vary alike by the parts, and not by the sensor's noise; a little by each light alone
        spread = parts + _OWN * np.eye(levels.shape[1]) * deviations[:, :, None] ** 2
        alike = (evidence.thresholds / evidence.z**2 - 1.0) * np.sum(deviations**2, axis=1)
        self.parts: Float64 = parts + spread * (alike / np.trace(spread, axis1=1, axis2=2))[:, None, None]

    def exposed(self, weights: Float64) -> Float64:
        """Rows scaled to the longest exposures that neither saturate nor exceed those of the samples, (N, K)."""
        whole = weights / np.maximum(weights.max(axis=1, keepdims=True), 1e-300)
        return np.stack([row * min(1.0, self.evidence.room / max(self.top(row)[0], 1e-300)) for row in whole])

    def top(self, row: Float64) -> tuple[float, Float64]:
        """The level that 0.1 % of the part's pixels exceed in any posture, and its gradient by the weights, (K,)."""
        best, slope = 0.0, np.zeros(len(row))
        for surface in self.evidence.surface:
            levels = surface @ row.astype(np.float32)
            rank = TOP / 100.0 * (len(levels) - 1)
            ends = int(rank), min(int(rank) + 1, len(levels) - 1)
            low, high = surface[np.argpartition(levels, ends)[list(ends)]].astype(np.float64)
            near = low + (rank - ends[0]) * (high - low)
            if (top := float(near @ row)) > best:
                best, slope = top, near
        return best, slope

    def gains(self, weights: Float64) -> Float64:
        """E of each defect in units of its threshold, shape (J,), in images with weights up to a factor, (N, K)."""
        return self._gains(self.exposed(weights))[0]

    def _gains(self, exposed: Float64) -> tuple[Float64, Float64, Float64]:
        # E / T², and covariance⁻¹ · contrast and W · V of each defect
        constant, per_level = self.evidence.sensor
        varied, contrast = exposed @ self.parts, exposed @ self.contrasts
        own = constant + per_level * (self.levels @ exposed.T)
        solved = np.linalg.solve(varied @ exposed.T + np.eye(len(exposed)) * own[:, :, None], contrast)
        return np.sum(contrast * solved, axis=(1, 2)) / self.evidence.z**2, solved, varied

    def loss(self, weights: Float64) -> tuple[float, Float64]:
        """Minus the score of weights up to 1, which are reduced where they saturate, and its gradient, (N, K)."""
        room = self.evidence.room
        tops = [self.top(row) for row in weights]
        scales = np.array([min(1.0, room / max(top, 1e-300)) for top, _ in tops])
        x, solved, varied = self._gains(weights * scales[:, None])
        value, rate = _rounded_score(x)
        rate = rate / self.evidence.z**2
        own = self.contrasts.transpose(0, 2, 1) - solved.transpose(0, 2, 1) @ varied
        noise = self.evidence.sensor[1] * np.sum(solved**2, axis=2)[:, :, None] * self.levels[:, None]
        slope = np.sum(rate[:, None, None] * (2.0 * solved @ own - noise), axis=0)
        for row, (top, of_top), scale, own_slope in zip(weights, tops, scales, slope, strict=True):
            if scale < 1.0:
                own_slope -= (own_slope @ row) / top * of_top
            own_slope *= scale
        return -value, -slope / len(x)

    @cached_property
    def means(self) -> Float64:
        """Means over pixels that are below the level that 0.1 % of them exceed, for any weights, shape (M, K)."""
        found: list[Float32] = []
        for surface in self.evidence.surface:
            most = int(np.ceil((1.0 - TOP / 100.0) * len(surface)))
            brightness = surface / np.maximum(self.evidence.brightest, 1e-9).astype(np.float32)
            order = np.argsort(-brightness.sum(axis=1), kind="stable")
            sets = [order[: part * most] for part in _BRIGHTEST] + [order]
            sets += (
                [np.argpartition(-own, 2 * most)[: 2 * most] for own in surface.T] if len(surface) > 2 * most else []
            )
            for pixels in sets:
                if len(pixels) > most:
                    levels = np.sort(surface[pixels], axis=0)[: len(pixels) - most]
                    found.append(levels.mean(axis=0))
        return np.array(found, np.float64).reshape(-1, self.evidence.lights)

    def bound(self, start: Float64, images: int) -> tuple[float, Float64]:
        """A score that no weights of so many images exceed, and the exposures u of its tangent plane, shape (K,).

        start: Exposures near the best
        """
        room, limits = images * self.evidence.room, [(0.0, float(images))] * len(start)
        answer: Any = optimize.minimize(
            lambda u: self.tangent(u)[:2],
            start,
            jac=True,
            method="SLSQP",
            bounds=limits,
            constraints=[optimize.LinearConstraint(self.means, -np.inf, room)] if len(self.means) else [],
            options={"maxiter": _BOUND_STEPS, "ftol": 1e-5},
        )
        best, exposures = 1.0, start
        for u in (start, np.clip(answer.x, 0.0, images)):
            _, slope, value = self.tangent(u)
            most: Any = optimize.linprog(slope, A_ub=self.means, b_ub=np.full(len(self.means), room), bounds=limits)
            if (bound := value - float(most.fun) + float(slope @ u)) < best:
                best, exposures = bound, u
        return best, exposures

    @cached_property
    def _noise(self) -> Float64:
        # q, shape (J, K)
        constant, per_level = self.evidence.sensor
        share = self.means[0] / self.evidence.room if len(self.means) else np.zeros(self.evidence.lights)
        share = np.maximum(share, 1e-9)
        return constant * share + per_level * self.levels

    def tangent(self, u: Float64) -> tuple[float, Float64, float]:
        """Minus the score of F(u), whose kink is rounded; its gradient; the value at u of a plane above the score."""
        solved, left = _solved(self.parts, np.sqrt(np.maximum(u, 0.0) / self._noise), self.contrasts)
        x = np.sum(self.contrasts * solved, axis=(1, 2)) / self.evidence.z**2
        energies = np.sum(left**2, axis=2) / self.evidence.z**2
        value, rate = _rounded_score(x)
        slope = -(rate @ (energies / self._noise)) / len(x)
        margin = (1.0 - FOUND) * x / (1.0 + x)
        plane = FOUND + margin - (rate - (1.0 - FOUND) / (1.0 + x) ** 2) * (1.0 - x)
        return -value, slope, float(np.mean(plane))


def _correlation_of_parts(correlation: Float64, noise: Float64) -> Float64:
    # between the lights, of the variance without the sensor's share of it; no combination varies by less than nothing
    values, vectors = np.linalg.eigh(correlation - np.diag(np.minimum(noise, 1.0)))
    found = (vectors * np.maximum(values, 0.0)) @ vectors.T
    scale = np.sqrt(np.maximum(np.diag(found), 1e-12))
    found = found / np.outer(scale, scale)
    np.fill_diagonal(found, 1.0)
    return found


@kernel
def _solved(parts: Float64, roots: Float64, contrasts: Float64) -> tuple[Float64, Float64]:
    """X = (diag(q / u) + V)⁻¹ Δ of each defect, and what V leaves of the contrasts, Δ − V X, as Δ shaped (J, K, Q).

    By Cholesky's factorisation of 1 + R V R. parts: V, (J, K, K); roots: R = √(u / q), (J, K)
    """
    defects, lights, columns = contrasts.shape
    solved, left = np.zeros(contrasts.shape), np.empty(contrasts.shape)
    root = np.empty((lights, lights))
    used = np.empty(lights, np.int64)
    for j in range(defects):
        count = 0
        for i in range(lights):
            if roots[j, i] > 0.0:
                used[count] = i
                count += 1
        for a in range(count):
            i = used[a]
            for b in range(a + 1):
                k = used[b]
                total = roots[j, i] * parts[j, i, k] * roots[j, k]
                if a == b:
                    total += 1.0
                for m in range(b):
                    total -= root[a, m] * root[b, m]
                root[a, b] = math.sqrt(total) if a == b else total / root[b, b]
        for q in range(columns):
            for a in range(count):
                total = roots[j, used[a]] * contrasts[j, used[a], q]
                for m in range(a):
                    total -= root[a, m] * solved[j, used[m], q]
                solved[j, used[a], q] = total / root[a, a]
            for a in range(count - 1, -1, -1):
                total = solved[j, used[a], q]
                for m in range(a + 1, count):
                    total -= root[m, a] * solved[j, used[m], q]
                solved[j, used[a], q] = total / root[a, a]
            for a in range(count):
                solved[j, used[a], q] *= roots[j, used[a]]
        for i in range(lights):
            for q in range(columns):
                total = contrasts[j, i, q]
                for a in range(count):
                    total -= parts[j, i, used[a]] * solved[j, used[a], q]
                left[j, i, q] = total
    return solved, left


def _rounded_score(x: Float64) -> tuple[float, Float64]:
    # the score with a rounded kink, which is no less, and its derivative by each x, times their number
    short = np.clip((1.0 - x) / _KINK, 0.0, 1.0)
    lost = np.where(x < 1.0 - _KINK, 1.0 - x - _KINK / 2.0, short**2 * _KINK / 2.0)
    value = FOUND * (1.0 - lost) + (1.0 - FOUND) * x / (1.0 + x)
    return float(np.mean(value)), FOUND * short + (1.0 - FOUND) / (1.0 + x) ** 2


def mix_lights(mixed: MixedImages, lights: Sequence[int], *, quick: bool = False) -> Mixture:
    """Find non-negative weights for as many images as there are `lights`, which are the best single ones.

    quick: A short ascent from one start, for a score that several lights reach at least
    """
    single = np.eye(mixed.evidence.lights)[list(lights)]
    best, value = single, score(mixed.gains(single))
    alone = value

    def loss(flat: Float64) -> tuple[float, Float64]:
        lost, slope = mixed.loss(flat.reshape(single.shape))
        return lost, slope.ravel()

    bound, exposures = mixed.bound(mixed.exposed(single).sum(axis=0), len(single))
    shares = exposures / max(float(exposures.max()), 1e-300)
    starts = [np.maximum(single, least) for least in (shares, 0.0, _SPREAD, 1.0 - _SPREAD)]
    for start in starts[:1] if quick else starts:
        answer: Any = optimize.minimize(
            loss,
            start.ravel(),
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * single.size,
            options={"maxiter": _QUICK_STEPS if quick else _STEPS},
        )
        weights = answer.x.reshape(single.shape)
        weights = weights / np.maximum(weights.max(axis=1, keepdims=True), 1e-300)
        weights = np.where(weights < _LEAST, 0.0, np.round(weights, 3))
        if np.linalg.matrix_rank(weights) < len(single):
            continue  # an image twice
        if (found := score(mixed.gains(weights))) > value + 1e-9:
            best, value = weights, found
    if not quick:
        bound = min(bound, mixed.bound(mixed.exposed(best).sum(axis=0), len(single))[0])
    return Mixture(best, value, alone, max(value, bound))
