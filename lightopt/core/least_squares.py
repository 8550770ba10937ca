"""Robust damped least squares: the one solver of every registration.

Levenberg and Marquardt's method (Marquardt 1963, doi:10.1137/0111030) on a robust cost. Each accepted step lowers the
cost. Steps are bounded, and so is the distance from the nominal parameters. What the residuals do not determine stays
nominal.
"""

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.kernels import kernel

TUKEY = 4.685
HUBER = 1.345  # residuals in units of their spread from which a pixel counts less: 95 % efficiency for Gaussian noise

MOST_ITERATIONS = 40
MOST_ROUNDS = 6  # rounds with a spread of their own; each is of at most so many iterations as are left
SAME_SPREAD = 0.03  # a spread that changes by less than this share ends the rounds

# a solution has converged when the predicted decrease of the cost is less than this: 0.05 standard errors
DECREASE_TOLERANCE = 1e-3

# the same where no step lowers the cost, since slopes are differences: a step of 0.45 standard errors
STALLED_TOLERANCE = 0.1

LEAST_DAMPING, FIRST_DAMPING, MOST_DAMPING = 1e-9, 1e-4, 1e5
SHORTER_DAMPING = 0.1  # near the optimum less damping hardly shortens a step that was refused
# A direction that is held at nominal is released where its information is this many times what it must be. At the
# start, where the spread is still that of a misfit, the information is less than in the end.
RELEASE_FACTOR = 2.0

# a pixel that a trial step leaves without a prediction counts as a residual of this many spreads
MISSING_RESIDUAL = 10.0

_HUGE = 1e12
_TINY = 1e-12


class Problem(Protocol):
    """Residuals and their slopes; n rows, K parameters."""

    @property
    def weight(self) -> Float64:
        """How much each row counts, shape (n,)."""
        ...

    @property
    def correlated(self) -> Bool:
        """Rows with common errors, whose `weight` and not their scatter gives the information; shape (n,).

        Their residuals are in units of their own spread.
        """
        ...

    def residuals(self, x: Float64) -> Float64:
        """Measured minus predicted in standard deviations, shape (n,); not finite where nothing is predicted."""
        ...

    def slopes(self, x: Float64) -> Float64:
        """Derivatives of what is predicted by the parameters, in standard deviations, shape (n, K)."""
        ...


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Where parameters may go; arrays of shape (K,)."""

    nominal: Float64  # where a parameter stays that the residuals do not determine
    reach: Float64  # greatest distance from there
    step: Float64  # greatest change in one iteration
    prior: Float64  # standard deviation with which the nominal value is known beforehand; infinite where it is not
    # a direction is determined where its standard error is below one of these units; infinite for nuisance parameters
    resolution: Float64
    # directions not determined whatever the slopes are, rows in units of the parameters, shape (u, K)
    undetermined: Float64 = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Where the robust cost is least; everything is finite."""

    x: Float64  # parameters, shape (K,)
    covariance: Float64  # of an M-estimate, each row with the variance that it shows, shape (K, K)
    errors: Float64  # standard errors, at most the reach of a parameter, shape (K,)
    undetermined: Float64  # directions, in units of the limits' resolution, orthonormal rows, shape (u, K)
    at_limit: Bool  # parameters at their greatest distance from nominal, shape (K,)
    converged: bool
    iterations: int
    rows: int  # that had a prediction at the start
    spread: float  # robust standard deviation of the residuals at the end
    cost_before: float  # robust cost per row with that spread, at the start, undetermined directions at nominal
    cost_after: float  # the same at the end


@dataclass(frozen=True)
class _Loss:
    kind: Literal["tukey", "huber"]

    def cost(self, u: Float64) -> Float64:
        # of residuals in units of their spread
        if self.kind == "tukey":
            inner = np.clip(1.0 - np.square(u / TUKEY), 0.0, None)
            return TUKEY**2 / 6.0 * (1.0 - inner * inner * inner)
        size = np.abs(u)
        return np.where(size <= HUBER, 0.5 * u * u, HUBER * (size - 0.5 * HUBER))

    def weight(self, u: Float64) -> Float64:
        if self.kind == "tukey":
            return np.square(np.clip(1.0 - np.square(u / TUKEY), 0.0, None))
        return np.minimum(1.0, HUBER / np.maximum(np.abs(u), _TINY))

    def bend(self, u: Float64) -> Float64:
        # slope of weight(u)·u
        if self.kind == "tukey":
            off = np.square(u / TUKEY)
            return np.where(off < 1.0, (1.0 - off) * (1.0 - 5.0 * off), 0.0)
        return (np.abs(u) <= HUBER).astype(np.float64)


@dataclass(frozen=True)
class _Linear:
    slope: Float64
    measured: Float64
    weight: Float64
    correlated: Bool

    def residuals(self, x: Float64) -> Float64:
        return self.measured - np.einsum("ij,j->i", self.slope, x)

    def slopes(self, x: Float64) -> Float64:  # noqa: ARG002 - the same everywhere
        return self.slope


def linear_problem(slope: Float64, measured: Float64, weight: Float64 | None = None) -> Problem:
    """A problem whose prediction is linear in its parameters.

    slope: Derivatives in standard deviations, shape (n, K).
    measured: Values in standard deviations, shape (n,).
    weight: How much each row counts, shape (n,); all alike by default.
    """
    count = len(measured)
    return _Linear(slope, measured, np.ones(count) if weight is None else weight, np.zeros(count, np.bool_))


def solve(
    # rows without a finite residual at the start do not count; those without finite slopes have no effect
    problem: Problem,
    start: Float64,  # shape (K,)
    limits: Limits,
    *,
    # Tukey's (far residuals count alike) or Huber's (they pull alike; doi:10.1214/aoms/1177703732)
    loss: Literal["tukey", "huber"] = "tukey",
    least_spread: float = 0.3,  # lower bound of the residuals' spread [standard deviations]
    most_iterations: int = MOST_ITERATIONS,  # steps to try at most
) -> Solution:
    """Find the parameters with the least robust cost."""
    return _Solver(problem, limits, _Loss(loss), least_spread).run(np.asarray(start, np.float64), most_iterations)


@dataclass(eq=False)
class _Point:
    x: Float64
    residual: Float64
    cost: float
    normal: tuple[Float64, Float64] | None = None  # once it is needed, with the spread that the cost is of


class _Solver:
    def __init__(self, problem: Problem, limits: Limits, loss: _Loss, least_spread: float) -> None:
        self._problem, self._limits, self._loss, self._least_spread = problem, limits, loss, least_spread
        self._size = len(limits.nominal)
        self._of_interest = np.flatnonzero(np.isfinite(limits.resolution))
        # parameters of interest in units of their resolution; the others do not matter
        self._resolution = np.where(np.isfinite(limits.resolution), limits.resolution, 1.0)
        self._precision = np.diag(np.where(np.isfinite(limits.prior), 1.0 / np.square(limits.prior), 0.0))
        self._held = np.zeros((0, self._size))
        self._scatter = np.zeros(0)
        self._spread = least_spread
        self._rows = np.zeros(0, np.bool_)
        self._iterations = 0
        self._slopes_cache: tuple[Float64, Float64] | None = None
        self._raw_slopes: Float64 | None = None
        self._weight = np.zeros(0)

    def run(self, start: Float64, most_iterations: int) -> Solution:
        start = self._clipped(np.where(np.isfinite(start), start, self._limits.nominal))
        with np.errstate(over="ignore", invalid="ignore"):
            first = np.asarray(self._problem.residuals(start), np.float64)
        self._rows = np.isfinite(first) & np.isfinite(self._problem.weight) & (self._problem.weight > 0.0)
        self._weight = np.where(self._rows, self._problem.weight, 0.0)
        here = self._point(start)
        before = start
        converged = False
        for _ in range(MOST_ROUNDS):
            own = here.residual[self._rows & ~self._problem.correlated]
            spread = max(1.4826 * float(np.median(np.abs(own))), self._least_spread) if len(own) else self._spread
            done = converged and abs(spread - self._spread) <= SAME_SPREAD * self._spread
            if not done:
                self._spread = spread
                here = self._point(here.x)
            if self._fix_undetermined_directions(here):
                before = self._at_nominal(start)
                here = self._point(self._at_nominal(here.x))
                done = False
            if done:
                break
            here, converged = self._descend(here, most_iterations)
            if self._iterations >= most_iterations:
                break
        while True:
            first_point = self._point(before)
            if first_point.cost < here.cost:
                # a previous round's spread led elsewhere
                here, converged = self._descend(first_point, self._iterations + 5)
            if not self._fix_scattered_directions(here):
                return self._solution(first_point, here, converged)
            before = self._at_nominal(start)
            here, converged = self._descend(
                self._point(self._at_nominal(here.x)), max(most_iterations, self._iterations + 5)
            )

    def _descend(self, here: _Point, most_iterations: int) -> tuple[_Point, bool]:
        damping = FIRST_DAMPING
        while True:
            normal, pull = self._normal(here)
            basis = self._basis(here.x, pull)
            if basis.shape[1] == 0 or not self._rows.any():
                return here, bool(self._rows.any())
            scale, inner, outer = _scaled(basis.T @ normal @ basis, basis.T @ pull)
            predicted_decrease = 0.5 * float(outer @ _damped(inner, outer, LEAST_DAMPING))
            if predicted_decrease < DECREASE_TOLERANCE:
                return here, True
            before, shorter = here, predicted_decrease
            while here is before:
                if self._iterations >= most_iterations or damping > MOST_DAMPING or shorter < DECREASE_TOLERANCE:
                    return here, predicted_decrease < STALLED_TOLERANCE
                self._iterations += 1
                change = basis @ (_damped(inner, outer, damping) / scale)
                change = np.where(np.isfinite(change), change, 0.0)
                longest = float(np.max(np.abs(change) / self._limits.step))
                there = self._point(self._clipped(here.x + change / max(longest, 1.0)))
                if there.cost < here.cost:
                    here = there
                    damping = max(LEAST_DAMPING, 0.1 * damping)
                elif predicted_decrease < STALLED_TOLERANCE:
                    damping = max(SHORTER_DAMPING, 10.0 * damping)
                    shorter = predicted_decrease / (1.0 + damping)  # about the decrease by a step with this damping
                else:
                    damping *= 10.0

    def _point(self, x: Float64) -> _Point:
        with np.errstate(over="ignore", invalid="ignore"):
            residual = np.asarray(self._problem.residuals(x), np.float64)
        finite = np.isfinite(residual)
        if not finite.all():
            residual = np.where(self._rows, np.where(finite, residual, MISSING_RESIDUAL * self._units()), 0.0)
        residual = np.clip(residual, -_HUGE, _HUGE)
        cost = float(np.sum(self._loss.cost(residual / self._units()) * self._weight))
        known = (x - self._limits.nominal) @ self._precision @ (x - self._limits.nominal)
        return _Point(x, residual, cost + 0.5 * float(known))

    def _units(self) -> Float64:
        # spread of each row
        return np.where(self._problem.correlated, 1.0, self._spread)

    def _slopes(self, x: Float64) -> Float64:
        if self._slopes_cache is not None and np.array_equal(self._slopes_cache[0], x):
            return self._slopes_cache[1]
        with np.errstate(over="ignore", invalid="ignore"):
            slopes = np.asarray(self._problem.slopes(x), np.float64)
        if self._slopes_cache is not None and slopes is self._raw_slopes:
            return self._slopes_cache[1]  # a linear problem's
        self._raw_slopes = slopes
        known = self._rows & np.isfinite(slopes).all(axis=1)
        if not known.all():
            slopes = np.where(known[:, None], slopes, 0.0)
        slopes = np.clip(slopes, -_HUGE, _HUGE)
        self._slopes_cache = x, slopes
        return slopes

    def _normal(self, here: _Point) -> tuple[Float64, Float64]:
        if here.normal is None:
            slopes, unit = self._slopes(here.x), self._units()
            weight = self._weight * self._loss.weight(here.residual / unit) / np.square(unit)
            normal, pull = weighted_sums(slopes, weight, here.residual)
            pull -= self._precision @ (here.x - self._limits.nominal)
            here.normal = normal + self._precision, pull
        return here.normal

    def _fix_undetermined_directions(self, here: _Point) -> bool:
        # keep the directions at nominal that the residuals do not determine, release those that they do; whether their
        # number is another
        of = self._of_interest
        if not len(of):
            return False
        normal, _ = self._normal(here)
        values, vectors = np.linalg.eigh(self._information(normal))
        unknown, before = values < 1.0, len(self._held)
        if np.sum(unknown) < before:
            unknown = values < RELEASE_FACTOR
        if np.sum(unknown) == before:
            return False
        self._held = np.zeros((int(np.sum(unknown)), self._size))
        self._held[:, of] = vectors[:, unknown].T
        self._scatter = np.zeros(len(self._held))
        return True

    def _fix_scattered_directions(self, here: _Point) -> bool:
        # keep the directions at nominal, too, that the residuals leave open as they scatter in the end; whether any is
        of = self._of_interest
        if not len(of) or len(self._held) == len(of) or not self._rows.any():
            return False
        held, unit = self._held[:, of], self._limits.resolution[of]
        free = np.eye(len(of)) - held.T @ held
        values, vectors = np.linalg.eigh(free @ (self._covariance(here)[np.ix_(of, of)] / np.outer(unit, unit)) @ free)
        scattered = np.zeros((int(np.sum(values > 1.0)), self._size))
        scattered[:, of] = vectors[:, values > 1.0].T
        self._held = np.concatenate([self._held, scattered])
        self._scatter = np.concatenate([self._scatter, values[values > 1.0]])
        return len(scattered) > 0

    def _information(self, normal: Float64) -> Float64:
        # about the parameters of interest alone, in units of their resolution
        of = self._of_interest
        others = np.setdiff1d(np.arange(self._size), of)
        schur = normal[np.ix_(of, of)]
        if len(others):
            scale, inner, _ = _scaled(normal[np.ix_(others, others)], np.zeros(len(others)))
            cross = normal[np.ix_(of, others)] / scale
            schur = schur - cross @ np.linalg.solve(inner + LEAST_DAMPING * np.eye(len(others)), cross.T)
        unit = self._limits.resolution[of]
        found = schur * np.outer(unit, unit)
        if self._limits.undetermined.size:
            known, _ = np.linalg.qr((self._limits.undetermined[:, of] / unit).T)
            rest = np.eye(len(of)) - known @ known.T
            found = rest @ found @ rest
        return 0.5 * (found + found.T)

    def _at_nominal(self, x: Float64) -> Float64:
        unit = self._resolution
        off = (x - self._limits.nominal) / unit
        return self._clipped(self._limits.nominal + unit * (off - self._held.T @ (self._held @ off)))

    def _basis(self, x: Float64, pull: Float64) -> Float64:
        # of the directions to move in, shape (K, f): not those held, nor a parameter at its limit that is pulled beyond
        low, high = self._limits.nominal - self._limits.reach, self._limits.nominal + self._limits.reach
        stuck = ((x <= low) & (pull < 0.0)) | ((x >= high) & (pull > 0.0))
        held = np.concatenate([self._held / self._resolution, np.eye(self._size)[stuck]])
        if not len(held):
            return np.eye(self._size)
        held = held / np.maximum(np.linalg.norm(held, axis=1, keepdims=True), _TINY)
        _, values, rows = np.linalg.svd(held)
        return rows[int(np.sum(values > 1e-9)) :].T

    def _clipped(self, x: Float64) -> Float64:
        return np.clip(x, self._limits.nominal - self._limits.reach, self._limits.nominal + self._limits.reach)

    def _solution(self, before: _Point, here: _Point, converged: bool) -> Solution:
        reach = self._limits.reach
        rows = int(self._rows.sum())
        covariance = np.diag(np.square(reach))
        if rows:
            covariance = self._covariance(here)
            scale = np.minimum(1.0, reach / np.sqrt(np.maximum(np.diag(covariance), _TINY)))
            covariance = covariance * np.outer(scale, scale)
        held = self._held if rows else np.eye(self._size)[self._of_interest]
        return Solution(
            x=here.x,
            covariance=covariance,
            errors=np.sqrt(np.diag(covariance)),
            undetermined=held,
            at_limit=np.abs(here.x - self._limits.nominal) >= reach * (1.0 - 1e-9),
            converged=converged and rows > 0,
            iterations=self._iterations,
            rows=rows,
            spread=self._spread,
            cost_before=before.cost / max(rows, 1),
            cost_after=here.cost / max(rows, 1),
        )

    def _covariance(self, here: _Point) -> Float64:
        # of an M-estimate: Huber 1973, doi:10.1214/aos/1176342503; directions held have that of the information
        slopes = self._slopes(here.x)
        unit, weight = self._units(), self._weight
        u = here.residual / unit
        normal, pull = self._normal(here)
        # rows that are off together are not bent one by one
        correlated = self._problem.correlated
        bend = weight * np.where(correlated, self._loss.weight(u), self._loss.bend(u)) / np.square(unit)
        inner = weighted_sums(slopes, bend, here.residual)[0] + self._precision
        observed = np.square(weight * self._loss.weight(u) * u / unit)
        expected = weight * self._loss.weight(u) / np.square(unit)
        scatter = np.where(correlated, expected, observed)
        middle = weighted_sums(slopes, scatter, here.residual)[0] + self._precision
        basis = self._basis(here.x, np.zeros_like(pull))
        covariance = np.zeros((self._size, self._size))
        if basis.shape[1]:
            scale, a, _ = _scaled(basis.T @ normal @ basis, basis.T @ pull)
            bent = (basis.T @ inner @ basis) / np.outer(scale, scale)
            # far from the optimum the bend is not definite: there its weights show how sharp it is
            sharp = bent if np.linalg.eigvalsh(bent)[0] > 0.1 * np.linalg.eigvalsh(a)[0] else a
            back = np.linalg.inv(sharp + LEAST_DAMPING * np.eye(len(sharp)))
            values, vectors = np.linalg.eigh((basis.T @ middle @ basis) / np.outer(scale, scale))
            # a square, so that no variance is below 0 for rounding
            root = (basis / scale) @ back @ (vectors * np.sqrt(np.maximum(values, 0.0)))
            covariance = root @ root.T
        if len(self._held):
            of, res = self._of_interest, self._resolution
            held = self._held[:, of]
            information = held @ self._information(normal) @ held.T
            less = np.maximum(self._scatter * np.diag(information), 1.0)
            modes = np.linalg.eigh(information / np.sqrt(np.outer(less, less)))
            rows = modes.eigenvectors.T @ held
            # no direction is more uncertain than the reach allows
            least = np.max(np.square(rows * res[of] / self._limits.reach[of]), axis=1)
            spread = rows.T / np.maximum(modes.eigenvalues, least) @ rows
            covariance[np.ix_(of, of)] += spread * np.outer(res[of], res[of])
        return 0.5 * (covariance + covariance.T)


@kernel
def weighted_sums(slopes: Float64, weight: Float64, residual: Float64) -> tuple[Float64, Float64]:
    """Sᵀ·W·S, shape (K, K), and Sᵀ·W·r, shape (K,), of slopes (n, K), weights (n,) and residuals (n,).

    Not by BLAS, whose threads take longer to meet than such slim matrices take, and whose sums depend on how many there
    are.
    """
    rows, size = slopes.shape
    normal, pull = np.zeros((size, size)), np.zeros(size)
    for i in range(rows):
        if weight[i] == 0.0:
            continue
        for a in range(size):
            weighted = weight[i] * slopes[i, a]
            pull[a] += weighted * residual[i]
            for b in range(a + 1):
                normal[a, b] += weighted * slopes[i, b]
    for a in range(size):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return normal, pull


def _scaled(normal: Float64, pull: Float64) -> tuple[Float64, Float64, Float64]:
    # a matrix with a diagonal of ones, but for parameters that nothing depends on
    size = np.sqrt(np.maximum(np.diag(normal), 0.0))
    scale = np.where(size > _TINY, size, 1.0)
    return scale, normal / np.outer(scale, scale), pull / scale


def _damped(normal: Float64, pull: Float64, damping: float) -> Float64:
    found = np.linalg.solve(normal + damping * np.eye(len(pull)), pull)
    return np.asarray(found, np.float64)
