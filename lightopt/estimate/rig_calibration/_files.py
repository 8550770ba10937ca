"""The files of a calibration folder: what to capture, and the rig file with what was measured, its covariance, figures.

What to capture are targets in postures, with parts that stand for them on the virtual bench.
"""

import io
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import BoardTargetConfig, RigConfig, copied_text, load_targets, standing_at
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture, vector_of_rotation
from lightopt.estimate.rig_calibration._ball_fit import PANEL_PARAMETERS, mirrored_image
from lightopt.estimate.rig_calibration._ball_images import LEAST_SIDE
from lightopt.estimate.rig_calibration._board import board_mesh
from lightopt.estimate.rig_calibration._calibrate import (
    BALL,
    BOARD,
    PANELS_ONLY,
    PLATE,
    RIG_NAME,
    SENSOR,
    TARGETS,
    RigCalibration,
)
from lightopt.estimate.rig_calibration._deviations import NORMAL_95, Measured
from lightopt.geometry import TriangleMesh, box_mesh, sphere_mesh, stl_bytes
from lightopt.images import make_folder, write_bytes_atomic, write_text_atomic
from lightopt.lights import PanelLight, panel_corners
from lightopt.optics import Reflectance
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import Scene, build_camera, build_lights, build_sensor, build_stage, view_size

COVARIANCE_NAME, FIGURES_NAME, REPORT_NAME = "rig.calibrated.npz", "calibration.json", "report.html"
SQUARES = (12, 9)
BOARD_SHARE = 0.9  # of the view that the board fills
BOARD_TILTS_DEG, BOARD_TURNS = (0.0, 40.0, -40.0), 5
FIRST_TURN_DEG = 10.0  # a board in line with the pixels has uneven edges
BALL_TILTS_DEG, BALL_TURNS, BALL_SHARE = (20.0, -20.0), 4, 0.2
PLATE_TILTS_DEG = (0.0, 25.0, -25.0)
PLATE_THICKNESS_MM = 1.0  # on the virtual bench
SENSOR_EXPOSURES = (1.0, 1 / 2, 1 / 3, 1 / 4, 1 / 6, 1 / 8, 1 / 12, 1 / 16, 1 / 24)
# light of the parts that stand for the targets at exposure 1, of 255: of white, of a panel in the ball, of the ball
WHITE, MIRRORED, BODY = 190.0, 120.0, 40.0
SIGMA = 0.004  # of the ball


@dataclass(frozen=True, kw_only=True)
class CalibrationPlan:
    """What to put on the stage, and the commands that fill a calibration folder."""

    board: BoardTargetConfig | None  # to print; None where there is none
    targets: tuple[str, ...]  # what is put on the stage, one sentence each
    commands: tuple[str, ...]  # to run one after another
    images: int  # number of images that they capture


def plan_calibration(rig: RigConfig, folder: Path, *, force: bool = False) -> CalibrationPlan:
    """Write targets.yaml, and part and mesh of each target, sized for the rig's view.

    Raises InputError: The camera does not see the table, or other files are in the way and `force` is False
    """
    size = view_size(build_camera(rig))
    if size is None:
        raise InputError(f"{rig.source.at('camera')}: the view reaches beyond the table's horizon; no target fits it")
    make_folder(folder)
    # what the user has measured stays
    path = folder / TARGETS
    if not path.exists():
        write_text_atomic(path, _targets_text(rig, size), overwrite=False)
    targets = load_targets(path)
    white = {"R_d": WHITE, "R_s": 0.0, "sigma_rad": 0.5}
    lights = [light.name for light in rig.lights]
    name = _quoted(rig.source.path)
    sentences: list[str] = []
    # image set, options of its capture, postures, mesh, its height, its reflectance
    parts: list[tuple[str, str, list[Posture], TriangleMesh, float, dict[str, float]]] = []
    if (board := targets.board) is not None:
        sentences.append(f"print {folder / BOARD}.pdf without scaling, glue it to a flat plate, lay it on the stage")
        mesh = board_mesh(board, margin=0.5 * board.square_mm)
        postures = _postures(rig, BOARD_TILTS_DEG, BOARD_TURNS)
        parts.append((BOARD, f" --light {lights[0]}", postures, mesh, board.height_mm, white))
    panels = all(light.kind == "panel" for light in rig.lights)
    if not panels and (targets.ball is not None or targets.plate is not None):
        sentences.append(f"{PANELS_ONLY}, and this rig has other lights: they stay as filed")
    ball_postures = _postures(rig, BALL_TILTS_DEG, BALL_TURNS)
    tilted = len({posture.elevation_deg for posture in ball_postures}) > 1
    if panels and targets.ball is not None and not tilted:
        sentences.append("no ball: it takes two tilts, and this stage has one: the panels stay as filed")
    if panels and targets.ball is not None and tilted:
        sentences.append(
            "fix a polished bearing ball near the rotary axis; expose so that no highlight is saturated: try "
            "--exposure 1,1/2,1/4,1/8 at one posture, and add the best to its command"
        )
        r = targets.ball.radius_mm
        if (narrowest := _mirrored_px(rig, r)) < LEAST_SIDE:
            sentences.append(
                f"take a ball of at least {math.ceil(r * LEAST_SIDE / narrowest)} mm in radius, and correct {path}: "
                f"one of {r:g} mm mirrors a panel {narrowest:.0f} px wide, and {LEAST_SIDE:.0f} are needed"
            )
        # off the rotary axis, which shows where the axis is
        sphere = sphere_mesh(r)
        mesh = replace(sphere, vertices=sphere.vertices + np.array([0.3 * r, 0.2 * r, r]))
        level = _plateau(rig, mesh, ball_postures[0])
        shine = {"R_d": BODY, "R_s": float(f"{MIRRORED / level:.4g}"), "sigma_rad": SIGMA}
        parts.append((BALL, "", ball_postures, mesh, 0.0, shine))
    if targets.plate is not None:
        sentences.append("lay a matt white plate on the stage, its sides along X and Y at rotation 0")
        x, y = targets.plate.size_mm
        mesh = box_mesh(np.array([[-0.5 * x, -0.5 * y, -PLATE_THICKNESS_MM], [0.5 * x, 0.5 * y, 0.0]]))
        parts.append((PLATE, "", _postures(rig, PLATE_TILTS_DEG, 1), mesh, targets.plate.height_mm, white))
    sentences.append(f"measure all of them, and correct {path}")
    commands: list[str] = []
    images = 0
    for kind, options, postures, mesh, height, reflectance in parts:
        write_bytes_atomic(folder / f"{kind}.stl", stl_bytes(mesh), overwrite=force)
        write_text_atomic(folder / f"{kind}.yaml", _part_text(kind, postures, height, reflectance), overwrite=force)
        if kind == PLATE and not panels:  # for the sensor alone
            continue
        target = _quoted(folder / kind)
        commands.append(f"lightopt capture {name} {target}.yaml -o {target}{options} --no-check-lights")
        images += len(postures) * (1 if options else len(lights))
    if targets.plate is not None:
        levels = ",".join(f"1/{round(1 / exposure)}" if exposure < 1.0 else "1" for exposure in SENSOR_EXPOSURES)
        own = 1 if rig.virtual_bench is None else rig.virtual_bench.seed
        simulated = rig.hardware is None or rig.hardware.camera.is_simulated
        seeds = ("", f" --seed {own + 1}") if simulated else ("", "")  # another noise
        commands += [
            f"lightopt capture {name} {_quoted(folder / PLATE)}.yaml -o {_quoted(folder / kind)} --posture 0,0 "
            f"--light {lights[0]} --exposure {levels} --dark{seed}"
            for kind, seed in zip(SENSOR, seeds, strict=True)
        ]
    commands.append(f"lightopt calibrate {name} {_quoted(folder)}")
    return CalibrationPlan(board=targets.board, targets=tuple(sentences), commands=tuple(commands), images=images)


def _mirrored_px(rig: RigConfig, radius: float) -> float:
    # the shortest side of a panel that a ball on the table mirrors [px]; infinite where it mirrors none
    camera, lights = build_camera(rig), build_lights(rig)
    corners = np.array([panel_corners(light) for light in lights])
    seen = mirrored_image(camera, np.array([0.0, 0.0, radius]), radius, corners)
    sides = np.linalg.norm(np.roll(seen, 1, axis=1) - seen, axis=2)
    return float(np.nanmin(sides, initial=np.inf))


def _quoted(path: Path) -> str:
    text = path.as_posix()
    return f'"{text}"' if " " in text else text


def _rounded(length: float) -> float:
    # to two digits, down
    step = 10.0 ** (math.floor(math.log10(length)) - 1)
    return round(math.floor(length / step + 1e-9) * step, 6)


def _postures(rig: RigConfig, tilts: Sequence[float], turns: int) -> list[Posture]:
    # within the rig's ranges
    low, high = rig.stage.elevation_range_deg
    first, last = rig.stage.rotation_range_deg
    if last - first >= 360.0:
        start = 0.0 if first <= 0.0 and last >= 360.0 else first
        rotations = start + FIRST_TURN_DEG + 360.0 / turns * np.arange(turns)
    else:
        rotations = np.linspace(first, last, turns) if turns > 1 else np.array([first])
    elevations = dict.fromkeys(float(np.clip(tilt, low, high)) for tilt in tilts)
    turns_deg = [round(float(rotation), 3) for rotation in rotations]
    return [Posture(elevation_deg=tilt, rotation_deg=turn) for tilt in elevations for turn in turns_deg]


def _targets_text(rig: RigConfig, size: tuple[float, float]) -> str:
    square = _rounded(BOARD_SHARE * min(size[0] / SQUARES[0], size[1] / SQUARES[1]))
    return f"""\
# Targets to calibrate {rig.name} with. Correct each size to what a caliper measures; delete what is not used.
format: lightopt-targets/1

board:                          # a printed ChArUco board
  squares: [{SQUARES[0]}, {SQUARES[1]}]
  square_mm: {square:g}               # measured over many squares
  marker_mm: {_rounded(0.74 * square):g}
  dictionary: DICT_4X4_250
  height_mm: 0                  # of the printed face above the table: the thickness of the board
  height_error_mm: 0.01         # standard deviation of it

ball:                           # a polished bearing ball
  radius_mm: {_rounded(BALL_SHARE * min(size)):g}
  radius_error_mm: 0.001

plate:                          # a matt white plate
  size_mm: [{_rounded(0.95 * size[0]):g}, {_rounded(0.95 * size[1]):g}]
  height_mm: 0                  # of its upper face

panel_size_error_mm: 0.1        # of size_mm in the rig file; null if the sizes are not known
reading_error_deg: 0.02         # of the stage's readings
"""


def _part_text(name: str, postures: Sequence[Posture], height: float, reflectance: dict[str, float]) -> str:
    lines = "\n".join(f"  - {{elevation_deg: {p.elevation_deg:g}, rotation_deg: {p.rotation_deg:g}}}" for p in postures)
    light = ", ".join(f"{key}: {value:g}" for key, value in reflectance.items())
    return f"""\
# The {name} of a calibration in the postures to capture. Mesh and reflectance stand for it on the virtual bench.
format: lightopt-part/1
name: {json.dumps(f"calibration {name}")}
mesh: {{file: {name}.stl, units: mm}}
placement: {{anchor: as_modelled, translate_mm: [0, 0, {height:g}]}}
reflectance: {{{light}}}
postures:
{lines}
"""


def _plateau(rig: RigConfig, mesh: TriangleMesh, posture: Posture) -> float:
    # level of a panel that a part mirrors with R_s = 1
    scene = Scene(
        camera=build_camera(rig),
        lights=build_lights(rig, points="auto"),
        mesh=mesh,
        reflectance=Reflectance(R_d=0.0, R_s=1.0, sigma=SIGMA),
        sensor=build_sensor(rig.camera),
        stage=build_stage(rig),
        postures=(posture,),
    )
    images = render_posture(scene, posture, caster=cast_rays_at(scene))
    return max(float(image.level.max()) for image in images.lights)


Interval = tuple[float, float]
Values = dict[tuple[str | int, ...], str | None]


def calibrated_rig_text(found: RigCalibration) -> str:
    """Text of the rig file with what was measured in place of what was filed; comments stay.

    Raises InputError: The rig was built in code, or its file has anchors and aliases where values change
    """
    rig = found.rig
    values: Values = {}
    if found.board is not None:
        values |= _camera_values(found) | _stage_values(found)
    for index, light in enumerate(found.lights):
        if light.name in found.panels:
            values |= _pose_values(rig, index, light)
        if found.plate is not None:
            values |= _light_values(found, index, light)
    if found.plate is not None:
        v2, v4 = (v.value for v in found.plate.vignetting)
        values["camera", "vignetting"] = f"{{v2: {v2:.9g}, v4: {v4:.9g}}}"
    if found.sensor is not None:
        sensor = found.sensor
        for key in ("black_level", "read_noise_levels", "electrons_per_level"):
            measured: Measured = getattr(sensor, key)
            values["camera", "sensor", key] = f"{max(0.0, measured.value):.9g}"
        if sensor.saturation_level is not None and sensor.saturation_level < 2**rig.camera.sensor.bit_depth - 1:
            values["camera", "sensor", "saturation_level"] = str(math.floor(sensor.saturation_level))
    of_rig = [(name, ends) for name, ends in intervals(found) if not name.startswith("board.")]
    lines = "".join(f"\n    {json.dumps(name)}: [{low:.9g}, {high:.9g}]" for name, (low, high) in of_rig)
    values["calibration",] = f"\n  covariance: {COVARIANCE_NAME}\n  intervals:{lines}"
    # the covariance lies beside the new file, not beside the old one
    text = copied_text(rig.model_copy(update={"calibration": None}), found.folder, values)
    return f"# calibrated by lightopt from the image sets in this folder; see {REPORT_NAME}\n{text}"


def _camera_values(found: RigCalibration) -> Values:
    camera = found.camera
    rotation = np.stack([camera.right, -camera.up, camera.forward], axis=1)
    turn = np.degrees(vector_of_rotation(rotation))
    focal = camera.image_distance / camera.pixel_size
    lens = {name: value for name, value in asdict(camera.distortion).items() if value}
    gone = ("distance_mm", "elevation_deg", "azimuth_deg", "roll_deg", "image_distance_mm", "focal_length_mm")
    return {
        **{("camera", key): None for key in gone},
        ("camera", "pose"): f"{{position_mm: {_vector(camera.position)}, rotation_vector_deg: {_vector(turn)}}}",
        ("camera", "focal_px"): _vector([focal, focal * camera.aspect]),
        ("camera", "principal_point_px"): _vector(camera.axis_px),
        ("camera", "distortion"): f"{{{', '.join(f'{k}: {v:.9g}' for k, v in lens.items())}}}",
    }


def _stage_values(found: RigCalibration) -> Values:
    point, direction = found.stage.tilt_axis
    axis = f"{{point_mm: {_vector(point)}, direction: {_vector(direction)}, scale: {found.stage.tilt_scale:.9g}}}"
    rotary = f"{{scale: {found.stage.rotary_scale:.9g}}}"
    if "stage" not in found.rig.model_fields_set:
        return {("stage",): f"{{tilt_axis: {axis}, rotary_axis: {rotary}}}"}
    return {("stage", "pivot_mm"): None, ("stage", "tilt_axis"): axis, ("stage", "rotary_axis"): rotary}


def _pose_values(rig: RigConfig, index: int, light: PanelLight) -> Values:
    turn = np.degrees(vector_of_rotation(np.stack([light.across, light.along, light.outward], axis=1)))
    at: tuple[str | int, ...] = ("lights", index)
    values: Values = {(*at, key): None for key in ("distance_mm", "elevation_deg", "azimuth_deg")}
    values[(*at, "pose")] = f"{{centre_mm: {_vector(light.centre)}, rotation_vector_deg: {_vector(turn)}}}"
    values[(*at, "size_mm")] = _vector(light.size)
    standing = standing_at([float(v) for v in np.round(light.centre, 6)])
    for key in ("elevation_deg", "azimuth_deg"):
        name = key.replace("_deg", "_range_deg")
        if (ends := getattr(rig.lights[index], name)) is not None:
            # a range holds the light, wherever it was measured
            here = standing[key]
            if key == "azimuth_deg":
                here += 360.0 * round((0.5 * (ends[0] + ends[1]) - here) / 360.0)
            low, high = min(ends[0], math.floor(1e3 * here) / 1e3), max(ends[1], math.ceil(1e3 * here) / 1e3)
            values[(*at, name)] = f"[{low:g}, {high:g}]"
    return values


def _light_values(found: RigCalibration, index: int, light: PanelLight) -> Values:
    at: tuple[str | int, ...] = ("lights", index)
    values: Values = {(*at, "gain"): f"{light.gain:.9g}"}
    assert found.plate is not None
    if found.plate.fall_off_decided:
        values[(*at, "falloff")] = found.plate.fall_off
    if light.inverse_square:
        values[(*at, "reference_distance_mm")] = f"{light.reference_distance or light.distance:.9g}"
    if found.plate.emission_fitted:
        values[(*at, "emission_exponent")] = f"{light.emission_exponent:.9g}"
    return values


def intervals(found: RigCalibration) -> Iterator[tuple[str, Interval]]:
    """95 % interval of each measured value, by a name that says what it is of."""
    if found.board is not None:
        yield from found.board.intervals.items()
    names, covariance = found.covariance
    if found.ball is not None or found.plate is not None:
        half = dict(zip(names, NORMAL_95 * np.sqrt(np.diag(covariance)), strict=True))
        for light in found.lights:
            if light.name not in found.panels:
                continue
            for name, value in zip(PANEL_PARAMETERS, [*light.centre, 0.0, 0.0, 0.0, *light.size], strict=True):
                width = float(half[f"{light.name} {name}"])
                yield f"{light.name} {name}", (float(value) - width, float(value) + width)
    if found.plate is not None:
        for light, gain in zip(found.lights, found.plate.gains, strict=True):
            yield f"{light.name} gain", gain.interval_95
        if found.plate.emission_fitted:
            yield "emission_exponent", found.plate.emission_exponent.interval_95
        for key, value in zip(("v2", "v4"), found.plate.vignetting, strict=True):
            yield f"camera.vignetting.{key}", value.interval_95
    if found.sensor is not None:
        for key in ("black_level", "read_noise_levels", "electrons_per_level"):
            yield f"camera.sensor.{key}", getattr(found.sensor, key).interval_95
    if found.rig.calibration is not None:
        yield from ((name, ends) for name, ends in found.rig.calibration.intervals.items() if not found.replaces(name))


def figures(found: RigCalibration) -> dict[str, Any]:
    document: dict[str, Any] = {
        "format": "lightopt-calibration/1",
        "rig": {"file": found.rig.source.path.name, "sha256": found.rig.source.sha256},
        "intervals_95": {name: list(ends) for name, ends in intervals(found)},
        "unobservable": list(found.unobservable),
        "warnings": list(found.warnings),
    }
    if (board := found.board) is not None:
        document["board"] = {
            "views": [
                {"posture": view.posture.as_dict(), "corners": view.corners, "median_px": view.median}
                | {"outliers": view.outliers, "faulty": view.faulty}
                for view in board.residuals
            ],
            "freed": list(board.freed),
            "corner_noise_px": board.noise,
            "predicted_rms_px": board.predicted_rms,
            "reading_error_deg": board.angle_error_deg,
            **({} if board.next_posture is None else {"next_posture": board.next_posture[0].as_dict()}),
        }
    if found.ball is not None:
        document["ball"] = {
            "radius_mm": found.ball.radius,
            "centre_mm": found.ball.centre.tolist(),
            "rms": found.ball.rms,
            "left_out": [{"posture": posture.as_dict(), "light": name} for posture, name in found.ball.left_out],
        }
    if (plate := found.plate) is not None:
        names = ("fall_off", "fall_off_decided", "emission_fitted", "rms")
        document["plate"] = {"brightness": plate.brightness.value, **{name: getattr(plate, name) for name in names}}
    if (sensor := found.sensor) is not None:
        error = sensor.linearity_error if math.isfinite(sensor.linearity_error) else None
        document["sensor"] = {"saturation_level": sensor.saturation_level, "linearity_error_percent": error}
    return document


def write_calibration(found: RigCalibration, *, force: bool = False) -> tuple[Path, ...]:
    """Write the calibrated rig, the covariance and the figures into the calibration folder.

    Raises InputError: Other results are there, and `force` is False
    """
    names, covariance = found.covariance
    packed = io.BytesIO()
    np.savez(packed, names=np.array(names, np.str_), covariance=covariance)
    paths = tuple(found.folder / name for name in (RIG_NAME, COVARIANCE_NAME, FIGURES_NAME))
    text = json.dumps(figures(found), indent=1, ensure_ascii=False) + "\n"
    write_text_atomic(paths[0], calibrated_rig_text(found), overwrite=force)
    write_bytes_atomic(paths[1], packed.getvalue(), overwrite=force)
    write_text_atomic(paths[2], text, overwrite=force)
    return paths


def _vector(values: Sequence[float] | Any) -> str:
    return f"[{', '.join(f'{float(v):.9g}' for v in values)}]"
