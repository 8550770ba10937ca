"""Calibrate camera and stage axes from images of a board on the stage."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lightopt.core.arrays import Float64, read_only
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._board import Board, BoardView
from lightopt.estimate.rig_calibration._board_model import (
    AT,
    BOARD_POSITION,
    CAMERA_POSITION,
    LENS,
    NAMES,
    Sightings,
    sightings,
    stage_of,
)
from lightopt.estimate.rig_calibration._board_start import start_from_views
from lightopt.estimate.rig_calibration._joint_fit import OPTIONAL, Corners, JointFit, fit_jointly
from lightopt.estimate.rig_calibration._measured import NORMAL_95
from lightopt.estimate.rig_calibration._nominal import nominal_prior
from lightopt.estimate.rig_calibration._postures import PostureGain, judge_postures
from lightopt.scene import PinholeCamera, Stage

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


@dataclass(frozen=True)
class ViewResidual:
    """How well one view fits.

    pixels, offsets: Where the corners were found, and found less predicted [px], shape (corners, 2)
    """

    name: str
    posture: Posture
    corners: int
    median: float  # distance of found from predicted corners [px]
    rms: float  # the same of the corners that count [px]
    outliers: int  # corners that do not count, as they are more than 4 robust standard deviations off
    faulty: bool  # whether the view as a whole is wrong
    pixels: Float64 = field(repr=False)
    offsets: Float64 = field(repr=False)


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
    freed: tuple[str, ...]  # optional parameters that are free, on request or on evidence
    noise: float  # standard deviation of a corner along one axis [px]
    common_errors: float
    angle_error_deg: float  # standard deviation of the errors of the stage's readings
    residuals: tuple[ViewResidual, ...] = field(repr=False)  # of each view
    unobservable: tuple[str, ...]  # what the images do not determine; it is near nominal
    predicted_rms: float  # standard error of a pixel predicted for a point of the board, over all postures [px]
    next_posture: PostureGain | None

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
    free: Collection[str] = (),
    on_evidence: bool = True,
    angle_error_deg: float = 0.02,
    postures: Sequence[Posture] | None = None,
) -> BoardFit:
    """Fit camera pose, focal length, principal point, k1, tilt axis, and the board's pose and bow to its corners.

    The board may lie anywhere on the stage, but does not move on it. Corners that are off count no more; views that
    are wrong as a whole are named.

    views: At least one; one at tilt 0 only, or rotations only, leave most unobservable
    camera, stage: Nominal, a few degrees and millimetres from the truth, world frame; the tilt axis in its X-Z plane
    free: Further parameters to fit, of aspect, k2, p1, p2, k3, tilt_scale, rotary_scale
    on_evidence: Whether those are fitted, too, that the residuals ask for, given that the tilt changes
    angle_error_deg: Standard error of a reading of the stage
    postures: Where pixels are predicted, and those that could be taken next; tilts to ±45° by default
    Raises InputError: The corners do not fit the rig, or are too few to start from
    """
    wrong = [name for name in free if name not in OPTIONAL]
    if wrong:
        raise InputError(f"{', '.join(wrong)}: cannot be fitted; expected some of {', '.join(OPTIONAL)}")
    corners = _corners(views, board)
    prior, origin = nominal_prior(board, camera, stage or Stage(), angle_error_deg)
    start = start_from_views(np.where(np.isfinite(prior.mean), prior.mean, 0.0), origin, corners.seen, corners.pixels)
    start[0][BOARD_POSITION.stop - 1] = board.height
    tilted = bool(np.ptp(corners.seen.readings[:, 0]) >= _LEAST_TILTED)
    fit = fit_jointly(corners, start, prior, extra=tuple(free), on_evidence=on_evidence and tilted)
    fitted_camera, fitted_stage = _rig(fit, camera)
    predicted_rms, gain = judge_postures(fit, board, corners.seen.readings, fitted_camera, postures)
    unit = np.array([np.degrees(1.0) if "rotation" in NAMES[i] or "elevation" in NAMES[i] else 1.0 for i in fit.free])
    return BoardFit(
        camera=fitted_camera,
        stage=fitted_stage,
        names=tuple(NAMES[i] for i in fit.free),
        values=read_only(fit.x[fit.free] * unit),
        covariance=read_only(fit.of_free * np.outer(unit, unit)),
        board_rotation=read_only(fit.origin.moved(fit.x).board),
        board_position=read_only(fit.x[BOARD_POSITION]),
        freed=fit.extra,
        noise=fit.noise,
        common_errors=fit.common,
        angle_error_deg=float(np.degrees(fit.angle_sd)),
        residuals=_residuals(views, fit, corners.seen),
        unobservable=_unobservable(fit, tilted),
        predicted_rms=predicted_rms,
        next_posture=gain,
    )


def _corners(views: Sequence[BoardView], board: Board) -> Corners:
    count = board.columns * board.rows
    for view in views:
        if len(view.ids) and not 0 <= view.ids.min() <= view.ids.max() < count:
            raise InputError(
                f"{view.name}: points {view.ids.min()} to {view.ids.max()}, expected 0 to {count - 1} on a board of "
                f"{board.columns} × {board.rows}"
            )
    if not any(len(view.ids) for view in views):
        raise InputError("no image shows a point of the board")
    readings = np.radians([[view.posture.elevation_deg, view.posture.rotation_deg] for view in views])
    seen = sightings(board, [view.ids for view in views], readings)
    return Corners(seen, np.concatenate([view.pixels for view in views]))


def _rig(fit: JointFit, nominal: PinholeCamera) -> tuple[PinholeCamera, Stage]:
    x = fit.x
    right, down, forward = fit.origin.moved(x).camera
    k1, k2, p1, p2, k3 = (float(k) for k in x[LENS])
    camera = replace(
        nominal,
        position=x[CAMERA_POSITION].copy(),
        right=right,
        up=-down,
        forward=forward,
        image_distance=float(x[AT["camera.focal_px"]]) * nominal.pixel_size,
        principal_point=(float(x[AT["camera.principal_x_px"]]), float(x[AT["camera.principal_y_px"]])),
        aspect=float(x[AT["camera.aspect"]]),
        distortion=replace(nominal.distortion, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3),
    )
    return camera, stage_of(x)


def _residuals(views: Sequence[BoardView], fit: JointFit, seen: Sightings) -> tuple[ViewResidual, ...]:
    distance = np.linalg.norm(fit.residual, axis=1)
    most = _FAULTY_RATIO * float(np.median(distance))
    found: list[ViewResidual] = []
    for number, view in enumerate(views):
        mine = seen.view == number
        inliers, count = distance[mine & fit.inlier], len(view.ids)
        median = float(np.median(distance[mine])) if count else 0.0
        rms = float(np.sqrt(np.mean(np.square(inliers)))) if len(inliers) else 0.0
        outliers = count - len(inliers)
        faulty = outliers > _FAULTY_SHARE * count or median > most
        found.append(
            ViewResidual(view.name, view.posture, count, median, rms, outliers, faulty, view.pixels, fit.residual[mine])
        )
    return tuple(found)


def _unobservable(fit: JointFit, tilted: bool) -> tuple[str, ...]:
    # quantities whose error is not much less than it was beforehand. Where the tilt hardly changes, errors of the
    # board's shape pass for another lens, whatever the covariance is
    axes = np.eye(len(NAMES))
    axes[CAMERA_POSITION, CAMERA_POSITION] = fit.origin.camera
    after = np.sqrt(np.einsum("ij,jk,ik->i", axes[:, fit.free], fit.of_free, axes[:, fit.free]))
    weak = {NAMES[i] for i in fit.free if after[i] > _OBSERVED * fit.prior.sd[i]}
    quantities = {**_QUANTITIES, **{name.replace("_", " "): NAMES[OPTIONAL[name]] for name in fit.extra}}
    return tuple(
        name
        for name, parameters in quantities.items()
        if not weak.isdisjoint(parameters.split()) or (not tilted and name in _OF_LENS)
    )
