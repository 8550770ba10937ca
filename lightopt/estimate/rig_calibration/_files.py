"""The files of a calibration: the rig file with what was measured, the covariance, and all figures."""

import io
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import RigConfig, copied_text, standing_at
from lightopt.core.transforms import vector_of_rotation
from lightopt.estimate.rig_calibration._ball_fit import PANEL_PARAMETERS
from lightopt.estimate.rig_calibration._calibrate import RigCalibration
from lightopt.estimate.rig_calibration._deviations import NORMAL_95, Measured
from lightopt.estimate.rig_calibration._plan import RIG_NAME
from lightopt.images import write_bytes_atomic, write_text_atomic
from lightopt.lights import PanelLight

COVARIANCE_NAME, FIGURES_NAME, REPORT_NAME = "rig.calibrated.npz", "calibration.json", "report.html"

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
        if found.ball is not None:
            values |= _pose_values(rig, index, light)
        if found.plate is not None:
            values |= _light_values(found, index, light)
    if found.plate is not None:
        v2, v4 = (_number(v.value) for v in found.plate.vignetting)
        values["camera", "vignetting"] = f"{{v2: {v2}, v4: {v4}}}"
    if found.sensor is not None:
        sensor = found.sensor
        for key in ("black_level", "read_noise_levels", "electrons_per_level"):
            measured: Measured = getattr(sensor, key)
            values["camera", "sensor", key] = _number(max(0.0, measured.value))
        if sensor.saturation_level is not None and sensor.saturation_level < 2**rig.camera.sensor.bit_depth - 1:
            values["camera", "sensor", "saturation_level"] = str(math.floor(sensor.saturation_level))
    of_rig = [(name, ends) for name, ends in intervals(found) if not name.startswith("board.")]
    lines = "".join(f"\n    {json.dumps(name)}: [{_number(low)}, {_number(high)}]" for name, (low, high) in of_rig)
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
        ("camera", "distortion"): f"{{{', '.join(f'{k}: {_number(v)}' for k, v in lens.items())}}}",
    }


def _stage_values(found: RigCalibration) -> Values:
    point, direction = found.stage.tilt_axis
    axis = f"{{point_mm: {_vector(point)}, direction: {_vector(direction)}, scale: {_number(found.stage.tilt_scale)}}}"
    rotary = f"{{scale: {_number(found.stage.rotary_scale)}}}"
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
    values: Values = {(*at, "gain"): _number(light.gain)}
    assert found.plate is not None
    if found.plate.fall_off_decided:
        values[(*at, "falloff")] = found.plate.fall_off
    if light.inverse_square:
        values[(*at, "reference_distance_mm")] = _number(light.reference_distance or light.distance)
    if found.plate.emission_fitted:
        values[(*at, "emission_exponent")] = _number(light.emission_exponent)
    return values


def intervals(found: RigCalibration) -> Iterator[tuple[str, Interval]]:
    """95 % interval of each measured value, by a name that says what it is of."""
    if found.board is not None:
        yield from found.board.intervals.items()
    names, covariance = found.covariance
    if found.ball is not None or found.plate is not None:
        half = dict(zip(names, NORMAL_95 * np.sqrt(np.diag(covariance)), strict=True))
        for light in found.lights:
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


def figures(found: RigCalibration) -> dict[str, Any]:
    """JSON form of a calibration, without its covariance."""
    document: dict[str, Any] = {
        "format": "lightopt-calibration/1",
        "rig": {"file": found.rig.source.path.name, "sha256": found.rig.source.sha256},
        "intervals_95": {name: list(ends) for name, ends in intervals(found)},
        "unobservable": list(found.unobservable),
        "warnings": list(found.warnings),
    }
    if (board := found.board) is not None:
        of_board: dict[str, Any] = {
            "views": [
                {
                    "posture": view.posture.as_dict(),
                    "corners": view.corners,
                    "median_px": view.median,
                    "outliers": view.outliers,
                    "faulty": view.faulty,
                }
                for view in board.residuals
            ],
            "freed": list(board.freed),
            "corner_noise_px": board.noise,
            "predicted_rms_px": board.predicted_rms,
            "reading_error_deg": board.angle_error_deg,
        }
        if board.next_posture is not None:
            of_board["next_posture"] = board.next_posture.posture.as_dict()
        document["board"] = of_board
    if found.ball is not None:
        document["ball"] = {
            "radius_mm": found.ball.radius,
            "centre_mm": found.ball.centre.tolist(),
            "rms": found.ball.rms,
            "left_out": [{"posture": posture.as_dict(), "light": name} for posture, name in found.ball.left_out],
        }
    if (plate := found.plate) is not None:
        document["plate"] = {
            "brightness": plate.brightness.value,
            "fall_off": plate.fall_off,
            "fall_off_decided": plate.fall_off_decided,
            "emission_fitted": plate.emission_fitted,
            "rms": plate.rms,
        }
    if (sensor := found.sensor) is not None:
        document["sensor"] = {
            "saturation_level": sensor.saturation_level,
            "linearity_error_percent": sensor.linearity_error if math.isfinite(sensor.linearity_error) else None,
        }
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


def _number(value: float) -> str:
    return f"{value:.9g}"


def _vector(values: Sequence[float] | Any) -> str:
    return f"[{', '.join(_number(float(v)) for v in values)}]"
