"""Calibrate a rig from the image sets of a calibration folder: camera and stage, panels, their light, the sensor."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from lightopt.config import BoardTargetConfig, PlateTargetConfig, RigConfig, TargetsConfig, load_part, load_targets
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError, collected, refuse
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation, read_observations
from lightopt.estimate.rig_calibration._ball_fit import BallFit, BallView, fit_ball, panel_names
from lightopt.estimate.rig_calibration._ball_images import measure_ball
from lightopt.estimate.rig_calibration._board import BoardImage, board_grid, find_corners, read_corners
from lightopt.estimate.rig_calibration._board_fit import BoardFit, filed_covariance, fit_board
from lightopt.estimate.rig_calibration._deviations import read_covariance
from lightopt.estimate.rig_calibration._photon_transfer import FramePair, PhotonTransfer, photon_transfer
from lightopt.estimate.rig_calibration._plate_fit import PlateFit, PlateView, fit_plate, plate_cells
from lightopt.images import dark_name, read_image_set, read_png
from lightopt.lights import PanelLight
from lightopt.scene import PinholeCamera, Stage, build_camera, build_lights, build_sensor, build_stage

TARGETS, RIG_NAME = "targets.yaml", "rig.calibrated.yaml"
BOARD, BALL, PLATE, SENSOR = "board", "ball", "plate", ("sensor-a", "sensor-b")
"""Image sets of a calibration, below its folder."""
CORNERS_NAME = "board.json"
"""Corners of the board that another program found, in place of its image set."""
# covariance of a panel's parameters where only the rig file has them [mm], [rad], [mm]
_FILED = np.diag(np.square([3.0, 3.0, 3.0, 0.04, 0.04, 0.04, 0.1, 0.1]))
PANELS_ONLY = "ball and plate measure panels only"
MANY_OUTLIERS = 0.2  # share of a view's corners
# of residuals, from which camera, stage or target may not be, and are not, what they are taken for
POOR_RMS, WRONG_RMS = 3.0, 20.0
POOR_PX = 1.0  # standard error of a predicted pixel from which the postures are too few
CELL_SHARE = 1 / 40  # side of a plate's cell, of the image's width


@dataclass(frozen=True, kw_only=True, eq=False)
class RigCalibration:
    rig: RigConfig  # as it was filed
    folder: Path  # with the image sets and targets.yaml
    board: BoardFit | None  # as the others, None where there is no such image set
    ball: BallFit | None
    plate: PlateFit | None
    sensor: PhotonTransfer | None
    camera: PinholeCamera  # world frame, as stage and lights, measured where they were, else as filed
    stage: Stage
    lights: tuple[PanelLight, ...]
    warnings: tuple[str, ...]

    @property
    def unobservable(self) -> tuple[str, ...]:
        """What the images do not show, although they are there."""
        return tuple(name for fit in (self.board, self.ball) if fit is not None for name in fit.unobservable)

    @property
    def covariance(self) -> tuple[tuple[str, ...], Float64]:
        """Names of the values of camera, stage and lights that were measured, now or earlier, and their covariance.

        Of camera and stage [mm, deg, px], as `BoardFit.names` has them; gains; panels [mm, rad], as
        :data:`PANEL_PARAMETERS` has them.
        """
        earlier, covariance = self.earlier
        listed = {} if self.rig.calibration is None else self.rig.calibration.intervals
        kept = [i for i, name in enumerate(earlier) if name in listed and not self.replaces(name)]
        names = [earlier[i] for i in kept]
        blocks = [covariance[np.ix_(kept, kept)]]
        if self.board is not None:
            mine = [i for i, name in enumerate(self.board.names) if not name.startswith("board.")]
            names += [self.board.names[i] for i in mine]
            blocks.append(self.board.covariance[np.ix_(mine, mine)])
        own: tuple[Sequence[str], Float64] | None = None
        if self.plate is not None:
            own = self.plate.names, self.plate.covariance
        elif self.ball is not None:
            own = panel_names(self.ball.lights), self.ball.panels_covariance
        if own is not None:
            left_out = set(panel_names([light for light in self.lights if light.name not in self.panels]))
            mine = [i for i, name in enumerate(own[0]) if name not in left_out]
            names += [own[0][i] for i in mine]
            blocks.append(own[1][np.ix_(mine, mine)])
        return tuple(names), np.asarray(block_diag(*blocks), np.float64)

    @cached_property
    def earlier(self) -> tuple[tuple[str, ...], Float64]:
        """Names of the values that the rig file has from an earlier calibration, and their covariance."""
        return read_covariance(self.rig)

    @cached_property
    def panels(self) -> tuple[str, ...]:
        """Names of the lights whose place and size are measured now: by a ball, or anew by a plate."""
        if self.ball is not None:
            return self.ball.shown
        known = [light.name for light in self.lights if set(panel_names([light])) <= set(self.earlier[0])]
        return () if self.plate is None else tuple(known)

    def replaces(self, name: str) -> bool:
        """Whether a value of an earlier calibration is measured anew, by its name."""
        if _of_camera([name]):
            return self.board is not None
        if name.startswith("camera.sensor."):
            return self.sensor is not None
        if name in panel_names(self.lights):
            return name in panel_names([light for light in self.lights if light.name in self.panels])
        if self.plate is None or (name == "emission_exponent" and not self.plate.emission_fitted):
            return False
        return name in self.plate.names


def calibrate_rig(rig: RigConfig, folder: Path, *, run: RunContext | None = None) -> RigCalibration:
    """Calibrate what the image sets below a calibration folder allow.

    Raises InputError: No image set, targets that do not fit the images, or a target of which too little is seen
    """
    if rig.stage.pivot_mm[:2] != (0.0, 0.0):
        at, found = rig.source.at("stage", "pivot_mm"), list(rig.stage.pivot_mm)
        raise InputError(f"{at}: expected [0, 0, z]: a calibration has its origin on the rotary axis; found {found}")
    if rig.source.path.resolve().parent == folder.resolve() and rig.source.path.name == RIG_NAME:
        raise InputError(f"{rig.source.path}: this is the result; give the rig file that was captured with")
    targets = load_targets(folder / TARGETS)
    names = (BOARD, BALL, PLATE, *SENSOR)
    sets = {name for name in names if (folder / name).is_dir()}
    if (folder / CORNERS_NAME).is_file():
        sets.add(BOARD)
    if not sets:
        raise InputError(f"{folder}: no image set of a calibration; expected {', '.join(names)}; see --plan")
    _refuse_incomplete(rig, folder, targets, sets)
    images = _Images(rig, folder, targets, run or RunContext())
    camera, stage, lights = build_camera(rig), build_stage(rig), build_lights(rig)
    earlier = read_covariance(rig)
    sensor = images.sensor() if all(name in sets for name in SENSOR) else None
    board: BoardFit | None = None
    ball: BallFit | None = None
    plate: PlateFit | None = None
    if BOARD in sets and targets.board is not None:
        board = images.board(targets.board, camera, stage)
        camera, stage = board.camera, board.stage
    if PLATE in sets and board is None and not _of_camera(earlier[0]):
        images.warnings.append(
            "the plate was fitted to camera and stage as filed, as if they were exact: there is no image set of a board"
        )
    if BALL in sets and targets.ball is not None:
        ball = fit_ball(
            images.ball(camera, targets.ball.radius_mm),
            lights=lights,
            camera=camera,
            stage=stage,
            radius=targets.ball.radius_mm,
            radius_error=targets.ball.radius_error_mm,
            size_error=targets.panel_size_error_mm,
            **_rig_errors(earlier if board is None else (board.names, board.covariance), camera, stage),
        )
        lights = ball.lights
        images.check(BALL, ball.rms, "outlines and highlights", "check the postures and the ball's radius")
    if PLATE in sets and targets.plate is not None:
        known = _panels_without_ball(earlier, lights) if ball is None else ball.panels_covariance
        if ball is None and not set(panel_names(lights)) <= set(earlier[0]):
            images.warnings.append("the plate was fitted to panels as filed: there is no image set of a ball")
        black = rig.camera.sensor.black_level if sensor is None else sensor.black_level.value
        views = images.plate(targets.plate, camera, stage, black)
        error = targets.reading_error_deg
        plate = fit_plate(views, lights=lights, panels_covariance=known, reading_error_deg=error)
        images.warnings.extend(plate.warnings)
        images.check(PLATE, plate.rms, "levels", "check size, height and place of the plate, and postures")
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
        warnings=tuple(images.warnings),
    )


def _refuse_incomplete(rig: RigConfig, folder: Path, targets: TargetsConfig, sets: set[str]) -> None:
    problems = [
        f"{folder / TARGETS}: {name}: missing, but there is an image set {name}; describe it, or remove the image set"
        for name in (BOARD, BALL, PLATE)
        if name in sets and getattr(targets, name) is None
    ]
    if len(missing := set(SENSOR) - sets) == 1:
        problems.append(f"{folder / missing.pop()}: missing; {' and '.join(SENSOR)} are captured alike")
    if of_panels := [name for name in (BALL, PLATE) if name in sets]:
        problems += [
            f"{rig.source.at('lights', i, 'kind')}: {light.name} is a {light.kind}: {PANELS_ONLY}; remove the "
            f"image set {' and '.join(of_panels)}"
            for i, light in enumerate(rig.lights)
            if light.kind != "panel"
        ]
    refuse(problems)


def _of_camera(names: Sequence[str]) -> list[int]:
    # numbers of the values of camera and stage
    own = ("camera.", "tilt_axis.", "rotary_axis.")
    others = ("camera.vignetting", "camera.sensor")
    return [i for i, name in enumerate(names) if name.startswith(own) and not name.startswith(others)]


def _rig_errors(measured: tuple[tuple[str, ...], Float64], camera: PinholeCamera, stage: Stage) -> dict[str, Any]:
    # as they were measured, else of a rig file
    names, covariance = measured
    own = _of_camera(names)
    names, covariance = tuple(names[i] for i in own), covariance[np.ix_(own, own)]
    filed, as_filed = filed_covariance(camera, stage)
    rest = [i for i, name in enumerate(filed) if name not in names]
    names = (*names, *(filed[i] for i in rest))
    # the panels are those of the camera that was measured, where it was
    whole = block_diag(covariance, as_filed[np.ix_(rest, rest)])
    return {"rig_names": names, "rig_covariance": whole, "fit_rig": bool(rest)}


def _panels_without_ball(measured: tuple[tuple[str, ...], Float64], lights: Sequence[PanelLight]) -> Float64:
    # covariance of panels as they were measured earlier, else of a rig file
    own = panel_names(lights)
    known = np.asarray(np.kron(np.eye(len(lights)), _FILED), np.float64)
    names, covariance = measured
    to = [i for i, name in enumerate(own) if name in names]
    known[to, :] = known[:, to] = 0.0
    at = [names.index(own[i]) for i in to]
    known[np.ix_(to, to)] = covariance[np.ix_(at, at)]
    return known


@dataclass(frozen=True)
class _Images:
    rig: RigConfig
    folder: Path
    targets: TargetsConfig
    run: RunContext
    warnings: list[str] = field(default_factory=list[str])

    def board(self, target: BoardTargetConfig, camera: PinholeCamera, stage: Stage) -> BoardFit:
        if (self.folder / CORNERS_NAME).is_file():
            views = read_corners(self.folder / CORNERS_NAME)
        else:
            of = self._by_posture(BOARD)
            means = {p: np.mean([o.levels for o in some], axis=0, dtype=np.float64) for p, some in of.items()}
            images = [BoardImage(str(posture), posture, mean) for posture, mean in means.items()]
            full_scale = float(build_sensor(self.rig.camera).saturated_from)
            views, problems = find_corners(images, target, full_scale=full_scale)
            self.warnings.extend(f"board {text}" for text in problems)
        error = self.targets.reading_error_deg
        fit = fit_board(views, board_grid(target), camera=camera, stage=stage, angle_error_deg=error)
        for view in fit.residuals:
            if view.faulty:
                self.warnings.append(f"board {view.name}: does not fit the other views; look at its image")
            elif view.outliers > MANY_OUTLIERS * view.corners:
                left_out = f"{view.outliers} of {view.corners} corners do not fit and are left out"
                self.warnings.append(f"board {view.name}: {left_out}; look at its image")
        if not fit.predicted_rms < POOR_PX:
            self.warnings.append(
                f"board: pixels are predicted to {fit.predicted_rms:.2g} px only: more postures are needed, with "
                "other tilts and rotations, as --plan has them"
            )
        return fit

    def ball(self, camera: PinholeCamera, radius: float) -> list[BallView]:
        distance = float(np.linalg.norm(camera.position)) - radius
        radius_px = camera.image_distance / camera.pixel_size * radius / distance
        sensor = build_sensor(self.rig.camera)
        views: list[BallView] = []
        problems: list[str] = []
        for posture, observations in self._by_posture(BALL).items():
            mine = sorted(observations, key=lambda o: o.exposure)
            # the longest exposure without a saturated pixel
            best = {o.light: o for o in mine if not o.saturated.any()}
            best = {**{o.light: o for o in reversed(mine)}, **best}
            shown = {light: best[light].levels for light in sorted(best)}
            longest = list({o.light: o.levels for o in mine}.values())
            ball = partial(measure_ball, radius_px=radius_px, sensor=sensor, outline_images=longest)
            with collected(problems):
                view, of_panels = ball(shown, posture=posture)
                views.append(view)
                problems += of_panels
        if not any(view.panels for view in views):
            others = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
            raise InputError(f"{self.folder / BALL}: no panel can be measured in any image: {problems[0]}{others}")
        self.warnings.extend(f"ball: {text}; left out" for text in problems)
        return views

    def plate(self, target: PlateTargetConfig, camera: PinholeCamera, stage: Stage, black: float) -> list[PlateView]:
        reflectance = load_part(self.folder / f"{PLATE}.yaml").reflectance
        scale = build_sensor(self.rig.camera).max_level / reflectance.full_scale
        cell = max(8, round(CELL_SHARE * camera.width))
        views: list[PlateView] = []
        for posture, observations in self._by_posture(PLATE).items():
            mine = sorted(observations, key=lambda o: o.exposure)
            longest = {o.light: o for o in mine if o.saturated.mean() < 0.01}
            for light, o in longest.items():
                levels = (o.levels.astype(np.float64) - black) / (scale * o.exposure)
                place: dict[str, Any] = {"posture": posture, "camera": camera, "stage": stage, "cell": cell}
                with collected(self.warnings):
                    views.append(plate_cells(levels, ~o.saturated, light=light, plate=target, **place))
        return views

    def sensor(self) -> PhotonTransfer:
        first, second = (read_image_set(self.folder / name) for name in SENSOR)
        others = {entry.key: entry for entry in second.images}
        pairs: list[FramePair] = []
        darks: list[FramePair] = []
        for entry in first.images:
            other = others.get(entry.key)
            if entry.png is None or other is None or other.png is None:
                raise InputError(
                    f"{self.folder / SENSOR[1]}: no PNG of {entry.light} at {entry.posture}, exposure "
                    f"{entry.exposure:g}; capture {SENSOR[0]} and {SENSOR[1]} alike"
                )
            dark = dark_name(entry.posture, entry.exposure)
            for kind, a, b in ((pairs, entry.png, other.png), (darks, dark, dark)):
                if kind is pairs or all((one.folder / dark).is_file() for one in (first, second)):
                    frames = read_png(first.folder / a), read_png(second.folder / b)
                    kind.append(FramePair(first=frames[0], second=frames[1], exposure=entry.exposure))
        return photon_transfer(pairs, darks, bit_depth=self.rig.camera.sensor.bit_depth)

    def check(self, name: str, rms: float, what: str, remedy: str) -> None:
        # of residuals in the errors that are claimed
        far = f"{what} are {rms:.3g} times as far from what the fit explains as their errors say"
        text = f"{self.folder / name}: {far}: {remedy}"
        if not (self.folder / BOARD).is_dir() and not (self.folder / CORNERS_NAME).is_file():
            text += ", and capture the board, too: the camera may not be where the rig file has it"
        if not rms < WRONG_RMS:
            raise InputError(text)
        if not rms < POOR_RMS:
            self.warnings.append(text)

    def _by_posture(self, name: str) -> dict[Posture, list[Observation]]:
        images, part = read_image_set(self.folder / name), load_part(self.folder / f"{name}.yaml")
        found: dict[Posture, list[Observation]] = {}
        for one in read_observations(images, self.rig, part, threads=self.run.threads):
            found.setdefault(one.posture, []).append(one)
        return found
