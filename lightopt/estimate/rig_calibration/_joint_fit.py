"""The joint least squares of camera, stage axes and board on the corners of all views.

The world is fixed by the stage: Z is the rotary axis at tilt reading 0, X the tilt axis projected onto the plane normal
to Z. The tilt axis has the direction (cos ε, 0, sin ε) and passes through (0, p_y, p_z).

Robust at first (:mod:`lightopt.core.least_squares`), then on all corners within 4 robust standard deviations. Errors of
the stage's readings are random effects, two for each view; so the covariance holds them, too.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from lightopt.core.arrays import Bool, Float64, Index
from lightopt.core.errors import InputError
from lightopt.core.least_squares import Limits, solve
from lightopt.core.transforms import rotation_from_vector
from lightopt.estimate.rig_calibration._board import Board
from lightopt.scene import Stage

# every parameter of the model, in this order; lengths [mm], angles [rad], image [px]
NAMES = (
    *(f"camera.rotation_{axis}" for axis in "xyz"),  # about the camera's own axes: x right, y down, z forward
    *(f"camera.position_{axis}" for axis in "xyz"),  # world
    *("camera.focal_px", "camera.principal_x_px", "camera.principal_y_px", "camera.aspect"),
    *(f"camera.{name}" for name in ("k1", "k2", "p1", "p2", "k3")),
    # ε, p_y and p_z
    *("tilt_axis.elevation", "tilt_axis.position_y", "tilt_axis.position_z", "tilt_axis.scale", "rotary_axis.scale"),
    *(f"board.rotation_{axis}" for axis in "xyz"),  # about the world's axes at posture (0, 0)
    *(f"board.position_{axis}" for axis in "xyz"),
    *("board.scale", "board.pitch_ratio", "board.bow_xx", "board.bow_xy", "board.bow_yy"),
)
AT = {name: i for i, name in enumerate(NAMES)}
CAMERA_ROTATION, CAMERA_POSITION = slice(0, 3), slice(3, 6)
BOARD_ROTATION = slice(AT["board.rotation_x"], AT["board.rotation_x"] + 3)
BOARD_POSITION = slice(AT["board.position_x"], AT["board.position_x"] + 3)
LENS = slice(AT["camera.k1"], AT["camera.k1"] + 5)
BOW = slice(AT["board.bow_xx"], AT["board.bow_xx"] + 3)


@dataclass(frozen=True, eq=False)
class Origin:
    """Orientations that the rotation parameters start from, each of shape (3, 3)."""

    camera: Float64  # rows are the camera's right, down and forward, world frame
    board: Float64  # board frame to world at posture (0, 0)

    def moved(self, x: Float64) -> "Origin":
        """With the rotation parameters of `x` in it, so that they are 0 next."""
        return replace(
            self,
            camera=rotation_from_vector(x[CAMERA_ROTATION]) @ self.camera,
            board=rotation_from_vector(x[BOARD_ROTATION]) @ self.board,
        )


@dataclass(frozen=True, eq=False)
class Sightings:
    """Points of the board that images show, N in K views."""

    points: Float64  # board frame [mm], shape (N, 2)
    half: Float64  # half the board's sides [mm], which the bow is measured at
    view: Index  # number of the view, shape (N,)
    readings: Float64  # tilt and rotation of each view [rad], shape (K, 2)


def sightings(board: Board, ids: list[Index], readings: Float64) -> Sightings:
    points = board.points
    view = np.repeat(np.arange(len(ids)), [len(i) for i in ids])
    return Sightings(points[np.concatenate(ids)], np.abs(points).max(axis=0), view, readings)


def stage_of(x: Float64) -> Stage:
    epsilon = x[AT["tilt_axis.elevation"]]
    return Stage(
        pivot=np.zeros(3),
        tilt_point=np.array([0.0, x[AT["tilt_axis.position_y"]], x[AT["tilt_axis.position_z"]]]),
        tilt_direction=np.array([np.cos(epsilon), 0.0, np.sin(epsilon)]),
        tilt_scale=float(x[AT["tilt_axis.scale"]]),
        rotary_scale=float(x[AT["rotary_axis.scale"]]),
    )


def predict(
    x: Float64, angles: Float64, origin: Origin, seen: Sightings, *, slopes: bool = True
) -> tuple[Float64, Float64, Float64]:
    """Pixels (column, row) [px], shape (N, 2); NaN behind the camera.

    Also their derivatives by all of NAMES, shape (N, 2, P), and by the errors of tilt and rotation of their own view,
    shape (N, 2, 2); both empty without `slopes`.

    x: Parameters, shape (P,)
    angles: Errors of tilt and rotation [rad], shape (K, 2)
    """
    flat = seen.points * np.exp(x[AT["board.scale"]] + 0.5 * x[AT["board.pitch_ratio"]] * np.array([1.0, -1.0]))
    along = seen.points / seen.half
    bends = np.column_stack([along[:, 0] ** 2, along[:, 0] * along[:, 1], along[:, 1] ** 2])
    on_board = np.column_stack([flat, bends @ x[BOW]])
    board = rotation_from_vector(x[BOARD_ROTATION]) @ origin.board
    turned = on_board @ board.T
    q = turned + x[BOARD_POSITION]

    scales = x[[AT["tilt_axis.scale"], AT["rotary_axis.scale"]]]
    actual = (seen.readings + angles)[seen.view]
    tilt, turn = (scales * actual).T
    spin = _matrices(np.array([0.0, 0.0, 1.0]), turn)
    epsilon = x[AT["tilt_axis.elevation"]]
    u, across = np.array([np.cos(epsilon), 0.0, np.sin(epsilon)]), np.array([-np.sin(epsilon), 0.0, np.cos(epsilon)])
    lift = _matrices(u, tilt)
    point = np.array([0.0, x[AT["tilt_axis.position_y"]], x[AT["tilt_axis.position_z"]]])
    v = np.einsum("nij,nj->ni", spin, q)
    lifted = np.einsum("nij,nj->ni", lift, v - point)
    camera = rotation_from_vector(x[CAMERA_ROTATION]) @ origin.camera
    seen_at = (lifted + point - x[CAMERA_POSITION]) @ camera.T

    pixels, by_point, by_lens = _image(x, seen_at)
    if not slopes:
        return pixels, np.zeros((0, 2, 0)), np.zeros((0, 2, 0))
    to_camera = np.einsum("ij,njk->nik", camera, lift)
    from_part = np.einsum("nij,njk->nik", to_camera, spin)
    moves = np.zeros((len(q), 3, len(NAMES)))  # of the point in the camera's frame
    moves[:, :, CAMERA_ROTATION] = -_cross_matrices(seen_at)
    moves[:, :, CAMERA_POSITION] = -camera
    y, c, s = v - point, np.cos(tilt)[:, None], np.sin(tilt)[:, None]
    turned_axis = np.cross(across, y) * s + (across * (y @ u)[:, None] + u * (y @ across)[:, None]) * (1.0 - c)
    moves[:, :, AT["tilt_axis.elevation"]] = turned_axis @ camera.T
    held = camera - to_camera
    moves[:, :, AT["tilt_axis.position_y"]], moves[:, :, AT["tilt_axis.position_z"]] = held[:, :, 1], held[:, :, 2]
    by_tilt = np.cross(u, lifted) @ camera.T
    by_turn = np.einsum("nij,nj->ni", to_camera, np.cross([0.0, 0.0, 1.0], v))
    moves[:, :, AT["tilt_axis.scale"]] = by_tilt * actual[:, :1]
    moves[:, :, AT["rotary_axis.scale"]] = by_turn * actual[:, 1:]
    moves[:, :, BOARD_ROTATION] = np.einsum("nij,njk->nik", from_part, -_cross_matrices(turned))
    moves[:, :, BOARD_POSITION] = from_part
    in_plane = np.stack([flat, 0.5 * flat * [1.0, -1.0]], axis=2)  # by scale and ratio
    stretched = np.einsum("ij,njk->nik", board[:, :2], in_plane)
    moves[:, :, [AT["board.scale"], AT["board.pitch_ratio"]]] = from_part @ stretched
    moves[:, :, BOW] = np.einsum("nij,j,nk->nik", from_part, board[:, 2], bends)
    by_all = by_point @ moves
    by_all[:, :, AT["camera.focal_px"] : LENS.stop] = by_lens
    return pixels, by_all, by_point @ np.stack([scales[0] * by_tilt, scales[1] * by_turn], axis=2)


def _image(x: Float64, points: Float64) -> tuple[Float64, Float64, Float64]:
    # pixels of points in the camera's frame (x right, y down, z forward), and their derivatives by the point and by
    # focal length, principal point, aspect and the lens's five; OpenCV's model of distortion
    f, cx, cy, aspect = x[AT["camera.focal_px"] : LENS.start]
    k1, k2, p1, p2, k3 = x[LENS]
    z = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
    a, b = points[:, 0] / z, points[:, 1] / z
    r2 = a * a + b * b
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    lens_a = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    lens_b = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2))
    j_aa = radial + slope * a * a + 2.0 * p1 * b + 6.0 * p2 * a
    j_ab = slope * a * b + 2.0 * p1 * a + 2.0 * p2 * b
    j_bb = radial + slope * b * b + 6.0 * p1 * b + 2.0 * p2 * a
    by_point = np.empty((len(points), 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 1] = f * j_aa / z, f * j_ab / z
    by_point[:, 1, 0], by_point[:, 1, 1] = f * aspect * j_ab / z, f * aspect * j_bb / z
    by_point[:, :, 2] = -(by_point[:, :, 0] * a[:, None] + by_point[:, :, 1] * b[:, None])
    by_lens = np.zeros((len(points), 2, 9))
    by_lens[:, 0, 0], by_lens[:, 1, 0] = lens_a, aspect * lens_b
    by_lens[:, 0, 1] = by_lens[:, 1, 2] = 1.0
    by_lens[:, 1, 3] = f * lens_b
    by_radial = [(a * power, b * power) for power in (r2, r2**2, r2**3)]
    by_tangential = [(2.0 * a * b, r2 + 2.0 * b * b), (r2 + 2.0 * a * a, 2.0 * a * b)]
    for i, (da, db) in enumerate([*by_radial[:2], *by_tangential, by_radial[2]]):
        by_lens[:, 0, 4 + i], by_lens[:, 1, 4 + i] = f * da, f * aspect * db
    return np.column_stack([f * lens_a + cx, f * aspect * lens_b + cy]), by_point, by_lens


def _matrices(axis: Float64, angles: Float64) -> Float64:
    # rotations about one axis, shape (n, 3, 3)
    return np.asarray(Rotation.from_rotvec(angles[:, None] * axis).as_matrix(), np.float64)


def _cross_matrices(vectors: Float64) -> Float64:
    # [v]× of each, shape (n, 3, 3)
    matrices = np.zeros((len(vectors), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[:, k, j], matrices[:, j, k] = vectors[:, i], -vectors[:, i]
    return matrices


# parameters that are free where the residuals ask for them
OPTIONAL = {
    **{name: AT[f"camera.{name}"] for name in ("aspect", "k2", "p1", "p2", "k3")},
    "tilt_scale": AT["tilt_axis.scale"],
    "rotary_scale": AT["rotary_axis.scale"],
}

_TRIM = 4.0  # robust standard deviations
_EVIDENCE = 4.0  # standard errors from nominal from which an optional parameter is freed
_LEAST_SCORED = 2.0  # standard deviations beforehand to standard errors, below which one stays held
_READINGS_OF_PRIOR = 10.0  # what the given angle error counts against the errors that the fit finds, in readings
_POLISH_STEPS = 30
_Loss = Literal["huber", "tukey"]
_ROBUST_STEPS: tuple[tuple[_Loss, int], ...] = (("huber", 12), ("huber", 40), ("tukey", 75))
_SETTLED = 1e-4  # square of the distance still to go, in standard errors
_FIRST_DAMPING, _MOST_DAMPING = 1e-6, 1e3
_MOST_SPREAD_PX = 3.0  # corners that scatter more are of another rig or board
_SMOOTH_POWERS = [(i, j) for i in range(4) for j in range(4 - i)]  # of x and y, over a view
_LEAST_SMOOTH = 20  # degrees of freedom from which on smooth residuals tell something
_LEAST_SPREAD_PX = 0.005
_MAD = 1.4826


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known beforehand, independently of each other."""

    mean: Float64  # of all parameters, shape (P,)
    sd: Float64  # their standard deviations; infinite where nothing is known, 0 where a parameter is held
    angle_sd: float  # of errors of the stage's readings [rad]


@dataclass(frozen=True, eq=False)
class Corners:
    seen: Sightings
    pixels: Float64


@dataclass(frozen=True, eq=False)
class JointFit:
    x: Float64  # all parameters, shape (P,), rotations about `origin`
    origin: Origin
    prior: Prior
    free: Index  # numbers of the G free ones
    covariance: Float64  # of these and of the errors of tilt and rotation [mm, rad, px], shape (G + 2K, G + 2K)
    angles: Float64  # errors of tilt and rotation of each view [rad], shape (K, 2)
    angle_sd: float  # standard deviation of such errors, from the prior and from what the fit finds [rad]
    noise: float  # standard deviation of a corner along one axis [px]
    common: float  # how many times larger errors are that neighbouring corners have in common; in the covariance
    residual: Float64  # found less predicted [px], shape (N, 2)
    inlier: Bool  # corners that count, shape (N,)
    extra: tuple[str, ...]  # optional parameters that are free

    @property
    def of_free(self) -> Float64:
        """Covariance of the free parameters, shape (G, G)."""
        return self.covariance[: len(self.free), : len(self.free)]


def fit_jointly(corners: Corners, start: tuple[Float64, Origin], prior: Prior, *, on_evidence: bool) -> JointFit:
    """Fit all that is not held, and with `on_evidence` those of OPTIONAL that matter.

    start: Parameters of shape (P,) and orientations
    Raises InputError: The corners are of another rig or board
    """
    (x, origin), angles, spread = start, np.zeros_like(corners.seen.readings), np.inf
    extra: tuple[str, ...] = ()
    free = _free(prior, extra)
    for loss, steps in _ROBUST_STEPS:
        x, angles, spread = _robust(corners, x, angles, origin, prior, free, loss, steps)
        # rotations start anew from where they are: slopes are exact there, and errors are those about the axes
        mean = prior.mean.copy()
        mean[CAMERA_ROTATION] -= x[CAMERA_ROTATION]
        origin, prior = origin.moved(x), Prior(mean, prior.sd, prior.angle_sd)
        x[CAMERA_ROTATION] = x[BOARD_ROTATION] = 0.0
    if spread > _MOST_SPREAD_PX:
        raise InputError(f"board: the corners do not fit the rig: half of them are over {spread / _MAD:.1f} px off")
    while True:
        fit = _polished(corners, x, angles, origin, prior, extra)
        rest = [name for name in OPTIONAL if name not in extra] if on_evidence else []
        scores = np.abs(_scores(fit, corners.seen, rest))
        if not rest or scores.max() < _EVIDENCE:
            return fit
        extra = (*extra, rest[int(np.argmax(scores))])
        x, angles = fit.x, fit.angles


def _free(prior: Prior, extra: tuple[str, ...]) -> Index:
    held = set(OPTIONAL.values()) - {OPTIONAL[name] for name in extra}
    return np.array([i for i in np.flatnonzero(prior.sd > 0.0) if i not in held], np.intp)


@dataclass(frozen=True, eq=False)
class _Problem:
    # of core.least_squares: free parameters, then the errors of the readings
    corners: Corners
    x: Float64
    origin: Origin
    free: Index
    weight: Float64
    correlated: Bool

    def residuals(self, x: Float64) -> Float64:
        there, angles = self.split(x)
        predicted, _, _ = predict(there, angles, self.origin, self.corners.seen, slopes=False)
        return (self.corners.pixels - predicted).ravel()

    def slopes(self, x: Float64) -> Float64:
        _, by_x, by_angles = predict(*self.split(x), self.origin, self.corners.seen)
        return _matrix(by_x[:, :, self.free], by_angles, self.corners.seen)

    def split(self, x: Float64) -> tuple[Float64, Float64]:
        there = self.x.copy()
        there[self.free] = x[: len(self.free)]
        return there, x[len(self.free) :].reshape(-1, 2)


def _matrix(by_x: Float64, by_angles: Float64, seen: Sightings) -> Float64:
    # derivatives by free parameters and all readings, shape (2N, G + 2K)
    count, size = len(seen.view), by_x.shape[2]
    matrix = np.zeros((count, 2, size + seen.readings.size))
    matrix[:, :, :size] = by_x
    for axis in range(2):
        matrix[np.arange(count), :, size + 2 * seen.view + axis] = by_angles[:, :, axis]
    return matrix.reshape(2 * count, -1)


def _robust(
    corners: Corners, x: Float64, angles: Float64, origin: Origin, prior: Prior, free: Index, loss: _Loss, steps: int
) -> tuple[Float64, Float64, float]:
    # parameters, errors of the readings, robust standard deviation of a corner
    rows = corners.pixels.size
    problem = _Problem(corners, x, origin, free, np.ones(rows), np.zeros(rows, np.bool_))
    known = np.isfinite(prior.sd)
    reach = np.where(known, 20.0 * prior.sd, 1.0)
    reach[BOARD_POSITION] = 20.0 * float(np.linalg.norm(corners.seen.half))
    reach = np.concatenate([reach[free], np.full(angles.size, 0.1)])
    limits = Limits(
        nominal=np.concatenate([np.where(known, prior.mean, x)[free], np.zeros(angles.size)]),
        reach=reach,
        step=reach,
        prior=np.concatenate([prior.sd[free], np.full(angles.size, prior.angle_sd)]),
        resolution=np.full(len(reach), np.inf),
    )
    start = np.concatenate([x[free], angles.ravel()])
    solution = solve(problem, start, limits, loss=loss, least_spread=_LEAST_SPREAD_PX, most_iterations=steps)
    return *problem.split(solution.x), solution.spread


def _polished(
    corners: Corners, x: Float64, angles: Float64, origin: Origin, prior: Prior, extra: tuple[str, ...]
) -> JointFit:
    # damped Gauss-Newton on the corners within the trim; noise and error of the readings are estimated at each step
    seen, free = corners.seen, _free(prior, extra)
    size = len(free)
    mean = np.concatenate([np.where(np.isfinite(prior.sd), prior.mean, 0.0)[free], np.zeros(angles.size)])
    precision = np.concatenate([1.0 / np.square(prior.sd[free]), np.zeros(angles.size)])
    problem = _Problem(corners, x, origin, free, np.ones(0), np.zeros(0, np.bool_))
    now, angle_sd, effective, damping = np.concatenate([x[free], angles.ravel()]), prior.angle_sd, float(len(mean)), 0.0
    step = 0
    while True:
        residual = problem.residuals(now).reshape(-1, 2)
        far = np.where(np.isfinite(residual), np.abs(residual), np.inf)
        inlier = far.max(axis=1) <= _TRIM * max(_MAD * float(np.median(far)), _LEAST_SPREAD_PX)
        rows = np.repeat(inlier, 2)
        variance = float(np.square(residual[inlier]).sum()) / max(rows.sum() - effective, 1.0)
        noise = max(float(np.sqrt(variance)), _LEAST_SPREAD_PX)
        common = _common_errors(seen, residual, inlier, effective)
        precision[size:] = 1.0 / angle_sd**2
        slopes = problem.slopes(now)[rows] / (noise * common)
        normal = slopes.T @ slopes + np.diag(precision)
        covariance = inverse(normal)
        pull = slopes.T @ residual.ravel()[rows] / (noise * common) - precision * (now - mean)
        if pull @ covariance @ pull <= _SETTLED or step == _POLISH_STEPS:
            fitted, angles = problem.split(now)
            return JointFit(
                fitted, origin, prior, free, covariance, angles, angle_sd, noise, common, residual, inlier, extra
            )

        def cost(there: Float64, rows: Bool = rows, unit: float = noise * common) -> float:
            off = problem.residuals(there)[rows] / unit
            return float(off @ off + precision @ np.square(there - mean))

        before, damping, step = cost(now), 0.1 * damping, step + 1
        while damping < _MOST_DAMPING:
            there = now + inverse(normal + damping * np.diag(np.diag(normal))) @ pull
            if cost(there) < before:
                now = there
                break
            damping = max(10.0 * damping, _FIRST_DAMPING)
        effective = len(now) - float(precision @ np.diag(covariance))
        found = float(np.square(now[size:]).sum() + np.diag(covariance)[size:].sum())
        known = _READINGS_OF_PRIOR * prior.angle_sd**2
        angle_sd = float(np.sqrt((known + found) / (_READINGS_OF_PRIOR + angles.size)))


def _common_errors(seen: Sightings, residual: Float64, inlier: Bool, effective: float) -> float:
    # how many times larger residuals are that vary smoothly over a view (cubic) than those that do not: a board
    # that is not flat, or a lens of another kind, moves neighbouring corners together. All parameters act smoothly
    smooth = rough = 0.0
    smooth_count, rough_count = -effective, 0.0
    for view in range(len(seen.readings)):
        mine = inlier & (seen.view == view)
        if mine.sum() <= len(_SMOOTH_POWERS):
            continue
        x, y = (seen.points[mine] / seen.half).T
        basis, _ = np.linalg.qr(np.column_stack([x**i * y**j for i, j in _SMOOTH_POWERS]))
        off = residual[mine]
        mine_smooth = float(np.square(basis.T @ off).sum())
        smooth, rough = smooth + mine_smooth, rough + float(np.square(off).sum()) - mine_smooth
        smooth_count += 2 * len(_SMOOTH_POWERS)
        rough_count += 2 * (len(off) - len(_SMOOTH_POWERS))
    if smooth_count < _LEAST_SMOOTH or rough_count <= 0.0:
        return 1.0
    return float(np.sqrt(max(1.0, smooth / smooth_count / max(rough / rough_count, 1e-12))))


def inverse(normal: Float64) -> Float64:
    """Of a symmetric positive definite matrix whose parameters have quite different units."""
    scale = np.sqrt(np.diag(normal))
    return np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)


def _scores(fit: JointFit, seen: Sightings, names: list[str]) -> Float64:
    # how many standard errors from nominal each held parameter would be found, were it free (Rao's score test)
    _, by_x, by_angles = predict(fit.x, fit.angles, fit.origin, seen)
    rows = np.repeat(fit.inlier, 2)
    unit = fit.noise * fit.common
    slopes = _matrix(by_x[:, :, fit.free], by_angles, seen)[rows] / unit
    held = by_x[:, :, [OPTIONAL[name] for name in names]].reshape(len(rows), -1)[rows] / unit
    prior = fit.prior.sd[[OPTIONAL[name] for name in names]]
    pull = held.T @ fit.residual.ravel()[rows] / unit
    cross = held.T @ slopes
    variance = np.square(held).sum(axis=0) - np.einsum("ij,jk,ik->i", cross, fit.covariance, cross)
    observable = np.sqrt(variance.clip(0.0)) * prior > _LEAST_SCORED
    return np.where(observable, pull / np.sqrt(np.where(observable, variance, 1.0)), 0.0)
