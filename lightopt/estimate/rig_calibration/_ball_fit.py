"""Where the panels are: fit of their poses and sizes to a mirror ball's images in several postures of the stage.

The ball's outline gives its centre, its mirror images give the panels: points of the ball that mirror points of the
room. Camera and stage are those of the board fit; of a rig file alone, they are fitted as well.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from lightopt.core.arrays import Float64
from lightopt.core.errors import refuse
from lightopt.core.transforms import Posture, rotation_from_vector
from lightopt.estimate.rig_calibration._deviations import NORMAL_95, displaced, rig_deviations, square_root
from lightopt.lights import PanelLight, panel_corners
from lightopt.scene import PinholeCamera, Stage, pixel_directions, project

_MOST_STEPS, _ANGLE_TOLERANCE = 60, 1e-13  # [rad]
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
COARSE_PX = 3.0  # error of outlines to start with
MOST_EVALUATIONS = 200  # of a fit, without those of derivatives: twenty are enough where images and rig agree
_BALL = 5  # parameters: centre in the stage frame, radius, offset of the outline
_EACH = len(PANEL_PARAMETERS)


def mirror_points(centre: Float64, radius: float, eye: Float64, points: Float64) -> Float64:
    """Points of a ball where an eye sees other points mirrored [mm], shape (..., 3); NaN for a point it cannot mirror.

    In the plane of ball, eye and point, the angle ψ from the eye's direction to the mirror point makes the angles of
    incidence and reflection equal: ``atan2(a·sinψ, a·cosψ − r) = atan2(b·sin(γ−ψ), b·cos(γ−ψ) − r)``, with the
    distances a and b of eye and point from the ball's centre and the angle γ between them (Alhazen's problem).

    centre, eye, points: [mm], shapes (..., 3), of one frame
    """
    to_eye, to_point = eye - centre, points - centre
    a, b = np.linalg.norm(to_eye, axis=-1), np.linalg.norm(to_point, axis=-1)
    first = to_eye / a[..., None]
    across = to_point - np.sum(to_point * first, axis=-1, keepdims=True) * first
    length = np.linalg.norm(across, axis=-1)
    second = across / np.maximum(length, 1e-300)[..., None]
    gamma = np.arctan2(length, np.sum(to_point * first, axis=-1))
    low, high = np.zeros_like(gamma), gamma.copy()
    psi = 0.5 * gamma
    for _ in range(_MOST_STEPS):
        (incidence, slope), (reflection, more) = _reflection(a, radius, psi), _reflection(b, radius, gamma - psi)
        off = incidence - reflection
        low, high = np.where(off < 0.0, psi, low), np.where(off < 0.0, high, psi)
        step = psi - off / (slope + more)
        # Newton's step where it stays between the bounds, half of them elsewhere
        step = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        done = np.abs(step - psi) <= _ANGLE_TOLERANCE
        psi = step
        if done.all():
            break
    seen = (a * np.cos(psi) > radius) & (b * np.cos(gamma - psi) > radius)
    psi = np.where(seen, psi, np.nan)[..., None]
    return centre + radius * (np.cos(psi) * first + np.sin(psi) * second)


def _reflection(distance: Float64, radius: float, psi: Float64) -> tuple[Float64, Float64]:
    # the angle of incidence or of reflection [rad], and its slope by ψ
    sine, cosine = np.sin(psi), np.cos(psi)
    square = distance * distance - 2.0 * distance * radius * cosine + radius * radius
    angle = np.arctan2(distance * sine, distance * cosine - radius)
    return angle, (distance * distance - distance * radius * cosine) / square


def mirrored_image(camera: PinholeCamera, centre: Float64, radius: float, points: Float64) -> Float64:
    """Image points (column, row) [px] of points mirrored by a ball, shape (..., 2); NaN where there are none.

    centre, points: [mm], shapes (..., 3), frame of the camera's vectors
    """
    mirror = mirror_points(centre, radius, camera.position, points)
    columns, rows, _ = project(camera, mirror.reshape(-1, 3))
    return np.stack([columns, rows], axis=-1).reshape((*mirror.shape[:-1], 2))


def outline_distances(camera: PinholeCamera, centre: Float64, radius: float, outline: Float64) -> Float64:
    """How far image points are outside a ball's outline [px], shape (n,).

    The outline is the cone ``(x·c)² = (|c|² − r²)·|x|²`` about the direction c of the ball's centre, of half angle
    arcsin(r/|c|): exact for every lens, an ellipse for one without distortion.

    centre: [mm], shape (3,), frame of the camera's vectors
    outline: Image points (column, row) [px], shape (n, 2)
    """
    rays = pixel_directions(camera, *np.ascontiguousarray(outline.T))
    to_centre = centre - camera.position
    away = float(np.linalg.norm(to_centre))
    angle = np.arctan2(np.linalg.norm(np.cross(rays, to_centre), axis=1), rays @ to_centre)
    # a radian is so many pixels in the direction from the centre's image, for which the mean of both directions serves
    scale = camera.image_distance / camera.pixel_size
    off_axis = np.sum(np.square(rays), axis=1)  # 1 + tan²
    return (angle - np.arcsin(radius / away)) * scale * off_axis**0.75


@dataclass(frozen=True, kw_only=True, eq=False)
class MirroredPanel:
    """A panel as the ball mirrors it: corners in order around it [px], shape (4, 2), and their covariance (8, 8)."""

    corners: Float64
    covariance: Float64


@dataclass(frozen=True, kw_only=True, eq=False)
class BallView:
    posture: Posture
    outline: Float64  # image points (column, row) of its outline [px], shape (n, 2), with independent errors
    outline_error: float  # their standard deviation [px]
    panels: Mapping[str, MirroredPanel]  # mirrored panels by the name of their light


@dataclass(frozen=True, kw_only=True, eq=False)
class BallFit:
    lights: tuple[PanelLight, ...]  # as they were given, with the fitted pose and size
    centre: Float64  # of the ball, stage frame [mm], shape (3,)
    radius: float  # [mm]
    # of centre, radius, edge offset, then PANEL_PARAMETERS of each light, shape (5 + 8·L, 5 + 8·L)
    covariance: Float64
    rms: float  # of the residuals, in the standard deviations that the images claim; about 1
    unobservable: tuple[str, ...]  # parameters that these postures do not show
    left_out: tuple[tuple[Posture, str], ...]  # postures and lights whose image fits no panel pose
    shown: tuple[str, ...]  # names of the lights that some view shows; the others are as they were given

    @property
    def panels_covariance(self) -> Float64:
        """Of the :data:`PANEL_PARAMETERS` of all lights, shape (8·L, 8·L)."""
        return self.covariance[_BALL:, _BALL:]

    @property
    def half_widths_95(self) -> Float64:
        """Of the 95 % intervals of the :data:`PANEL_PARAMETERS` of each light, shape (L, 8)."""
        return NORMAL_95 * np.sqrt(np.diag(self.panels_covariance)).reshape(-1, _EACH)


def fit_ball(
    views: Sequence[BallView],
    *,
    lights: Sequence[PanelLight],
    camera: PinholeCamera,
    stage: Stage,
    radius: float,
    radius_error: float = LEAST_RADIUS_ERROR,
    size_error: float | None = None,
    rig_names: Sequence[str] = (),
    rig_covariance: Float64 | None = None,
    fit_rig: bool = False,
) -> BallFit:
    """Fit the ball's centre in the stage frame, and pose and size of each panel.

    lights: Panels as the rig file has them, world frame, from which the fit starts; within about 20°, so that their
        corners can be told apart
    radius, radius_error: Of the ball, and its standard deviation [mm]
    size_error: Standard deviation of the lights' given sizes [mm]; None where they are unknown
    rig_names, rig_covariance: Values of camera and stage that are not exact, as `BoardFit.names` has them, and their
        covariance, which widens that of the panels
    fit_rig: Whether these values are fitted, too, from where they are given; else they stay
    Raises InputError: Where views do not show what is to be fitted
    """
    _check(views, lights)
    of_values = np.zeros((0, 0)) if rig_covariance is None else rig_covariance
    of_rig = (tuple(rig_names), square_root(of_values)) if fit_rig else ((), np.zeros((0, 0)))
    ball, deviation = _ball_start(views, camera, stage, radius, of_rig)
    start = np.concatenate([ball, unmoved(lights).ravel(), deviation])
    prior = np.tile([*[CENTRE_PRIOR] * 3, *[ROTATION_PRIOR] * 3, 0.0, 0.0], (len(lights), 1))
    prior[:, 6:] = [[size_error or SIZE_PRIOR * side for side in light.size] for light in lights]
    ball_prior = [np.inf, np.inf, np.inf, max(radius_error, LEAST_RADIUS_ERROR), EDGE_PRIOR]
    errors = np.concatenate([ball_prior, prior.ravel(), np.ones(len(deviation))])
    nominal = np.concatenate([ball, unmoved(lights).ravel(), np.zeros(len(deviation))])
    problem = _Problem(camera, stage, tuple(lights), tuple(views), nominal, errors, *of_rig)
    problem = replace(problem, images=_ordered(problem, start))
    left_out: list[tuple[Posture, str]] = []
    most = MOST_OUTLIERS * len(problem.images)
    while True:
        found = least_squares(problem.residuals, start, x_scale="jac", max_nfev=MOST_EVALUATIONS)
        mean_square = 2.0 * float(found.cost) / max(1, len(found.fun) - len(start))
        rms = np.sqrt(np.mean(np.square(problem.corner_residuals(found.x)), axis=1))
        worst = int(np.argmax(rms))
        # in units of what most images are off, which is more than they claim where camera or stage are
        if rms[worst] < OUTLIER * max(1.0, float(np.median(rms))) or len(left_out) >= most:
            break
        image = problem.images[worst]
        left_out.append((views[image.view].posture, lights[image.light].name))
        problem = replace(problem, images=(*problem.images[:worst], *problem.images[worst + 1 :]))
    covariance = np.linalg.inv(found.jac.T @ found.jac) * max(1.0, mean_square)
    covariance = covariance[: len(start) - len(deviation), : len(start) - len(deviation)]
    # what another rig would have changed
    for other_camera, other_stage in () if fit_rig else rig_deviations(camera, stage, rig_names, of_values):
        change = replace(problem, camera=other_camera, stage=other_stage).residuals(found.x) - found.fun
        shift = np.linalg.solve(found.jac.T @ found.jac, found.jac.T @ change)
        covariance += np.outer(shift, shift)
    errors = np.sqrt(np.diag(covariance))[_BALL:]
    return BallFit(
        lights=problem.posed(found.x),
        centre=found.x[:3],
        radius=float(found.x[3]),
        covariance=covariance,
        rms=math.sqrt(mean_square),
        unobservable=tuple(
            name
            for name, error, limit in zip(panel_names(lights), errors, UNOBSERVABLE * len(lights), strict=True)
            if error > limit
        ),
        left_out=tuple(left_out),
        shown=tuple(light.name for light in lights if any(light.name in view.panels for view in views)),
    )


@dataclass(frozen=True)
class _Image:
    # a mirrored panel, with corners in the order of panel_corners; whitening·difference has independent entries
    view: int
    light: int
    corners: Float64
    whitening: Float64


@dataclass(frozen=True)
class _Problem:
    camera: PinholeCamera
    stage: Stage
    lights: tuple[PanelLight, ...]
    views: tuple[BallView, ...]
    nominal: Float64  # parameters as they are known beforehand, and their standard deviations
    prior: Float64
    # values of camera and stage that are fitted, and their deviation per unit of the last parameters, shape (G, G)
    rig_names: tuple[str, ...] = ()
    rig_root: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    images: tuple[_Image, ...] = ()

    def posed(self, x: Float64) -> tuple[PanelLight, ...]:
        moves = x[_BALL : _BALL + _EACH * len(self.lights)].reshape(-1, _EACH)
        return tuple(posed_panel(light, move) for light, move in zip(self.lights, moves, strict=True))

    def mirrored(self, x: Float64) -> Float64:
        # corners of each light in each view [px], shape (V, L, 4, 2)
        corners = np.array([panel_corners(light) for light in self.posed(x)])
        camera, stage = self._rig(x)
        centres = np.array([_centre(stage, view, x) for view in self.views])
        return mirrored_image(camera, centres[:, None, None, :], float(x[3]), corners[None])

    def residuals(self, x: Float64) -> Float64:
        camera, stage = self._rig(x)
        outlines = [
            (outline_distances(camera, _centre(stage, view, x), float(x[3]), view.outline) - x[4]) / view.outline_error
            for view in self.views
        ]
        return np.concatenate([*outlines, self.corner_residuals(x).ravel(), (x - self.nominal) / self.prior])

    def corner_residuals(self, x: Float64) -> Float64:
        # in standard deviations, shape (images, 8)
        if not self.images:
            return np.zeros((0, 8))
        predicted = self.mirrored(x)
        return np.array([i.whitening @ (predicted[i.view, i.light] - i.corners).ravel() for i in self.images])

    def _rig(self, x: Float64) -> tuple[PinholeCamera, Stage]:
        if not self.rig_names:
            return self.camera, self.stage
        deviation = self.rig_root @ x[_BALL + _EACH * len(self.lights) :]
        return displaced(self.camera, self.stage, self.rig_names, deviation)


def _centre(stage: Stage, view: BallView, x: Float64) -> Float64:
    rotation, translation = stage.transform(view.posture)
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


def panel_names(lights: Sequence[PanelLight]) -> list[str]:
    return [f"{light.name} {name}" for light in lights for name in PANEL_PARAMETERS]


def unmoved(lights: Sequence[PanelLight]) -> Float64:
    """The :data:`PANEL_PARAMETERS` of panels where they are, shape (L, 8)."""
    return np.array([[0.0] * 6 + [*light.size] for light in lights])


def _ball_start(
    views: Sequence[BallView],
    camera: PinholeCamera,
    stage: Stage,
    radius: float,
    of_rig: tuple[tuple[str, ...], Float64],
) -> tuple[Float64, Float64]:
    """Ball parameters, shape (5,), and deviations of the rig, shape (D,), from the outlines alone."""
    count = of_rig[1].shape[1]
    nominal = np.concatenate([[0.0, 0.0, radius, radius, 0.0], np.zeros(count)])
    errors = np.concatenate([[np.inf] * 3, [LEAST_RADIUS_ERROR, EDGE_PRIOR], np.ones(count)])
    # trusted less at first: from far off, exact outlines have other minima
    x = nominal
    for some in ([replace(view, outline_error=COARSE_PX) for view in views], views):
        ball = _Problem(camera, stage, (), tuple(some), nominal, errors, *of_rig)
        x = least_squares(ball.residuals, x, x_scale="jac", max_nfev=MOST_EVALUATIONS).x
    return x[:_BALL], x[_BALL:]


def _ordered(problem: _Problem, start: Float64) -> tuple[_Image, ...]:
    """The images with their corners in the order of :func:`lightopt.lights.panel_corners`.

    The shape about its centre alone shows which corner is which: a panel may be far from where the file has it.
    """
    predicted = problem.mirrored(start)
    numbers = {light.name: k for k, light in enumerate(problem.lights)}
    orders = [(first + sense * np.arange(4)) % 4 for first, sense in itertools.product(range(4), (1, -1))]
    images: list[_Image] = []
    for number, view in enumerate(problem.views):
        for name, image in view.panels.items():
            expected = predicted[number, numbers[name]]
            offset = image.corners.mean(axis=0) - expected.mean(axis=0)
            order = min(orders, key=lambda o: float(np.sum(np.square(image.corners[o] - offset - expected))))
            entries = np.stack([2 * order, 2 * order + 1], axis=1).ravel()
            root = np.linalg.cholesky(image.covariance[np.ix_(entries, entries)])
            whitening = np.asarray(np.linalg.inv(root), np.float64)
            images.append(_Image(number, numbers[name], image.corners[order], whitening))
    return tuple(images)


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
        problems.append("all views have one tilt: add views with another tilt, at best 40° apart")
    refuse(f"ball: {problem}" for problem in problems)
