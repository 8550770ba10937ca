"""Where the panels are: fit of their poses and sizes to a mirror ball's images in several postures of the stage.

The ball's outline gives its centre, its mirror images give the panels. Camera and stage are those of the board fit.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture, rotation_from_vector
from lightopt.estimate.rig_calibration._mirror_ball import mirrored_image, outline_distances
from lightopt.lights import PanelLight, panel_corners
from lightopt.scene import PinholeCamera, Stage

PANEL_PARAMETERS = (
    *(f"centre {axis} [mm]" for axis in "xyz"),
    *(f"rotation about {axis} [rad]" for axis in ("across", "along", "outward")),
    *(f"size {axis} [mm]" for axis in ("across", "along")),
)
"""Of each panel: centre in the world frame, rotation about its own axes from the fitted pose, sides."""

# standard deviations of the rig file's panels as they are before the fit, far more than they are off
CENTRE_PRIOR, ROTATION_PRIOR, SIZE_PRIOR = 50.0, 0.5, 0.3  # [mm], [rad], share of the side
EDGE_PRIOR = 0.5  # blur and threshold move the whole outline in or out by about so much [px]
LEAST_RADIUS_ERROR = 1e-4  # [mm]

UNOBSERVABLE = (10.0, 10.0, 10.0, 0.1, 0.1, 0.1, np.inf, np.inf)  # standard errors from which a parameter is not known
OUTLIER = 5.0  # rms of an image's corners, in standard deviations of the fit, from which the image is left out
MOST_OUTLIERS = 0.2  # share of the images

_BALL = 5  # parameters: centre in the stage frame, radius, offset of the outline
_EACH = len(PANEL_PARAMETERS)
_STEP = np.array([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6, 1e-4, 1e-4])


@dataclass(frozen=True, kw_only=True, eq=False)
class MirroredPanel:
    """A panel as the ball mirrors it: corners in order around it [px], shape (4, 2), and their covariance (8, 8)."""

    corners: Float64
    covariance: Float64


@dataclass(frozen=True, kw_only=True, eq=False)
class BallView:
    """The ball in one posture.

    outline: Image points (column, row) of its outline [px], shape (n, 2), with independent errors
    outline_error: Their standard deviation [px]
    panels: Mirrored panels by the name of their light
    """

    posture: Posture
    outline: Float64
    outline_error: float
    panels: Mapping[str, MirroredPanel]


@dataclass(frozen=True, kw_only=True, eq=False)
class BallFit:
    """Panels, and the ball that showed them.

    lights: As they were given, with the fitted pose and size
    centre: Of the ball, stage frame [mm], shape (3,)
    covariance: Of centre, radius, offset of the outline [px], and then :data:`PANEL_PARAMETERS` of each light, shape
        (5 + 8·L, 5 + 8·L)
    rms: Of the residuals, in the standard deviations that the images claim; about 1
    unobservable: Parameters that these postures do not show
    left_out: Postures and lights whose image fits no panel pose
    """

    lights: tuple[PanelLight, ...]
    centre: Float64
    radius: float
    edge_offset: float
    covariance: Float64
    rms: float
    unobservable: tuple[str, ...]
    left_out: tuple[tuple[Posture, str], ...]
    _problem: _Problem = field(repr=False)

    def panel_covariance(self, number: int) -> Float64:
        """Of the :data:`PANEL_PARAMETERS` of the light with this number, shape (8, 8)."""
        first = _BALL + _EACH * number
        return self.covariance[first : first + _EACH, first : first + _EACH]

    @property
    def panels_covariance(self) -> Float64:
        """Of the parameters of all panels, shape (8·L, 8·L)."""
        return self.covariance[_BALL:, _BALL:]

    def half_widths_95(self, number: int) -> Float64:
        """Of the 95 % intervals of the :data:`PANEL_PARAMETERS` of a light, shape (8,)."""
        return 1.96 * np.sqrt(np.diag(self.panel_covariance(number)))

    def next_posture(self, candidates: Sequence[Posture]) -> Posture:
        """Of some postures the one that would narrow the intervals of the panels most, seen as well as the others."""
        problem, x = self._problem, self._problem.start
        seen = [image.covariance for view in problem.views for image in view.panels.values()]
        typical = np.mean(seen, axis=0) if seen else np.eye(8) * 0.01
        best, least = candidates[0], np.inf
        information = np.linalg.inv(self.covariance)
        for posture in candidates:
            corners = {light.name: MirroredPanel(corners=np.zeros((4, 2)), covariance=typical) for light in self.lights}
            outline = problem.views[0].outline[:0]
            view = BallView(posture=posture, outline=outline, outline_error=1.0, panels=corners)
            more = _Problem(problem.camera, problem.stage, problem.lights, (view,), x, problem.prior)
            slope = more.slopes(x)[: -len(x)]
            slope = slope[np.isfinite(slope).all(axis=1)]
            errors = np.diag(np.linalg.inv(information + slope.T @ slope))[_BALL:].reshape(-1, _EACH)
            cost = float(np.sum(errors[:, :6] / np.square(UNOBSERVABLE[:6])))
            if cost < least:
                best, least = posture, cost
        return best


def fit_ball(
    views: Sequence[BallView],
    *,
    lights: Sequence[PanelLight],
    camera: PinholeCamera,
    stage: Stage,
    radius: float,
    radius_error: float = 0.0,
    size_error: float | None = None,
    rig_deviations: Sequence[tuple[PinholeCamera, Stage]] = (),
) -> BallFit:
    """Fit the ball's centre in the stage frame, and pose and size of each panel.

    lights: Panels as the rig file has them, world frame, from which the fit starts; within about half their size and
        20°, so that the corners can be told apart
    radius, radius_error: Of the ball, and its standard deviation [mm]
    size_error: Standard deviation of the lights' given sizes [mm]; None where they are unknown
    rig_deviations: Camera and stage, displaced by one standard deviation along each independent direction of their
        covariance; what they change is added to the covariance
    Raises InputError: Where views do not show what is to be fitted
    """
    _check(views, lights)
    start = np.concatenate([_ball_start(views, camera, stage, radius), np.zeros(_EACH * len(lights))])
    size = np.array([light.size for light in lights])
    start[_BALL:].reshape(-1, _EACH)[:, 6:] = size
    prior = np.empty((len(lights), _EACH))
    prior[:, :3], prior[:, 3:6] = CENTRE_PRIOR, ROTATION_PRIOR
    prior[:, 6:] = SIZE_PRIOR * size if size_error is None else size_error
    ball_prior = [np.inf, np.inf, np.inf, max(radius_error, LEAST_RADIUS_ERROR), EDGE_PRIOR]
    problem = _Problem(camera, stage, tuple(lights), tuple(views), start, np.concatenate([ball_prior, prior.ravel()]))
    problem = replace(problem, views=tuple(_ordered(problem, view) for view in views))
    left_out: list[tuple[Posture, str]] = []
    images = sum(len(view.panels) for view in views)
    while True:
        found = least_squares(problem.residuals, problem.start, problem.slopes, method="lm", x_scale="jac")
        worst, view, light = problem.worst_image(found.x)
        freedom = max(1, len(found.fun) - len(start))
        scale = max(1.0, 2.0 * float(found.cost) / freedom)
        if worst < OUTLIER or len(left_out) >= MOST_OUTLIERS * images:
            break
        left_out.append((problem.views[view].posture, light))
        problem = problem.without(view, light)
    slope = problem.slopes(found.x)
    covariance = np.linalg.inv(slope.T @ slope) * scale
    at_solution = replace(problem, lights=problem.posed(found.x), start=_without_rotation(found.x))
    nominal = problem.residuals(found.x)
    for other_camera, other_stage in rig_deviations:
        change = replace(problem, camera=other_camera, stage=other_stage).residuals(found.x) - nominal
        shift = np.linalg.solve(slope.T @ slope, slope.T @ change)
        covariance = covariance + np.outer(shift, shift)
    errors = np.sqrt(np.diag(covariance))[_BALL:].reshape(-1, _EACH)
    return BallFit(
        lights=at_solution.lights,
        centre=found.x[:3],
        radius=float(found.x[3]),
        edge_offset=float(found.x[4]),
        covariance=covariance,
        rms=float(np.sqrt(2.0 * found.cost / freedom)),
        unobservable=tuple(
            f"{light.name}: {name}"
            for light, row in zip(lights, errors, strict=True)
            for name, error, limit in zip(PANEL_PARAMETERS, row, UNOBSERVABLE, strict=True)
            if error > limit
        ),
        left_out=tuple(left_out),
        _problem=at_solution,
    )


@dataclass(frozen=True)
class _Problem:
    camera: PinholeCamera
    stage: Stage
    lights: tuple[PanelLight, ...]
    views: tuple[BallView, ...]
    start: Float64
    prior: Float64  # standard deviations of the parameters about the start

    def posed(self, x: Float64) -> tuple[PanelLight, ...]:
        return tuple(
            posed_panel(light, row) for light, row in zip(self.lights, x[_BALL:].reshape(-1, _EACH), strict=True)
        )

    def mirrored(self, x: Float64) -> Float64:
        # corners of each light in each view [px], shape (V, L, 4, 2)
        corners = np.array([panel_corners(light) for light in self.posed(x)])
        centres = np.array([self._centre(view.posture, x) for view in self.views])
        return mirrored_image(self.camera, centres[:, None, None, :], float(x[3]), corners[None])

    def residuals(self, x: Float64) -> Float64:
        outlines = [self._outline(view, x) for view in self.views]
        corners = self._corner_residuals(x)
        return np.concatenate([*outlines, corners.ravel(), (x - self.start) / self.prior])

    def slopes(self, x: Float64) -> Float64:
        """Derivatives of the residuals; a panel moves only its own corners, so all panels are moved at once."""
        points = sum(len(view.outline) for view in self.views)
        present = [(v, k) for v, view in enumerate(self.views) for k in self._numbers(view)]
        found = np.zeros((points + 8 * len(present) + len(x), len(x)))
        corner_rows = slice(points, points + 8 * len(present))
        for j, step in enumerate((1e-4, 1e-4, 1e-4, 1e-4, 1e-3)):
            move = np.zeros(len(x))
            move[j] = step
            change = self.residuals(x + move) - self.residuals(x - move)
            found[:, j] = change / (2.0 * step)
        owner = np.array([k for _, k in present], np.intp)
        block = np.arange(8 * len(present)).reshape(-1, 8) + points
        for j, step in enumerate(_STEP):
            move = np.zeros(len(x))
            move[_BALL + j :: _EACH] = step
            change = (self._corner_residuals(x + move) - self._corner_residuals(x - move)) / (2.0 * step)
            found[block, (_BALL + _EACH * owner + j)[:, None]] = change
        found[corner_rows.stop :] = np.diag(1.0 / self.prior)
        return found

    def worst_image(self, x: Float64) -> tuple[float, int, str]:
        rms = np.sqrt(np.mean(np.square(self._corner_residuals(x)), axis=1))
        if not len(rms):
            return 0.0, 0, ""
        # in units of what most images are off, which is more than they claim where camera or stage are
        worst = int(np.argmax(rms))
        present = [(v, name) for v, view in enumerate(self.views) for name in view.panels]
        return float(rms[worst] / max(1.0, float(np.median(rms)))), *present[worst]

    def without(self, number: int, light: str) -> _Problem:
        view = self.views[number]
        kept = replace(view, panels={name: image for name, image in view.panels.items() if name != light})
        return replace(self, views=(*self.views[:number], kept, *self.views[number + 1 :]))

    def _numbers(self, view: BallView) -> list[int]:
        names = [light.name for light in self.lights]
        return [names.index(name) for name in view.panels]

    def _corner_residuals(self, x: Float64) -> Float64:
        # in standard deviations, shape (images, 8)
        predicted = self.mirrored(x)
        rows = [
            np.linalg.solve(np.linalg.cholesky(image.covariance), (predicted[v, k] - image.corners).ravel())
            for v, view in enumerate(self.views)
            for k, image in zip(self._numbers(view), view.panels.values(), strict=True)
        ]
        return np.array(rows).reshape(-1, 8)

    def _outline(self, view: BallView, x: Float64) -> Float64:
        away = outline_distances(self.camera, self._centre(view.posture, x), float(x[3]), view.outline)
        return (away - x[4]) / view.outline_error

    def _centre(self, posture: Posture, x: Float64) -> Float64:
        rotation, translation = self.stage.transform(posture)
        return rotation @ x[:3] + translation


def posed_panel(light: PanelLight, parameters: Float64) -> PanelLight:
    """A panel displaced by :data:`PANEL_PARAMETERS`: offset of the centre, rotation about its own axes, new sides.

    light: World frame; its fall-off stays normalised where it is.
    """
    axes = np.stack([light.across, light.along, light.outward], axis=1)
    across, along, outward = (axes @ rotation_from_vector(parameters[3:6])).T
    centre = light.centre + parameters[:3]
    distance = float(np.linalg.norm(centre))
    return replace(
        light,
        elevation=math.asin(centre[2] / distance),
        azimuth=math.atan2(centre[1], centre[0]),
        distance=distance,
        centre=centre,
        across=across,
        along=along,
        outward=outward,
        size=(float(parameters[6]), float(parameters[7])),
        reference_distance=light.reference_distance or light.distance,
    )


def _without_rotation(x: Float64) -> Float64:
    found = x.copy()
    found[_BALL:].reshape(-1, _EACH)[:, :6] = 0.0
    return found


def _ball_start(views: Sequence[BallView], camera: PinholeCamera, stage: Stage, radius: float) -> Float64:
    """Ball parameters from the outlines alone, shape (5,)."""
    poses = [stage.transform(view.posture) for view in views]

    def residuals(x: Float64) -> Float64:
        return np.concatenate(
            [
                (outline_distances(camera, r @ x[:3] + t, radius, view.outline) - x[3]) / view.outline_error
                for view, (r, t) in zip(views, poses, strict=True)
            ]
            + [x[3:] / EDGE_PRIOR]
        )

    found = least_squares(residuals, np.array([0.0, 0.0, radius, 0.0]), method="lm", x_scale="jac")
    return np.array([*found.x[:3], radius, found.x[3]])


def _ordered(problem: _Problem, view: BallView) -> BallView:
    """The view with its corners in the order of :func:`lightopt.lights.panel_corners`, as near to the nominal panel.

    Which corner is which shows in the shape about the centre only: a panel may be far from where the file has it.
    """
    numbers = {light.name: k for k, light in enumerate(problem.lights)}
    predicted = replace(problem, views=(view,)).mirrored(problem.start)[0]
    panels: dict[str, MirroredPanel] = {}
    for name, image in view.panels.items():
        expected = predicted[numbers[name]]
        expected = expected - expected.mean(axis=0)
        orders = [
            np.array([(first + sense * k) % 4 for k in range(4)])
            for first, sense in itertools.product(range(4), (1, -1))
        ]
        centred = image.corners - image.corners.mean(axis=0)
        best = min(orders, key=lambda order: float(np.sum(np.square(centred[order] - expected))))
        entries = np.stack([2 * best, 2 * best + 1], axis=1).ravel()
        covariance = image.covariance[np.ix_(entries, entries)]
        panels[name] = MirroredPanel(corners=image.corners[best], covariance=covariance)
    return replace(view, panels=panels)


def _check(views: Sequence[BallView], lights: Sequence[PanelLight]) -> None:
    problems: list[str] = []
    names = {light.name for light in lights}
    if not any(view.panels for view in views):
        problems.append("no view shows a mirrored panel: expose so short that the highlights are not saturated")
    problems += [
        f"posture {view.posture}: {name} is no light of the rig ({', '.join(sorted(names))})"
        for view in views
        for name in view.panels
        if name not in names
    ]
    if len({view.posture.elevation_deg for view in views}) < 2:
        problems.append(
            "all views have one tilt, which leaves the ball's height unknown and the panels centimetres off: add "
            "views with another tilt, at best 40° apart"
        )
    if problems:
        raise InputError(*(f"ball: {problem}" for problem in problems))
