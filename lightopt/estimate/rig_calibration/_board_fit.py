"""Calibrate camera and stage axes from images of a board on the stage, and judge what that is good for.

Each view alone gives a homography and from it two poses of a plane, which mirror each other about the line of sight
(Oberkampf et al. 1996, doi:10.1006/cviu.1996.0037). The nominal rig turns each into a pose on the stage. The one that
explains all views best is the start.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from lightopt.config import READING_ERROR_DEG
from lightopt.core.arrays import Bool, Float64, read_only
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration import _joint_fit
from lightopt.estimate.rig_calibration._board import Board, BoardView
from lightopt.estimate.rig_calibration._deviations import NORMAL_95
from lightopt.estimate.rig_calibration._joint_fit import AT, NAMES, JointFit, Origin, Prior, Sightings, inverse, predict
from lightopt.scene import PinholeCamera, Stage

_TILTS_DEG, _ROTATIONS_DEG = range(-45, 46, 15), range(0, 360, 30)
_LEAST_SINE = 0.3  # of the angle at which the camera sees the board
# How well the nominal rig is known beforehand, as standard deviations. What images do not determine stays near nominal;
# against what they do determine this has no weight.
# Shares are of the length itself, of the image's width and of the camera's distance.
_FOCAL_SHARE, _PRINCIPAL_SHARE, _POSITION_SHARE = 0.05, 0.05, 0.05
_ROTATION_DEG, _TILT_AXIS_DEG, _TILT_AXIS_MM = 5.0, 1.0, 5.0
_LEAST_POINTS = 6
_MOST_VIEWS = 24  # whose poses are tried
_BEHIND_PX = 1e6  # error of a point that would be behind the camera
_OBSERVED = 0.5  # a parameter is unobservable whose error is more than this share of what it was beforehand
_LEAST_TILTED = np.radians(10.0)
_QUANTITIES = {  # and their parameters; the camera's position is in its own axes
    "focal length": "camera.focal_px",
    "distance": "camera.position_z",
    "camera position": "camera.position_x camera.position_y",
    "camera rotation": "camera.rotation_x camera.rotation_y camera.rotation_z",
    "principal point": "camera.principal_x_px camera.principal_y_px",
    "lens distortion": "camera.k1",
    "tilt axis direction": "tilt_axis.elevation",
    "tilt axis position": "tilt_axis.position_y tilt_axis.position_z",
    "board bow": "board.bow_xx board.bow_xy board.bow_yy",
}
_OF_LENS = ("focal length", "distance", "principal point", "lens distortion")
_FAULTY_SHARE, _FAULTY_RATIO = 0.5, 4.0  # outliers in a view; its median residual to that of all


def judge_postures(
    fit: JointFit, board: Board, taken: Float64, camera: PinholeCamera
) -> tuple[float, tuple[Posture, float] | None]:
    """Standard error of a pixel predicted for points of the board over all postures that show it [px], and the best.

    taken: Readings of the views [rad], shape (K, 2)
    """
    postures = [Posture(float(t), float(r)) for t, r in product(_TILTS_DEG, _ROTATIONS_DEG)]
    points = np.arange(board.columns * board.rows)
    outer = points.reshape(board.rows, board.columns)[[0, 0, -1, -1], [0, -1, -1, 0]]
    in_views = _joint_fit.sightings(board, [outer] * len(taken), taken)
    outline = predict(fit.x, fit.angles, fit.origin, in_views, slopes=False)[0]
    readings = np.radians([[p.elevation_deg, p.rotation_deg] for p in postures])
    seen = _joint_fit.sightings(board, [points] * len(postures), readings)
    pixels, by_x, by_angles = predict(fit.x, np.zeros_like(readings), fit.origin, seen)
    shape = (len(postures), 2 * len(points), -1)
    inside = np.all((pixels >= 0.0) & (pixels <= [camera.width, camera.height]), axis=1).reshape(len(postures), -1)
    facing = _facing(pixels.reshape(*inside.shape, 2)[:, outer], outline.reshape(-1, 4, 2))
    shown = np.flatnonzero(facing & inside.any(axis=1))
    if not len(shown):
        return float("nan"), None
    rows = np.repeat(inside, 2, axis=1)[shown, :, None]  # points outside of the image do not count
    by_free = by_x[:, :, fit.free].reshape(shape)[shown] * rows
    by_angles = by_angles.reshape(*shape[:2], 2)[shown] * rows
    spread = np.einsum("kni,knj->ij", by_free, by_free) / inside[shown].sum()
    now = float(np.sqrt(np.sum(fit.of_free * spread)))
    information = inverse(fit.of_free)
    unit = fit.noise * fit.common

    def gain(number: int, slopes: Float64, own: Float64) -> tuple[Posture, float]:
        inner = own.T @ own + np.eye(2) / fit.angle_sd**2  # the new readings have errors, too
        cross = own.T @ slopes
        gained = slopes.T @ slopes - cross.T @ np.linalg.solve(inner, cross)
        rms = float(np.sqrt(np.sum(inverse(information + gained) * spread)))
        return postures[number], rms

    gains = map(gain, shown.tolist(), by_free / unit, by_angles / unit)
    return now, min(gains, key=lambda one: one[1])


def _facing(outline: Float64, in_views: Float64) -> Bool:
    # postures at which the camera sees the face of the board that it saw in the views, not at a grazing angle;
    # outlines are pixels of the board's four corners, shape (k, 4, 2)
    def areas(corners: Float64) -> Float64:
        a, b = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
        return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

    found, known = areas(outline), areas(in_views)
    sign = np.sign(np.median(known))
    return sign * found >= _LEAST_SINE * max(np.max(sign * found), np.max(sign * known))


def nominal_prior(board: Board, camera: PinholeCamera, stage: Stage, angle_error_deg: float) -> tuple[Prior, Origin]:
    """What is known beforehand, and the nominal orientations, in the world moved so that the rotary axis is Z."""
    aside = np.array([stage.pivot[0], stage.pivot[1], 0.0])
    point, axis = stage.tilt_axis
    mean, sd = np.zeros(len(NAMES)), np.full(len(NAMES), np.inf)
    reach = _POSITION_SHARE * _distance(camera, stage)
    focal = camera.image_distance / camera.pixel_size
    lens = camera.distortion
    half = float(np.abs(board.points).max())
    for names, value, spread in [
        ("camera.rotation_x camera.rotation_y camera.rotation_z", 0.0, np.radians(_ROTATION_DEG)),
        ("camera.position_x camera.position_y camera.position_z", camera.position - aside, reach),
        ("camera.focal_px", focal, _FOCAL_SHARE * focal),
        ("camera.principal_x_px camera.principal_y_px", camera.axis_px, _PRINCIPAL_SHARE * camera.width),
        ("camera.aspect", camera.aspect, 0.01),
        ("camera.k1 camera.k2 camera.k3", (lens.k1, lens.k2, lens.k3), (0.5, 5.0, 50.0)),
        ("camera.p1 camera.p2", (lens.p1, lens.p2), 0.05),
        ("tilt_axis.elevation", np.arcsin(axis[2]), np.radians(_TILT_AXIS_DEG)),
        ("tilt_axis.position_y tilt_axis.position_z", (point - aside)[1:], _TILT_AXIS_MM),
        ("tilt_axis.scale rotary_axis.scale", (stage.tilt_scale, stage.rotary_scale), 0.005),
        ("board.position_z", board.height, board.height_error),
        ("board.scale", 0.0, board.pitch_error),
        ("board.pitch_ratio", 0.0, 0.01),
        ("board.bow_xx board.bow_xy board.bow_yy", 0.0, 0.02 * half),
    ]:
        at = [AT[name] for name in names.split()]
        mean[at], sd[at] = value, spread
    origin = Origin(np.array([camera.right, -camera.up, camera.forward]), np.eye(3))
    return Prior(mean, sd, float(np.radians(angle_error_deg))), origin


def filed_covariance(camera: PinholeCamera, stage: Stage) -> tuple[tuple[str, ...], Float64]:
    """Names of the values of camera and stage as `BoardFit.names`, and how well a rig file alone knows them."""
    focal = camera.image_distance / camera.pixel_size
    errors = {
        **{f"camera.rotation_{axis}": _ROTATION_DEG for axis in "xyz"},
        **{f"camera.position_{axis}": _POSITION_SHARE * _distance(camera, stage) for axis in "xyz"},
        "camera.focal_px": _FOCAL_SHARE * focal,
        **{f"camera.principal_{axis}_px": _PRINCIPAL_SHARE * camera.width for axis in "xy"},
        "tilt_axis.elevation": _TILT_AXIS_DEG,
        **{f"tilt_axis.position_{axis}": _TILT_AXIS_MM for axis in "yz"},
    }
    return tuple(errors), np.diag(np.square(list(errors.values())))


def _distance(camera: PinholeCamera, stage: Stage) -> float:
    return float(np.linalg.norm(camera.position - stage.pivot))


def start_from_views(x: Float64, origin: Origin, seen: Sightings, pixels: Float64) -> tuple[Float64, Origin]:
    """Parameters and orientations with the board in its place.

    x, origin: Nominal; those of the board are not used
    pixels: Shape (N, 2)
    Raises InputError: No view has enough points that are not on a line
    """
    f, cx, cy, aspect = x[AT["camera.focal_px"] : AT["camera.k1"]]
    rays = (pixels - [cx, cy]) / [f, f * aspect]
    views = len(seen.readings)
    best: tuple[float, Float64, Origin] | None = None
    for view in np.unique(np.linspace(0, views - 1, min(views, _MOST_VIEWS)).astype(int)):
        mine = seen.view == view
        flat = seen.points[mine] - seen.points[mine].mean(axis=0) if mine.any() else np.zeros((0, 2))
        if len(flat) < _LEAST_POINTS or np.linalg.matrix_rank(flat) < 2:
            continue
        for turned, shift in _plane_poses(seen.points[mine], rays[mine]):
            lift, at_zero = _joint_fit.stage_of(x).transform(Posture(*np.degrees(seen.readings[view])))
            world = origin.camera.T
            placed = Origin(origin.camera, lift.T @ world @ turned)
            there = x.copy()
            there[_joint_fit.BOARD_POSITION] = lift.T @ (world @ shift + x[_joint_fit.CAMERA_POSITION] - at_zero)
            predicted, _, _ = predict(there, np.zeros((views, 2)), placed, seen, slopes=False)
            error = np.nan_to_num(pixels - predicted, nan=_BEHIND_PX)
            # the camera's direction shifts a view as a whole
            for k in np.unique(seen.view):
                error[seen.view == k] -= np.median(error[seen.view == k], axis=0)
            cost = float(np.median(np.linalg.norm(error, axis=1)))
            if best is None or cost < best[0]:
                best = cost, there, placed
    if best is None:
        raise InputError(f"board: no image shows {_LEAST_POINTS} points that are not on a line")
    return best[1], best[2]


def _plane_poses(points: Float64, rays: Float64) -> list[tuple[Float64, Float64]]:
    # rotations and translations of the board's frame into the camera's
    rows = np.zeros((2 * len(points), 9))
    centre, size = rays.mean(axis=0), max(float(rays.std()), 1e-12)
    unit = float(points.std())
    u, v = ((rays - centre) / size).T
    flat = np.column_stack([points / unit, np.ones(len(points))])
    rows[::2, :3], rows[::2, 6:] = flat, -u[:, None] * flat
    rows[1::2, 3:6], rows[1::2, 6:] = flat, -v[:, None] * flat
    h = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    to_rays = np.array([[size, 0.0, centre[0]], [0.0, size, centre[1]], [0.0, 0.0, 1.0]])
    h = to_rays @ h @ np.diag([1.0 / unit, 1.0 / unit, 1.0])
    h /= np.copysign(0.5 * (np.linalg.norm(h[:, 0]) + np.linalg.norm(h[:, 1])), h[2, 2])
    axes, shift = h[:, :2], h[:, 2]
    sight = shift / np.linalg.norm(shift)
    poses: list[tuple[Float64, Float64]] = []
    for a in (axes, axes - 2.0 * np.outer(sight, sight @ axes)):
        left, _, right = np.linalg.svd(a, full_matrices=False)
        flat_axes = left @ right  # nearest orthonormal pair
        poses.append((np.column_stack([flat_axes, np.cross(flat_axes[:, 0], flat_axes[:, 1])]), shift))
    return poses


@dataclass(frozen=True)
class ViewResidual:
    name: str
    posture: Posture
    corners: int
    median: float  # distance of found from predicted corners [px]
    rms: float  # the same of the corners that count [px]
    outliers: int  # corners that do not count, as they are more than 4 robust standard deviations off
    faulty: bool  # whether the view as a whole is wrong
    pixels: Float64 = field(repr=False)  # where the corners were found [px], shape (corners, 2)
    offsets: Float64 = field(repr=False)  # found less predicted, likewise


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardFit:
    """Camera and stage as images of a board show them; frame of the calibrated world.

    camera, stage: World frame: Z is the rotary axis at tilt reading 0, X the tilt axis projected onto the plane normal
        to Z, origin at the height that the board's thickness gives
    names: Free parameters, in the order of `values` and `covariance`. Rotations are about the axes of the camera (x
        right, y down, z forward) and of the board's frame at posture (0, 0) about the world's
    values: [mm, deg, px], shape (G,); rotations are 0, as they are of the small deviations from this result
    board_rotation, board_position: Board to part frame, of shapes (3, 3) and (3,) [mm]
    common_errors: How many times larger the errors are that neighbouring corners have in common: about 1 for a flat
        board and a lens as fitted. Intervals are as many times wider
    next_posture: Whose view would lower `predicted_rms` most, and to what; None where no posture shows the board
    """

    camera: PinholeCamera
    stage: Stage
    names: tuple[str, ...]
    values: Float64 = field(repr=False)
    covariance: Float64 = field(repr=False)  # [mm, deg, px], shape (G, G)
    board_rotation: Float64 = field(repr=False)
    board_position: Float64 = field(repr=False)
    freed: tuple[str, ...]  # optional parameters that are free, on evidence
    noise: float  # standard deviation of a corner along one axis [px]
    common_errors: float
    angle_error_deg: float  # standard deviation of the errors of the stage's readings
    residuals: tuple[ViewResidual, ...] = field(repr=False)  # of each view
    unobservable: tuple[str, ...]  # what the images do not determine; it is near nominal
    predicted_rms: float  # standard error of a pixel predicted for a point of the board, over all postures [px]
    next_posture: tuple[Posture, float] | None

    @property
    def intervals(self) -> Mapping[str, tuple[float, float]]:
        """95 % interval of each free parameter [mm, deg, px]."""
        half = NORMAL_95 * np.sqrt(np.diag(self.covariance))
        ends = zip(self.values - half, self.values + half, strict=True)
        return {name: (float(low), float(high)) for name, (low, high) in zip(self.names, ends, strict=True)}

    @property
    def faulty(self) -> tuple[str, ...]:
        """Names of the views that do not fit as a whole: look at their images, or leave them out."""
        return tuple(view.name for view in self.residuals if view.faulty)


def fit_board(
    views: Sequence[BoardView],
    board: Board,
    *,
    camera: PinholeCamera,
    stage: Stage | None = None,
    on_evidence: bool = True,
    angle_error_deg: float = READING_ERROR_DEG,
) -> BoardFit:
    """Fit camera pose, focal length, principal point, k1, tilt axis, and the board's pose and bow to its corners.

    The board may lie anywhere on the stage, but does not move on it. Corners that are off count no more; views that
    are wrong as a whole are named.

    views: At least one; one at tilt 0 only, or rotations only, leave most unobservable
    camera, stage: Nominal, a few degrees and millimetres from the truth, world frame; the tilt axis in its X-Z plane
    on_evidence: Whether those of aspect, k2, p1, p2, k3, tilt_scale and rotary_scale are fitted, too, that the
        residuals ask for, given that the tilt changes
    angle_error_deg: Standard error of a reading of the stage
    Raises InputError: The corners do not fit the rig, or are too few to start from
    """
    corners = _corners(views, board)
    prior, origin = nominal_prior(board, camera, stage or Stage(), angle_error_deg)
    start = start_from_views(np.where(np.isfinite(prior.mean), prior.mean, 0.0), origin, corners.seen, corners.pixels)
    start[0][_joint_fit.BOARD_POSITION.stop - 1] = board.height
    tilted = bool(np.ptp(corners.seen.readings[:, 0]) >= _LEAST_TILTED)
    fit = _joint_fit.fit_jointly(corners, start, prior, on_evidence=on_evidence and tilted)
    fitted_camera, fitted_stage = _rig(fit, camera)
    predicted_rms, gain = judge_postures(fit, board, corners.seen.readings, fitted_camera)
    unit = np.array([np.degrees(1.0) if "rotation" in NAMES[i] or "elevation" in NAMES[i] else 1.0 for i in fit.free])
    return BoardFit(
        camera=fitted_camera,
        stage=fitted_stage,
        names=tuple(NAMES[i] for i in fit.free),
        values=read_only(fit.x[fit.free] * unit),
        covariance=read_only(fit.of_free * np.outer(unit, unit)),
        board_rotation=read_only(fit.origin.moved(fit.x).board),
        board_position=read_only(fit.x[_joint_fit.BOARD_POSITION]),
        freed=fit.extra,
        noise=fit.noise,
        common_errors=fit.common,
        angle_error_deg=float(np.degrees(fit.angle_sd)),
        residuals=_residuals(views, fit, corners.seen),
        unobservable=_unobservable(fit, tilted),
        predicted_rms=predicted_rms,
        next_posture=gain,
    )


def _corners(views: Sequence[BoardView], board: Board) -> _joint_fit.Corners:
    count = board.columns * board.rows
    for view in views:
        if len(view.ids) and not 0 <= view.ids.min() <= view.ids.max() < count:
            raise InputError(f"{view.name}: points {view.ids.min()} to {view.ids.max()}, expected 0 to {count - 1}")
    if not any(len(view.ids) for view in views):
        raise InputError("no image shows a point of the board")
    readings = np.radians([[view.posture.elevation_deg, view.posture.rotation_deg] for view in views])
    seen = _joint_fit.sightings(board, [view.ids for view in views], readings)
    return _joint_fit.Corners(seen, np.concatenate([view.pixels for view in views]))


def _rig(fit: JointFit, nominal: PinholeCamera) -> tuple[PinholeCamera, Stage]:
    x = fit.x
    right, down, forward = fit.origin.moved(x).camera
    k1, k2, p1, p2, k3 = (float(k) for k in x[_joint_fit.LENS])
    camera = replace(
        nominal,
        position=x[_joint_fit.CAMERA_POSITION].copy(),
        right=right,
        up=-down,
        forward=forward,
        image_distance=float(x[AT["camera.focal_px"]]) * nominal.pixel_size,
        principal_point=(float(x[AT["camera.principal_x_px"]]), float(x[AT["camera.principal_y_px"]])),
        aspect=float(x[AT["camera.aspect"]]),
        distortion=replace(nominal.distortion, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3),
    )
    return camera, _joint_fit.stage_of(x)


def _residuals(views: Sequence[BoardView], fit: JointFit, seen: Sightings) -> tuple[ViewResidual, ...]:
    distance = np.linalg.norm(fit.residual, axis=1)
    most = _FAULTY_RATIO * float(np.median(distance))

    def one(view: BoardView, mine: Bool) -> ViewResidual:
        inliers, count = distance[mine & fit.inlier], len(view.ids)
        median = float(np.median(distance[mine])) if count else 0.0
        rms = float(np.sqrt(np.mean(np.square(inliers)))) if len(inliers) else 0.0
        outliers = count - len(inliers)
        faulty = outliers > _FAULTY_SHARE * count or median > most
        offsets = fit.residual[mine]
        return ViewResidual(view.name, view.posture, count, median, rms, outliers, faulty, view.pixels, offsets)

    return tuple(one(view, seen.view == number) for number, view in enumerate(views))


def _unobservable(fit: JointFit, tilted: bool) -> tuple[str, ...]:
    # quantities whose error is not much less than it was beforehand. Where the tilt hardly changes, errors of the
    # board's shape pass for another lens, whatever the covariance is
    axes = np.eye(len(NAMES))
    axes[_joint_fit.CAMERA_POSITION, _joint_fit.CAMERA_POSITION] = fit.origin.camera
    after = np.sqrt(np.einsum("ij,jk,ik->i", axes[:, fit.free], fit.of_free, axes[:, fit.free]))
    weak = {NAMES[i] for i in fit.free if after[i] > _OBSERVED * fit.prior.sd[i]}
    quantities = {**_QUANTITIES, **{name.replace("_", " "): NAMES[_joint_fit.OPTIONAL[name]] for name in fit.extra}}
    return tuple(
        name
        for name, parameters in quantities.items()
        if not weak.isdisjoint(parameters.split()) or (not tilted and name in _OF_LENS)
    )
