"""Calibrate a rig from the image sets of a calibration folder: camera and stage, panels, their light, the sensor."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.config import BoardTargetConfig, PartConfig, RigConfig, TargetsConfig, load_part, load_targets
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import rotation_from_vector
from lightopt.estimate.registration import Observation, read_observations
from lightopt.estimate.rig_calibration._ball_fit import BallFit, BallView, fit_ball
from lightopt.estimate.rig_calibration._ball_images import measure_ball
from lightopt.estimate.rig_calibration._board_fit import BoardFit, fit_board
from lightopt.estimate.rig_calibration._board_images import BoardImage, find_corners
from lightopt.estimate.rig_calibration._charuco import CharucoBoard
from lightopt.estimate.rig_calibration._corner_lists import read_corners
from lightopt.estimate.rig_calibration._photon_transfer import FramePair, PhotonTransfer, photon_transfer
from lightopt.estimate.rig_calibration._plan import BALL, BOARD, PLATE, RIG_NAME, SENSOR, TARGETS_NAME
from lightopt.estimate.rig_calibration._plate_fit import Plate, PlateFit, fit_plate, plate_cells
from lightopt.images import dark_name, read_image_set, read_png
from lightopt.lights import PanelLight
from lightopt.scene import PinholeCamera, Stage, build_camera, build_lights, build_sensor, build_stage

CORNERS_NAME = "board.json"
"""Corners of the board that another program found, in place of its image set."""

# covariance of a panel's parameters where only the rig file has them [mm], [rad], [mm]
_FILED = np.diag(np.square([3.0, 3.0, 3.0, 0.04, 0.04, 0.04, 0.1, 0.1]))

CELL_SHARE = 1 / 40  # side of a plate's cell, of the image's width


@dataclass(frozen=True, kw_only=True, eq=False)
class RigCalibration:
    """What the image sets of a calibration folder show of a rig.

    rig: As it was filed
    folder: With the image sets and targets.yaml
    board, ball, plate, sensor: None where there is no such image set
    camera, stage, lights: World frame, measured where they were, else as filed
    filed: The lights as filed
    """

    rig: RigConfig
    folder: Path
    board: BoardFit | None
    ball: BallFit | None
    plate: PlateFit | None
    sensor: PhotonTransfer | None
    camera: PinholeCamera
    stage: Stage
    lights: tuple[PanelLight, ...]
    filed: tuple[PanelLight, ...]
    warnings: tuple[str, ...]

    @property
    def unobservable(self) -> tuple[str, ...]:
        """What the images do not show, although they are there."""
        return tuple(name for fit in (self.board, self.ball) if fit is not None for name in fit.unobservable)


def calibrate_rig(rig: RigConfig, folder: Path, *, run: RunContext | None = None) -> RigCalibration:
    """Calibrate what the image sets below a calibration folder allow.

    Raises InputError: No image set, targets that do not fit the images, or a target of which too little is seen
    """
    run = run or RunContext()
    if rig.stage.pivot_mm[:2] != (0.0, 0.0):
        raise InputError(
            f"{rig.source.at('stage', 'pivot_mm')}: a calibration puts the world's origin on the rotary axis; expected "
            f"[0, 0, z], found {list(rig.stage.pivot_mm)}"
        )
    if rig.source.path.resolve().parent == folder.resolve() and rig.source.path.name == RIG_NAME:
        raise InputError(f"{rig.source.path}: this is the result; give the rig file that was captured with")
    targets = load_targets(folder / TARGETS_NAME)
    sets = {name for name in (BOARD, BALL, PLATE, *SENSOR) if (folder / name).is_dir()}
    if (folder / CORNERS_NAME).is_file():
        sets.add(BOARD)
    if not sets:
        raise InputError(
            f"{folder}: no image set of a calibration; expected some of {', '.join((BOARD, BALL, PLATE, *SENSOR))}; "
            "lightopt calibrate --plan writes how to capture them"
        )
    camera, stage, filed = build_camera(rig), build_stage(rig), build_lights(rig)
    lights = filed
    board: BoardFit | None = None
    ball: BallFit | None = None
    plate: PlateFit | None = None
    sensor: PhotonTransfer | None = None
    warnings: list[str] = []
    black = rig.camera.sensor.black_level
    if all(name in sets for name in SENSOR):
        sensor = _sensor(rig, folder)
        black = sensor.black_level.value
    if BOARD in sets and (target := targets.board) is not None:
        board = _board(rig, folder, targets, target, camera, stage, warnings, run)
        camera, stage = board.camera, board.stage
    if BALL in sets and targets.ball is not None:
        views = _ball_views(rig, folder, camera, targets.ball.radius_mm, warnings, run)
        ball = fit_ball(
            views,
            lights=lights,
            camera=camera,
            stage=stage,
            radius=targets.ball.radius_mm,
            radius_error=targets.ball.radius_error_mm,
            size_error=targets.panel_size_error_mm,
            rig_deviations=() if board is None else rig_deviations(board),
        )
        lights = ball.lights
    if PLATE in sets and targets.plate is not None:
        x, y = targets.plate.size_mm
        flat = Plate(
            corner=np.array([-0.5 * x, -0.5 * y, targets.plate.height_mm]),
            side_x=np.array([x, 0.0, 0.0]),
            side_y=np.array([0.0, y, 0.0]),
        )
        if ball is None:
            warnings.append("the plate was fitted to panels as the rig file has them: there is no image set of a ball")
        known = np.kron(np.eye(len(lights)), _FILED) if ball is None else ball.panels_covariance
        plate = _plate(rig, folder, flat, camera, stage, lights, known, black, warnings, run)
        lights = plate.lights
    return RigCalibration(
        rig=rig,
        folder=folder,
        board=board,
        ball=ball,
        plate=plate,
        sensor=sensor,
        camera=camera,
        stage=stage,
        lights=lights,
        filed=filed,
        warnings=tuple(warnings),
    )


def _part_of(folder: Path, name: str) -> PartConfig:
    return load_part(folder / f"{name}.yaml")


def _observations(rig: RigConfig, folder: Path, name: str, run: RunContext) -> tuple[Observation, ...]:
    return read_observations(read_image_set(folder / name), rig, _part_of(folder, name), threads=run.threads)


def _board(
    rig: RigConfig,
    folder: Path,
    targets: TargetsConfig,
    target: BoardTargetConfig,
    camera: PinholeCamera,
    stage: Stage,
    warnings: list[str],
    run: RunContext,
) -> BoardFit:
    printed = CharucoBoard(
        squares=target.squares,
        square=target.square_mm,
        marker=target.marker_mm,
        dictionary=target.dictionary,
        legacy_pattern=target.legacy_pattern,
    )
    grid = printed.grid(
        pitch=target.square_mm,
        pitch_error=target.square_error,
        height=target.height_mm,
        height_error=target.height_error_mm,
    )
    if (folder / CORNERS_NAME).is_file():
        views = read_corners(folder / CORNERS_NAME)
    else:
        images = _board_images(rig, folder, run)
        views, problems = find_corners(images, printed, full_scale=float(build_sensor(rig.camera).saturated_from))
        warnings += [f"board {one.name}: {one.message}" for one in problems]
    fit = fit_board(views, grid, camera=camera, stage=stage, angle_error_deg=targets.reading_error_deg)
    warnings += [f"board {name}: this view does not fit the others; look at its image" for name in fit.faulty]
    return fit


def _board_images(rig: RigConfig, folder: Path, run: RunContext) -> list[BoardImage]:
    observations = _observations(rig, folder, BOARD, run)
    return [
        BoardImage(
            str(posture),
            posture,
            np.mean([o.levels for o in observations if o.posture == posture], axis=0, dtype=np.float64),
        )
        for posture in dict.fromkeys(o.posture for o in observations)
    ]


def rig_deviations(board: BoardFit) -> list[tuple[PinholeCamera, Stage]]:
    """Camera and stage, displaced by one standard deviation along each independent direction of their covariance."""
    mine = [i for i, name in enumerate(board.names) if name.startswith(("camera.", "tilt_axis.", "rotary_axis."))]
    values, vectors = np.linalg.eigh(board.covariance[np.ix_(mine, mine)])
    names = [board.names[i] for i in mine]
    return [
        _displaced(board, dict(zip(names, (np.sqrt(max(value, 0.0)) * vector).tolist(), strict=True)))
        for value, vector in zip(values, vectors.T, strict=True)
    ]


def _displaced(board: BoardFit, by: dict[str, float]) -> tuple[PinholeCamera, Stage]:
    # by deviations as `BoardFit.covariance` has them: [mm, deg, px], rotations about the camera's own axes
    camera, stage = board.camera, board.stage

    def of(name: str) -> float:
        return by.get(name, 0.0)

    axes = np.stack([camera.right, -camera.up, camera.forward], axis=1)
    turn = np.radians([of(f"camera.rotation_{axis}") for axis in "xyz"])
    right, down, forward = (axes @ rotation_from_vector(-turn)).T
    focal = camera.image_distance / camera.pixel_size + of("camera.focal_px")
    column, row = camera.axis_px
    lens = camera.distortion
    moved = replace(
        camera,
        position=camera.position + [of(f"camera.position_{axis}") for axis in "xyz"],
        right=right,
        up=-down,
        forward=forward,
        image_distance=focal * camera.pixel_size,
        principal_point=(column + of("camera.principal_x_px"), row + of("camera.principal_y_px")),
        aspect=camera.aspect + of("camera.aspect"),
        distortion=replace(lens, **{k: getattr(lens, k) + of(f"camera.{k}") for k in ("k1", "k2", "p1", "p2", "k3")}),
    )
    point, direction = stage.tilt_axis
    tilt = np.arcsin(direction[2]) + np.radians(of("tilt_axis.elevation"))
    axis = replace(
        stage,
        tilt_point=point + np.array([0.0, of("tilt_axis.position_y"), of("tilt_axis.position_z")]),
        tilt_direction=np.array([np.cos(tilt), 0.0, np.sin(tilt)]),
        tilt_scale=stage.tilt_scale + of("tilt_axis.scale"),
        rotary_scale=stage.rotary_scale + of("rotary_axis.scale"),
    )
    return moved, axis


def _ball_views(
    rig: RigConfig, folder: Path, camera: PinholeCamera, radius: float, warnings: list[str], run: RunContext
) -> list[BallView]:
    observations = _observations(rig, folder, BALL, run)
    distance = float(np.linalg.norm(camera.position)) - radius
    radius_px = camera.image_distance / camera.pixel_size * radius / distance
    sensor = build_sensor(rig.camera)
    views: list[BallView] = []
    problems: list[str] = []
    for posture in dict.fromkeys(o.posture for o in observations):
        mine = sorted((o for o in observations if o.posture == posture), key=lambda o: o.exposure)
        # the longest exposure without a saturated pixel
        best = {o.light: o for o in mine if not o.saturated.any()}
        best = {**{o.light: o for o in reversed(mine)}, **best}
        longest = {o.light: o for o in mine}
        try:
            views.append(
                measure_ball(
                    {light: o.levels for light, o in best.items()},
                    posture=posture,
                    sensor=sensor,
                    radius_px=radius_px,
                    outline_images=[o.levels for o in longest.values()],
                )
            )
        except InputError as error:
            problems += error.messages
    if not views:
        raise InputError(*(f"{folder / BALL}: {text}" for text in problems))
    warnings += problems
    return views


def _plate(
    rig: RigConfig,
    folder: Path,
    flat: Plate,
    camera: PinholeCamera,
    stage: Stage,
    lights: Sequence[PanelLight],
    known: NDArray[Any],
    black: float,
    warnings: list[str],
    run: RunContext,
) -> PlateFit:
    observations = _observations(rig, folder, PLATE, run)
    sensor, part = build_sensor(rig.camera), _part_of(folder, PLATE)
    scale = sensor.max_level / part.reflectance.full_scale
    cell = max(8, round(CELL_SHARE * camera.width))
    longest = {
        (o.posture, o.light): o for o in sorted(observations, key=lambda o: o.exposure) if o.saturated.mean() < 0.01
    }
    views: list[Any] = []
    for (posture, light), o in longest.items():
        levels = (o.levels.astype(np.float64) - black) / (scale * o.exposure)
        try:
            views.append(
                plate_cells(
                    levels,
                    ~o.saturated,
                    light=light,
                    posture=posture,
                    plate=flat,
                    camera=camera,
                    stage=stage,
                    cell=cell,
                )
            )
        except InputError as error:
            warnings += error.messages
    return fit_plate(views, lights=lights, panels_covariance=known)


def _sensor(rig: RigConfig, folder: Path) -> PhotonTransfer:
    first, second = (read_image_set(folder / name) for name in SENSOR)
    others = {entry.key: entry for entry in second.images}
    pairs: list[FramePair] = []
    darks: list[FramePair] = []
    for entry in first.images:
        other = others.get(entry.key)
        if entry.png is None or other is None or other.png is None:
            raise InputError(
                f"{folder / SENSOR[1]}: no PNG of {entry.light} at {entry.posture}, exposure {entry.exposure:g}; "
                f"capture {SENSOR[0]} and {SENSOR[1]} alike"
            )
        a, b = read_png(first.folder / entry.png), read_png(second.folder / other.png)
        pairs.append(FramePair(first=a, second=b, exposure=entry.exposure))
        dark = dark_name(entry.posture, entry.exposure)
        if all((image_set.folder / dark).is_file() for image_set in (first, second)):
            a, b = read_png(first.folder / dark), read_png(second.folder / dark)
            darks.append(FramePair(first=a, second=b, exposure=entry.exposure))
    return photon_transfer(pairs, darks, bit_depth=rig.camera.sensor.bit_depth)
