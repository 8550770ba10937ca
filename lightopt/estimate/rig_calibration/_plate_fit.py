"""How the panels shine and the lens dims: fit to a matt white plate in several postures of the stage.

A panel lights a point of a Lambertian plate by the mean over the panel of ``(reference distance / r)²`` (or 1) times
``cosⁿ`` of the angle to the panel's axis times the cosine of incidence (docs/reference/reflection-model.md, Panel).
Only the product of gain and the plate's brightness shows, so the mean gain is 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.optimize import least_squares

from lightopt.core.arrays import Bool, Float64, Index
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._ball_fit import PANEL_PARAMETERS, _unmoved, posed_panel
from lightopt.estimate.rig_calibration._measured import Measured, measured
from lightopt.lights import PanelLight
from lightopt.scene import PinholeCamera, Stage, pixel_directions

NODES = 3  # of Gauss and Legendre along each side of a panel

# standard deviations before the fit
EXPONENT_PRIOR, VIGNETTING_PRIOR = 1.0, 0.5
LAMBERT_PRIOR = 0.03  # of κ, for a plate that reflects as cosθ to the power 1 + κ; real ones are several % off Lambert
EXPONENT_DECIDED = 0.33  # standard error of n from which the rig file's is kept: it does not tell 0 from 1
HELD = 1e-6  # standard error of an n that is not fitted
FALL_OFF_DECIDED = 9.0  # difference of χ² that decides between fall-off and none: three standard deviations

_EACH = len(PANEL_PARAMETERS)
_COMMON = 4  # n, κ and two coefficients of vignetting
_STEP = np.array([1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4, 1e-2, 1e-2])


@dataclass(frozen=True, kw_only=True, eq=False)
class Plate:
    """A flat plate on the stage, stage frame: a corner and its two sides from there [mm], shapes (3,)."""

    corner: Float64
    side_x: Float64
    side_y: Float64

    @property
    def normal(self) -> Float64:
        """Unit normal of the lit side, x × y."""
        normal = np.cross(self.side_x, self.side_y)
        return normal / np.linalg.norm(normal)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateView:
    """Mean levels of cells of the plate's image in one posture under one light.

    points: Where the cells are, world frame [mm], shape (k, 3)
    normal: Of the plate, world frame, shape (3,)
    radius: Distance of the cells from the principal point, in halves of the image's diagonal, shape (k,)
    levels: Linear, black removed [grey level at exposure 1], shape (k,)
    """

    posture: Posture
    light: str
    points: Float64
    normal: Float64
    radius: Float64
    levels: Float64


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateFit:
    """The panels' light and the lens's dimming.

    lights: As they were given, with gain, fall-off, emission exponent, and pose and size as both ball and plate show
    gains: By light, their mean 1
    brightness: Diffuse coefficient R_d of the plate, for the mean gain [grey level]
    emission_exponent: n, common to all panels; not fitted where the views do not decide it
    fall_off_decided: Whether the plate shows if there is an inverse-square fall-off; else it is as the rig file has it
    vignetting: v₁ and v₂ of the factor ``1 + v₁ρ² + v₂ρ⁴``, ρ from the principal point in halves of the diagonal
    covariance: Of n, κ of the plate, v₁, v₂, then ``gain·brightness`` of each light, then the panel parameters of each
        light, shape (4 + 9·L, 4 + 9·L)
    rms: Of the residuals, in the errors claimed
    """

    lights: tuple[PanelLight, ...]
    gains: tuple[Measured, ...]
    brightness: Measured
    emission_exponent: Measured
    emission_fitted: bool
    fall_off: Literal["inverse_square", "none"]
    fall_off_decided: bool
    vignetting: tuple[Measured, Measured]
    covariance: Float64
    rms: float


def plate_cells(
    levels: Float64,
    usable: Bool,
    *,
    light: str,
    posture: Posture,
    plate: Plate,
    camera: PinholeCamera,
    stage: Stage,
    cell: int = 40,
    margin: float = 2.0,
) -> PlateView:
    """Mean levels of the square cells of an image that show only the plate.

    levels: Linear, black removed [grey level at exposure 1], shape (H, W)
    usable: Where levels are not saturated, shape (H, W); a cell with any other pixel is left out
    cell: Side of a cell [px]
    margin: From the plate's edge [mm]
    Raises InputError: Where fewer than four cells show the plate
    """
    rotation, translation = stage.transform(posture)
    corner, side_x, side_y = rotation @ plate.corner + translation, rotation @ plate.side_x, rotation @ plate.side_y
    normal = rotation @ plate.normal
    rows, columns = (np.arange(side // cell + 1, dtype=np.float64) * cell for side in levels.shape)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1)
    middle = grid[:-1, :-1] + 0.5 * cell
    places = np.concatenate([grid.reshape(-1, 2), middle.reshape(-1, 2)])
    rays = pixel_directions(camera, *np.ascontiguousarray(places.T))
    points = camera.position + rays * ((corner - camera.position) @ normal / (rays @ normal))[:, None]
    on_plate = np.ones(len(points), np.bool_)
    for side in (side_x, side_y):
        length = float(np.linalg.norm(side))
        along = (points - corner) @ side / length
        on_plate &= (along > margin) & (along < length - margin)
    of_grid = on_plate[: grid.shape[0] * grid.shape[1]].reshape(grid.shape[:2])
    whole = of_grid[:-1, :-1] & of_grid[1:, :-1] & of_grid[:-1, 1:] & of_grid[1:, 1:]
    blocks = (whole.shape[0], cell, whole.shape[1], cell)
    cut = (slice(0, blocks[0] * cell), slice(0, blocks[2] * cell))
    whole &= usable[cut].reshape(blocks).all(axis=(1, 3))
    if np.sum(whole) < 4:
        raise InputError(
            f"plate at {posture} under {light}: {int(np.sum(whole))} cells of {cell} pixels show it unsaturated: "
            "expose it shorter, and check its corners"
        )
    column, row = camera.axis_px
    return PlateView(
        posture=posture,
        light=light,
        points=points[grid.shape[0] * grid.shape[1] :].reshape(*whole.shape, 3)[whole],
        normal=normal,
        radius=np.hypot(*(middle[whole] - [column, row]).T) / (0.5 * np.hypot(camera.width, camera.height)),
        levels=levels[cut].reshape(blocks).mean(axis=(1, 3), dtype=np.float64)[whole],
    )


def fit_plate(
    views: Sequence[PlateView],
    *,
    lights: Sequence[PanelLight],
    panels_covariance: Float64,
    relative_error: float = 0.005,
    level_error: float = 0.1,
    lambert_error: float = LAMBERT_PRIOR,
) -> PlateFit:
    """Fit gains, fall-off, emission exponent and vignetting, with the panels' geometry known from the ball.

    lights, panels_covariance: World frame, and the covariance of their :data:`PANEL_PARAMETERS`, shape (8·L, 8·L): of
        :class:`BallFit`
    relative_error, level_error: Standard deviation of a cell's level: a share of it, and [grey level]
    lambert_error: Standard deviation of κ, by how much the plate is expected not to be Lambertian
    Raises InputError: Where a light has no view
    """
    seen = {view.light for view in views}
    if problems := [f"plate: {light.name} has no view of the plate" for light in lights if light.name not in seen]:
        raise InputError(*problems)
    given = all(light.inverse_square for light in lights)
    errors = (relative_error, level_error, lambert_error)
    kept, other = (_Problem(views, lights, panels_covariance, errors, falls) for falls in (given, not given))
    fit, alternative = kept.solve(EXPONENT_PRIOR), other.solve(EXPONENT_PRIOR)
    difference = (fit.chi_squared - alternative.chi_squared) / max(1.0, min(fit.mean_square, alternative.mean_square))
    if difference > FALL_OFF_DECIDED:
        kept, fit = other, alternative
    fitted = bool(np.sqrt(fit.covariance[0, 0]) <= EXPONENT_DECIDED)
    fit = kept.solve(EXPONENT_PRIOR if fitted else HELD, again=True)

    levels = slice(_COMMON, _COMMON + len(lights))
    level, of_levels = fit.x[levels], fit.covariance[levels, levels]
    gains = level / level.mean()
    slope = (np.eye(len(lights)) - gains[:, None] / len(lights)) / level.mean()  # of level / mean, by the levels
    gain_errors = np.sqrt(np.diag(slope @ of_levels @ slope.T))
    common = [
        measured(float(v), float(e)) for v, e in zip(fit.x[:_COMMON], np.sqrt(np.diag(fit.covariance)), strict=False)
    ]
    moves = fit.x[levels.stop :].reshape(-1, _EACH) + _unmoved(lights)
    return PlateFit(
        lights=tuple(
            replace(posed_panel(light, move), gain=float(gain), emission_exponent=max(0.0, common[0].value))
            for light, move, gain in zip(kept.lights, moves, gains, strict=True)
        ),
        gains=tuple(measured(float(g), float(e)) for g, e in zip(gains, gain_errors, strict=True)),
        brightness=measured(float(level.mean()), float(np.sqrt(of_levels.mean()))),
        emission_exponent=common[0],
        emission_fitted=fitted,
        fall_off="inverse_square" if kept.lights[0].inverse_square else "none",
        fall_off_decided=abs(difference) > FALL_OFF_DECIDED,
        vignetting=(common[2], common[3]),
        covariance=fit.covariance,
        rms=float(np.sqrt(fit.mean_square)),
    )


@dataclass(frozen=True)
class _Fit:
    x: Float64
    covariance: Float64
    chi_squared: float
    mean_square: float


class _Problem:
    """Levels of all cells by n, κ, v₁, v₂, the lights' levels and moves of the panels, which are small: linear."""

    def __init__(
        self,
        views: Sequence[PlateView],
        lights: Sequence[PanelLight],
        panels_covariance: Float64,
        errors: tuple[float, float, float],
        inverse_square: bool,
    ) -> None:
        self.lights = tuple(replace(light, inverse_square=inverse_square) for light in lights)
        names = [light.name for light in lights]
        self._owner = np.concatenate([np.full(len(view.levels), names.index(view.light)) for view in views])
        self._points = np.concatenate([view.points for view in views])
        self._normals = np.concatenate([np.tile(view.normal, (len(view.levels), 1)) for view in views])
        self._square = np.square(np.concatenate([view.radius for view in views]))
        self._levels = np.concatenate([view.levels for view in views])
        self._error = np.hypot(errors[1], errors[0] * self._levels)
        self._lambert_error = errors[2]
        self._known = np.linalg.inv(np.linalg.cholesky(panels_covariance))
        self._exponent = float(np.mean([light.emission_exponent for light in lights]))
        # moves of the panels that levels are linear about, and what they are linear in
        self._moves, self._slopes = np.zeros((len(lights), _EACH)), np.zeros((len(self._levels), _EACH))
        self._cosines = self._of_panels(np.zeros(_EACH))

    def solve(self, exponent_error: float, *, again: bool = False) -> _Fit:
        count = len(self.lights)
        self._moves = np.zeros((count, _EACH))
        self._cosines = self._of_panels(np.zeros(_EACH))
        flat = _irradiance(*self._cosines, exponent=self._exponent, kappa=0.0)
        totals = (np.bincount(self._owner, values, count) for values in (self._levels, flat))
        level = np.divide(*totals)
        start = np.concatenate([[self._exponent, 0.0, 0.0, 0.0], level, np.zeros(_EACH * count)])
        prior = np.array([exponent_error, self._lambert_error, VIGNETTING_PRIOR, VIGNETTING_PRIOR])

        def residuals(x: Float64) -> Float64:
            known = (x - start)[:_COMMON] / prior
            return np.concatenate(
                [(self._predicted(x) - self._levels) / self._error, known, self._known @ x[-_EACH * count :]]
            )

        found = self._fit(residuals, start)
        if again:  # what a move does depends on n and on the panels' geometry
            found = self._fit(residuals, found.x)
        freedom = len(found.fun) - len(start)
        mean_square = 2.0 * float(found.cost) / freedom
        covariance = np.linalg.inv(found.jac.T @ found.jac) * max(1.0, mean_square)
        return _Fit(found.x, covariance, 2.0 * float(found.cost), mean_square)

    def _predicted(self, x: Float64) -> Float64:
        n, kappa, v1, v2 = x[:_COMMON]
        count = len(self.lights)
        dimming = 1.0 + self._square * (v1 + v2 * self._square)
        moved = 1.0 + np.sum(
            self._slopes * (x[-_EACH * count :].reshape(count, _EACH) - self._moves)[self._owner], axis=1
        )
        level = x[_COMMON : _COMMON + count][self._owner]
        return level * dimming * moved * _irradiance(*self._cosines, exponent=n, kappa=kappa)

    def _of_panels(self, move: Float64) -> tuple[Float64, Float64, Float64]:
        panels = [
            posed_panel(light, move + own)
            for light, own in zip(self.lights, _unmoved(self.lights) + self._moves, strict=True)
        ]
        return _cosines(panels, self._owner, self._points, self._normals)

    def _fit(self, residuals: Callable[[Float64], Float64], x: Float64) -> Any:
        self._moves = x[_COMMON + len(self.lights) :].reshape(-1, _EACH)
        self._cosines = self._of_panels(np.zeros(_EACH))
        moved = [self._of_panels(step) for step in (*np.diag(_STEP), *np.diag(-_STEP))]
        up, down = np.split(np.array([_irradiance(*cosines, exponent=x[0], kappa=0.0) for cosines in moved]), 2)
        self._slopes = ((up - down) / (up + down)).T / _STEP
        return least_squares(residuals, x, method="lm", x_scale="jac")


def irradiance(light: PanelLight, points: Float64, normal: Float64, *, exponent: float, kappa: float = 0.0) -> Float64:
    """Level of a Lambertian surface with R_d = 1 under a panel with gain 1, shape (k,).

    points: World frame [mm], shape (k, 3)
    normal: Of the surface, world frame, shape (3,)
    exponent: n of the emission
    kappa: κ of a surface that reflects as cosθ to the power 1 + κ of the angle of incidence
    """
    cosines = _cosines([light], np.zeros(len(points), np.intp), points, np.broadcast_to(normal, points.shape))
    return _irradiance(*cosines, exponent=exponent, kappa=kappa)


def _cosines(
    panels: Sequence[PanelLight], owner: Index, points: Float64, normals: Float64
) -> tuple[Float64, Float64, Float64]:
    # weight with the fall-off, and logarithms of the cosines of emission and incidence, at nodes on each point's panel,
    # each of shape (k, nodes)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    s, t = (grid.ravel()[:, None] for grid in np.meshgrid(0.5 * nodes, 0.5 * nodes))
    emitters = np.array([p.centre + s * p.size[0] * p.across + t * p.size[1] * p.along for p in panels])
    to_light = emitters[owner] - points[:, None, :]
    square = np.sum(np.square(to_light), axis=2)
    incidence = np.einsum("knx,kx->kn", to_light, normals)
    emission = np.einsum("knx,kx->kn", to_light, np.array([p.outward for p in panels])[owner])
    weight = np.broadcast_to(0.25 * np.outer(weights, weights).ravel(), square.shape)
    if panels[0].inverse_square:
        reference = np.array([p.reference_distance or p.distance for p in panels])
        weight = weight * np.square(reference)[owner, None] / square
    lit = np.where((incidence > 0.0) & (emission > 0.0), weight, 0.0)
    emission, incidence = (np.log(np.maximum(c, 1e-9) / np.sqrt(square)) for c in (emission, incidence))
    return lit, emission, incidence


def _irradiance(weight: Float64, emission: Float64, incidence: Float64, *, exponent: float, kappa: float) -> Float64:
    return np.sum(weight * np.exp(exponent * emission + (1.0 + kappa) * incidence), axis=1)
