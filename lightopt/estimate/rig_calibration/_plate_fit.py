"""How the panels shine and the lens dims: fit to a matt white plate in several postures of the stage.

A panel lights a point of a Lambertian plate by the mean over the panel of ``(reference distance / r)²`` (or 1) times
``cosⁿ`` of the angle to the panel's axis times the cosine of incidence (docs/reference/reflection-model.md, Panel).
Only the product of gain and the plate's brightness shows, so the mean gain is 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.optimize import least_squares

from lightopt.config import READING_ERROR_DEG, PlateTargetConfig
from lightopt.core.arrays import Bool, Float64, Index
from lightopt.core.errors import InputError, refuse
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._ball_fit import PANEL_PARAMETERS, panel_names, posed_panel, unmoved
from lightopt.estimate.rig_calibration._deviations import Measured, measured
from lightopt.lights import PanelLight
from lightopt.scene import PinholeCamera, Stage, pixel_directions

NODES = 3  # of Gauss and Legendre along each side of a panel
MARGIN_MM = 2.0  # from the plate's edge
# standard deviations before the fit
EXPONENT_PRIOR, VIGNETTING_PRIOR = 1.0, 0.5
CENTRE_PRIOR = 0.02  # of the vignetting, which is near the principal point [half of the image's diagonal]
GRADIENT_PRIOR = 0.2  # rotation of a panel whose gradient it is, for n = 1 [rad]
SLOPE_PRIOR = np.radians(0.1)  # of the plate on the table
LAMBERT_PRIOR = 0.03  # of κ, for a plate that reflects as cosθ to the power 1 + κ; real ones are several % off Lambert
EXPONENT_DECIDED = 0.5  # standard error of n from which the rig file's is kept
HELD = 1e-6  # standard error of an n that is not fitted
FALL_OFF_DECIDED = 9.0  # difference of χ² that decides between fall-off and none: three standard deviations
MOST_EVALUATIONS = 30  # of a fit: ten are enough where levels and rig agree
_EACH = len(PANEL_PARAMETERS)
_COMMON = 4  # n, κ and two coefficients of vignetting
_ROTATIONS = slice(3, 5)  # of a panel's moves, about its sides
_TILTS = _COMMON + 4  # and the centre of the vignetting, and the slope of the plate
_STEP = np.array([0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-3, 0.1, 0.1])
NORMAL_STEP = 1e-4  # [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateView:
    """Mean levels of cells of the plate's image in one posture under one light."""

    posture: Posture
    light: str
    points: Float64  # where the cells are, world frame [mm], shape (k, 3)
    normal: Float64  # of the plate, world frame, shape (3,)
    # of the normal, per radian of a slope about each side and of the tilt reading, world frame, shape (3, 3)
    normal_changes: Float64
    place: Float64  # of the cells, from the principal point, in halves of the image's diagonal, shape (k, 2)
    levels: Float64  # linear, black removed [grey level at exposure 1], shape (k,)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateFit:
    """The panels' light and the lens's dimming.

    lights: As they were given, with gain, fall-off, emission exponent, and place and size as both ball and plate show;
        rotated as the ball shows
    emission_exponent: n, common to all panels; not fitted where the views do not decide it, and 0 where it would be
        less, with a warning
    fall_off_decided: Whether the plate shows if there is an inverse-square fall-off; else it is as the rig file has it
    vignetting: v₁ and v₂ of the factor ``1 + v₁ρ² + v₂ρ⁴``, ρ from the principal point in halves of the diagonal
    names, covariance: Of n, κ of the plate, v₁, v₂, then the gain of each light, then the panel parameters of each
        light, shape (4 + 9·L, 4 + 9·L)
    """

    lights: tuple[PanelLight, ...]
    gains: tuple[Measured, ...]  # by light, their mean 1
    brightness: Measured  # diffuse coefficient R_d of the plate, for the mean gain [grey level]
    emission_exponent: Measured
    emission_fitted: bool
    fall_off: Literal["inverse_square", "none"]
    fall_off_decided: bool
    vignetting: tuple[Measured, Measured]
    names: tuple[str, ...]
    covariance: Float64
    rms: float  # of the residuals, in the errors claimed
    warnings: tuple[str, ...]  # what is not as a rig file can hold it


def plate_cells(
    levels: Float64,
    usable: Bool,
    *,
    light: str,
    posture: Posture,
    plate: PlateTargetConfig,
    camera: PinholeCamera,
    stage: Stage,
    cell: int,
) -> PlateView:
    """Mean levels of the square cells of an image that show only the plate.

    levels: Linear, black removed [grey level at exposure 1], shape (H, W)
    usable: Where levels are not saturated, shape (H, W); a cell with any other pixel is left out
    cell: Side of a cell [px]
    Raises InputError: Where fewer than four cells show the plate
    """
    rotation, translation = stage.transform(posture)
    x, y = plate.size_mm
    corner = rotation @ np.array([-0.5 * x, -0.5 * y, plate.height_mm]) + translation
    side_x, side_y, normal = (rotation @ direction for direction in np.diag([x, y, 1.0]))
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
        on_plate &= (along > MARGIN_MM) & (along < length - MARGIN_MM)
    of_grid = on_plate[: grid.shape[0] * grid.shape[1]].reshape(grid.shape[:2])
    whole = of_grid[:-1, :-1] & of_grid[1:, :-1] & of_grid[:-1, 1:] & of_grid[1:, 1:]
    blocks = (whole.shape[0], cell, whole.shape[1], cell)
    cut = (slice(0, blocks[0] * cell), slice(0, blocks[2] * cell))
    whole &= usable[cut].reshape(blocks).all(axis=(1, 3))
    if (count := int(np.sum(whole))) < 4:
        raise InputError(f"plate at {posture} under {light}: {count} cells show it unsaturated: expose shorter")
    column, row = camera.axis_px
    return PlateView(
        posture=posture,
        light=light,
        points=points[grid.shape[0] * grid.shape[1] :].reshape(*whole.shape, 3)[whole],
        normal=normal,
        normal_changes=np.cross([rotation[:, 0], rotation[:, 1], stage.tilt_axis[1]], normal),
        place=(middle[whole] - [column, row]) / (0.5 * np.hypot(camera.width, camera.height)),
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
    reading_error_deg: float = READING_ERROR_DEG,
) -> PlateFit:
    """Fit gains, fall-off, emission exponent and vignetting, with the panels' geometry known from the ball.

    lights, panels_covariance: World frame, and the covariance of their :data:`PANEL_PARAMETERS`, shape (8·L, 8·L): of
        :class:`BallFit`
    relative_error, level_error: Standard deviation of a cell's level: a share of it, and [grey level]
    lambert_error: Standard deviation of κ, by how much the plate is expected not to be Lambertian
    reading_error_deg: Standard deviation of the stage's tilt readings [deg]
    Cells that a light does not shine on with all of its panel are left out.
    Raises InputError: Where a light has no view
    """
    of_name = {light.name: light for light in lights}
    views = [_lit(view, of_name[view.light]) for view in views]
    seen = {view.light for view in views if len(view.levels)}
    refuse([f"plate: {light.name} has no view of the plate" for light in lights if light.name not in seen])
    given = all(light.inverse_square for light in lights)
    errors = (relative_error, level_error, lambert_error, reading_error_deg)
    kept, other = (_Problem(views, lights, panels_covariance, errors, falls) for falls in (given, not given))
    filed = float(np.mean([light.emission_exponent for light in lights]))
    fit, alternative = (one.solve(filed, EXPONENT_PRIOR) for one in (kept, other))
    difference = (fit.chi_squared - alternative.chi_squared) / max(1.0, min(fit.mean_square, alternative.mean_square))
    if difference > FALL_OFF_DECIDED:
        kept, fit = other, alternative
    n, error = float(fit.x[0]), float(np.sqrt(fit.covariance[0, 0]))
    fitted = error <= EXPONENT_DECIDED
    if not fitted:
        # the rig file's may be off by what the views show, too
        fit = kept.held(filed, float(np.hypot(error, n - filed)))
    exponent = measured(float(fit.x[0]), float(np.sqrt(fit.covariance[0, 0])))
    warnings: tuple[str, ...] = ()
    if exponent.value < 0.0:
        low, high = exponent.interval_95
        text = f"plate: emission exponent {exponent.value:.2f}, 95 % interval {low:.2f} to {high:.2f}; 0 is taken, the "
        text += "least there is"
        if high < 0.0:
            text += ". The panels are brighter from the side than from ahead, or the plate is not matt"
        warnings = (text,)
        # gains and panels are those of an exponent of 0; their errors are not less for that
        fit = replace(kept.solve(0.0, HELD), covariance=fit.covariance)
        exponent = Measured(value=0.0, error=exponent.error, interval_95=(0.0, max(0.0, high)))

    # of n, κ, v₁, v₂, then levels and moves: the rest is not of the rig
    own = np.r_[0:_COMMON, kept.levels.start : len(fit.x)]
    x, covariance = fit.x[own], fit.covariance[np.ix_(own, own)]
    levels = slice(_COMMON, _COMMON + len(lights))
    level, of_level = x[levels], covariance[levels, levels]
    gains = level / level.mean()
    to_gains = np.eye(len(x))
    to_gains[levels, levels] = (np.eye(len(lights)) - gains[:, None] / len(lights)) / level.mean()
    covariance = to_gains @ covariance @ to_gains.T
    values = np.concatenate([x[:_COMMON], gains])
    errors_of = np.sqrt(np.diag(covariance)[: levels.stop])
    _, _, v1, v2, *of_gains = (measured(float(v), float(e)) for v, e in zip(values, errors_of, strict=True))
    moves = x[levels.stop :].reshape(-1, _EACH) + unmoved(lights)
    return PlateFit(
        lights=tuple(
            replace(posed_panel(light, move), gain=float(gain), emission_exponent=exponent.value)
            for light, move, gain in zip(kept.lights, moves, gains, strict=True)
        ),
        gains=tuple(of_gains),
        brightness=measured(float(level.mean()), float(np.sqrt(of_level.mean()))),
        emission_exponent=exponent,
        emission_fitted=fitted,
        fall_off="inverse_square" if kept.lights[0].inverse_square else "none",
        fall_off_decided=abs(difference) > FALL_OFF_DECIDED,
        vignetting=(v1, v2),
        names=(
            *("emission_exponent", "plate.kappa", "camera.vignetting.v2", "camera.vignetting.v4"),
            *(f"{light.name} gain" for light in lights),
            *panel_names(lights),
        ),
        covariance=covariance,
        rms=float(np.sqrt(fit.mean_square)),
        warnings=warnings,
    )


def _lit(view: PlateView, light: PanelLight) -> PlateView:
    normals = np.broadcast_to(view.normal, view.points.shape)
    weight, _, _ = _cosines([light], np.zeros(len(view.points), np.intp), view.points, normals)
    lit = np.all(weight > 0.0, axis=1)
    return replace(view, points=view.points[lit], place=view.place[lit], levels=view.levels[lit])


@dataclass(frozen=True)
class _Fit:
    x: Float64
    covariance: Float64
    chi_squared: float
    mean_square: float


class _Problem:
    """Levels of all cells by n and what else is open.

    Parameters: n, κ, v₁, v₂, the centre of the vignetting (2), the plate's slope (2), the error of each posture's tilt
    reading, two gradients and the level of each light, and the panels' moves.

    A panel that is rotated by δ makes a gradient n·δ. This tells neither n nor δ: the ball shows δ with an error as
    large as most rotations. An n from gradients would be too small for panels that do not face the plate, and anything
    for panels that do. So gradients, as a rotation makes them for n = 1, are free, and rotations stay as the ball shows
    them. Of gradients and moves squares count: a rotation dims a panel by n·δ²/2, as much as its gain is uncertain
    where there is no fall-off.
    """

    def __init__(
        self,
        views: Sequence[PlateView],
        lights: Sequence[PanelLight],
        panels_covariance: Float64,
        errors: tuple[float, float, float, float],
        inverse_square: bool,
    ) -> None:
        self.lights = tuple(replace(light, inverse_square=inverse_square) for light in lights)
        names = [light.name for light in lights]
        postures = list(dict.fromkeys(view.posture for view in views))
        sizes = [len(view.levels) for view in views]
        self._owner = np.repeat([names.index(view.light) for view in views], sizes)
        self._posture = np.repeat([postures.index(view.posture) for view in views], sizes)
        self._points = np.concatenate([view.points for view in views])
        self._normals = np.repeat([view.normal for view in views], sizes, axis=0)
        self._place = np.concatenate([view.place for view in views])
        self._levels = np.concatenate([view.levels for view in views])
        relative, level, lambert, reading = errors
        self._error = np.hypot(level, relative * self._levels)
        self._tilts = slice(_TILTS, _TILTS + len(postures))
        self._gradients = slice(self._tilts.stop, self._tilts.stop + 2 * len(lights))
        self.levels = slice(self._gradients.stop, self._gradients.stop + len(lights))
        self._prior = np.full(self.levels.stop, np.inf)
        self._prior[1:_TILTS] = [lambert, *[VIGNETTING_PRIOR] * 2, *[CENTRE_PRIOR] * 2, *[SLOPE_PRIOR] * 2]
        self._prior[self._tilts], self._prior[self._gradients] = max(np.radians(reading), HELD), GRADIENT_PRIOR
        self._whitening = np.linalg.inv(np.linalg.cholesky(panels_covariance))
        self._cosines = self._of_panels(np.zeros(_EACH))
        # relative changes of the light, for n = 1 and panels where the ball shows them
        flat = _irradiance(*self._cosines, exponent=1.0)[0]
        steps = (*np.diag(_STEP), *np.diag(-_STEP))
        moved = np.array([_irradiance(*self._of_panels(step), exponent=1.0)[0] for step in steps])
        up, down = np.split(moved / flat, 2)
        self._slopes, self._bends = (up - down).T / (2.0 * _STEP), (up + down - 2.0).T / np.square(_STEP)
        changes = np.moveaxis(np.repeat([view.normal_changes for view in views], sizes, axis=0), 1, 0)
        turned = [self._of_panels(np.zeros(_EACH), NORMAL_STEP * change) for change in changes]
        self._by_normal = np.stack([_irradiance(*t, exponent=1.0)[0] / flat - 1.0 for t in turned], 1) / NORMAL_STEP

    def held(self, exponent: float, error: float) -> _Fit:
        """All else for an exponent, whose error widens theirs."""
        fit, other = (self.solve(n, HELD) for n in (exponent, exponent + error))
        by_n = other.x - fit.x
        return replace(fit, covariance=fit.covariance + np.outer(by_n, by_n))

    def solve(self, exponent: float, exponent_error: float) -> _Fit:
        # n is `exponent` beforehand, with this standard deviation
        count = len(self.lights)
        flat = _irradiance(*self._cosines, exponent=exponent)[0]
        totals = (np.bincount(self._owner, values, count) for values in (self._levels, flat))
        start = np.zeros(self.levels.stop + _EACH * count)
        start[0], start[self.levels] = exponent, np.divide(*totals)
        prior = np.concatenate([[exponent_error], self._prior[1:]])
        of_moves = slice(len(prior), len(start))
        known = np.zeros((len(start), len(start)))
        known[: len(prior), : len(prior)], known[of_moves, of_moves] = np.diag(1.0 / prior), self._whitening

        def residuals(x: Float64) -> Float64:
            return np.concatenate([(self._predicted(x)[0] - self._levels) / self._error, known @ (x - start)])

        def slopes(x: Float64) -> Float64:
            return np.concatenate([self._predicted(x)[1] / self._error[:, None], known])

        how: dict[str, Any] = {"jac": slopes, "method": "lm", "x_scale": "jac", "max_nfev": MOST_EVALUATIONS}
        found = least_squares(residuals, start, **how)
        mean_square = 2.0 * float(found.cost) / (len(found.fun) - len(start))
        covariance = np.linalg.inv(found.jac.T @ found.jac) * max(1.0, mean_square)
        return _Fit(found.x, covariance, 2.0 * float(found.cost), mean_square)

    def _predicted(self, x: Float64) -> tuple[Float64, Float64]:
        # levels, shape (n,), and their derivatives by all parameters, (n, P)
        each, count = np.arange(len(self._levels)), len(self.lights)
        n, kappa, v1, v2 = x[:_COMMON]
        place = self._place - x[_COMMON : _COMMON + 2]
        square = np.sum(np.square(place), axis=1)
        dimming = 1.0 + square * (v1 + v2 * square)
        slope = np.broadcast_to(x[_TILTS - 2 : _TILTS], (len(each), 2))
        turned = 1.0 + np.sum(self._by_normal * np.column_stack([slope, x[self._tilts][self._posture]]), axis=1)
        moves = x[self.levels.stop :].reshape(count, _EACH)[self._owner]
        moves[:, _ROTATIONS] = x[self._gradients].reshape(count, 2)[self._owner]
        moved = 1.0 + np.sum((self._slopes + 0.5 * self._bends * moves) * moves, axis=1)
        flat, by_n, by_kappa = _irradiance(*self._cosines, exponent=n, kappa=kappa)
        light = flat * moved * turned * dimming
        levels = x[self.levels][self._owner] * light

        # relative ones first
        slopes = np.zeros((len(each), len(x)))
        slopes[:, 0], slopes[:, 1] = by_n / flat, by_kappa / flat
        slopes[:, 2], slopes[:, 3] = square / dimming, np.square(square) / dimming
        slopes[:, _COMMON : _COMMON + 2] = ((v1 + 2.0 * v2 * square) / dimming)[:, None] * -2.0 * place
        by_normal = self._by_normal / turned[:, None]
        slopes[:, _TILTS - 2 : _TILTS] = by_normal[:, :2]
        slopes[each, self._tilts.start + self._posture] = by_normal[:, 2]
        of_moves = self.levels.stop + _EACH * self._owner[:, None] + np.arange(_EACH)
        of_moves[:, _ROTATIONS] = self._gradients.start + 2 * self._owner[:, None] + np.arange(2)
        slopes[each[:, None], of_moves] = (self._slopes + self._bends * moves) / moved[:, None]
        slopes *= levels[:, None]
        slopes[each, self.levels.start + self._owner] = light
        return levels, slopes

    def _of_panels(self, step: Float64, normal_change: Float64 | float = 0.0) -> tuple[Float64, Float64, Float64]:
        panels = [posed_panel(light, own + step) for light, own in zip(self.lights, unmoved(self.lights), strict=True)]
        return _cosines(panels, self._owner, self._points, self._normals + normal_change)


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


def _irradiance(
    weight: Float64, emission: Float64, incidence: Float64, *, exponent: float, kappa: float = 0.0
) -> tuple[Float64, Float64, Float64]:
    # and its derivatives by both exponents
    each = weight * np.exp(exponent * emission + (1.0 + kappa) * incidence)
    return np.sum(each, axis=1), np.sum(each * emission, axis=1), np.sum(each * incidence, axis=1)
