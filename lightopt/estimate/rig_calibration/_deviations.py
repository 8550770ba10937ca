"""Measured values with their uncertainty; the covariance of a calibrated rig, and the rig displaced along it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.config import RigConfig
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.transforms import rotation_from_vector
from lightopt.scene import PinholeCamera, Stage

NORMAL_95 = 1.959964  # standard errors to each side


@dataclass(frozen=True, kw_only=True)
class Measured:
    value: float
    error: float
    interval_95: tuple[float, float]


def measured(value: float, error: float, *, errors_95: float = NORMAL_95) -> Measured:
    """A value whose interval is so many standard errors to each side."""
    half = errors_95 * error
    return Measured(value=value, error=error, interval_95=(value - half, value + half))


def read_covariance(rig: RigConfig) -> tuple[tuple[str, ...], Float64]:
    """Names of the values of a calibrated rig, and their covariance as `RigCalibration.covariance` has it.

    Without those of values that have no interval in the rig file, where there are intervals: they are no
    longer as measured. Nothing where the rig file has no calibration.
    Raises InputError: The file with the covariance cannot be read
    """
    if rig.calibration is None:
        return (), np.zeros((0, 0))
    path = rig.source.resolve(rig.calibration.covariance)
    try:
        with np.load(path, allow_pickle=False) as arrays:
            names, covariance = tuple(map(str, arrays["names"])), np.asarray(arrays["covariance"], np.float64)
        if covariance.shape != (len(names),) * 2 or not np.isfinite(covariance).all():
            raise ValueError(f"covariance of shape {covariance.shape} for {len(names)} names")
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(
            f"{rig.source.at('calibration', 'covariance')}: {path} is no covariance ({error}); copy it to the "
            "rig file, or remove 'calibration' from that file to take its values as exact"
        ) from None
    intervals = rig.calibration.intervals
    own = [i for i, name in enumerate(names) if name in intervals or not intervals]
    return tuple(names[i] for i in own), covariance[np.ix_(own, own)]


def square_root(covariance: Float64) -> Float64:
    """Independent deviations of one standard deviation each, as columns: A·Aᵀ is the covariance."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


Rig = tuple[PinholeCamera, Stage]


def displaced(camera: PinholeCamera, stage: Stage, names: Sequence[str], deviation: Float64) -> Rig:
    """Camera and stage with a deviation of their measured values, as `BoardFit.names` has them."""
    by = dict(zip(names, deviation.tolist(), strict=True))

    def of(prefix: str, *keys: str) -> Float64:
        return np.array([by.get(f"{prefix}{key}", 0.0) for key in keys])

    axes = np.stack([camera.right, -camera.up, camera.forward], axis=1)
    right, down, forward = (axes @ rotation_from_vector(-np.radians(of("camera.rotation_", *"xyz")))).T
    (focal, aspect), lens = of("camera.", "focal_px", "aspect"), ("k1", "k2", "p1", "p2", "k3")
    own = [getattr(camera.distortion, key) for key in lens] + of("camera.", *lens)
    column, row = np.array(camera.axis_px) + of("camera.principal_", "x_px", "y_px")
    point, direction = stage.tilt_axis
    tilt = np.arcsin(direction[2]) + np.radians(of("tilt_axis.", "elevation")[0])
    azimuth = np.arctan2(direction[1], direction[0])  # 0 in the frame of a calibrated rig
    return replace(
        camera,
        position=camera.position + of("camera.position_", *"xyz"),
        right=right,
        up=-down,
        forward=forward,
        image_distance=camera.image_distance + float(focal) * camera.pixel_size,
        principal_point=(float(column), float(row)),
        aspect=camera.aspect + float(aspect),
        distortion=replace(camera.distortion, **dict(zip(lens, own.tolist(), strict=True))),
    ), replace(
        stage,
        tilt_point=point + of("tilt_axis.position_", *"xyz"),
        tilt_direction=np.array([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)]),
        tilt_scale=stage.tilt_scale + float(of("tilt_axis.", "scale")[0]),
        rotary_scale=stage.rotary_scale + float(of("rotary_axis.", "scale")[0]),
    )


def rig_deviations(camera: PinholeCamera, stage: Stage, names: Sequence[str], covariance: Float64) -> list[Rig]:
    """Camera and stage, displaced by one standard deviation along each independent direction of their covariance.

    names: Of the covariance's values; those of other things are left out
    """
    own = [i for i, name in enumerate(names) if name.startswith(("camera.", "tilt_axis.", "rotary_axis."))]
    columns = square_root(covariance[np.ix_(own, own)]).T
    return [displaced(camera, stage, [names[i] for i in own], column) for column in columns]
