"""What to capture to calibrate a rig: targets, their postures, and parts that stand for them on the virtual bench."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lightopt.config import BoardTargetConfig, RigConfig, load_targets
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._board import board_mesh
from lightopt.geometry import TriangleMesh, box_mesh, sphere_mesh, stl_bytes
from lightopt.images import make_folder, write_bytes_atomic, write_text_atomic
from lightopt.optics import Reflectance
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import Scene, build_camera, build_lights, build_sensor, build_stage, view_size

TARGETS_NAME, RIG_NAME = "targets.yaml", "rig.calibrated.yaml"
BOARD, BALL, PLATE, SENSOR = "board", "ball", "plate", ("sensor-a", "sensor-b")
"""Image sets of a calibration, below its folder."""

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
    path = folder / TARGETS_NAME
    if not path.exists():
        write_text_atomic(path, _targets_text(rig, size), overwrite=False)
    targets = load_targets(path)
    white = {"R_d": WHITE, "R_s": 0.0, "sigma_rad": 0.5}
    lights = [light.name for light in rig.lights]
    name = _quoted(rig.source.path)
    sentences: list[str] = []
    commands: list[str] = []
    images = 0

    def capture(
        kind: str, options: str, postures: Sequence[Posture], mesh: TriangleMesh, height: float, look: dict[str, float]
    ) -> None:
        _write_part(folder, kind, mesh, height, postures, look, force)
        target = _quoted(folder / kind)
        commands.append(f"lightopt capture {name} {target}.yaml -o {target}{options} --no-check-lights")

    if (board := targets.board) is not None:
        sentences.append(f"print {folder / BOARD}.pdf without scaling, glue it to a flat plate, lay it on the stage")
        postures = _postures(rig, BOARD_TILTS_DEG, BOARD_TURNS)
        mesh = board_mesh(board, margin=0.5 * board.square_mm)
        capture(BOARD, f" --light {lights[0]}", postures, mesh, board.height_mm, white)
        images += len(postures)
    if targets.ball is not None:
        sentences.append(
            "fix a polished bearing ball near the rotary axis, and expose so that no highlight is saturated"
        )
        postures = _postures(rig, BALL_TILTS_DEG, BALL_TURNS)
        r = targets.ball.radius_mm
        # off the rotary axis, which shows where the axis is
        sphere = sphere_mesh(r)
        mesh = replace(sphere, vertices=sphere.vertices + np.array([0.3 * r, 0.2 * r, r]))
        shine = {"R_d": BODY, "R_s": float(f"{MIRRORED / _plateau(rig, mesh, postures[0]):.4g}"), "sigma_rad": SIGMA}
        capture(BALL, "", postures, mesh, 0.0, shine)
        images += len(postures) * len(lights)
    if targets.plate is not None:
        sentences.append("lay a matt white plate on the stage, its sides along X and Y at rotation 0")
        x, y = targets.plate.size_mm
        mesh = box_mesh(np.array([[-0.5 * x, -0.5 * y, -PLATE_THICKNESS_MM], [0.5 * x, 0.5 * y, 0.0]]))
        postures = _postures(rig, PLATE_TILTS_DEG, 1)
        capture(PLATE, "", postures, mesh, targets.plate.height_mm, white)
        images += len(postures) * len(lights)
        levels = ",".join(f"1/{round(1 / exposure)}" if exposure < 1.0 else "1" for exposure in SENSOR_EXPOSURES)
        own = 1 if rig.virtual_bench is None else rig.virtual_bench.seed
        seeds = ("", f" --seed {own + 1}") if rig.hardware is None else ("", "")  # another noise
        commands += [
            f"lightopt capture {name} {_quoted(folder / PLATE)}.yaml -o {_quoted(folder / kind)} --posture 0,0 "
            f"--light {lights[0]} --exposures {levels} --dark{seed}"
            for kind, seed in zip(SENSOR, seeds, strict=True)
        ]
    sentences.append(f"measure all of them, and correct {path}")
    commands.append(f"lightopt calibrate {name} {_quoted(folder)}")
    return CalibrationPlan(board=targets.board, targets=tuple(sentences), commands=tuple(commands), images=images)


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
    return [
        Posture(elevation_deg=tilt, rotation_deg=round(float(rotation), 3))
        for tilt in elevations
        for rotation in rotations
    ]


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


def _write_part(
    folder: Path,
    name: str,
    mesh: TriangleMesh,
    height: float,
    postures: Sequence[Posture],
    reflectance: dict[str, float],
    force: bool,
) -> None:
    shape = folder / f"{name}.stl"
    entries = "\n".join(
        f"  - {{elevation_deg: {p.elevation_deg:g}, rotation_deg: {p.rotation_deg:g}}}" for p in postures
    )
    light = ", ".join(f"{key}: {value:g}" for key, value in reflectance.items())
    text = f"""\
# The {name} of a calibration in the postures to capture. Mesh and reflectance stand for it on the virtual bench.
format: lightopt-part/1
name: {json.dumps(f"calibration {name}")}
mesh: {{file: {shape.name}, units: mm}}
placement: {{anchor: as_modelled, translate_mm: [0, 0, {height:g}]}}
reflectance: {{{light}}}
postures:
{entries}
"""
    write_bytes_atomic(shape, stl_bytes(mesh), overwrite=force)
    write_text_atomic(folder / f"{name}.yaml", text, overwrite=force)


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
