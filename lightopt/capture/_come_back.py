"""Whether the stage comes back to where it was: two images of one posture, one light and one exposure, at two times.

A stepper that lost steps stands elsewhere than it says, and no driver can tell. Two images of the same posture do: they
differ when the part has turned between them. Whether it has is told by the two images alone, whatever the reflectance
and wherever the part lies in its fixture; by how much, and about which axis, is told with the prediction of how an
image changes by a degree, and only as well as the part file's reflectance is that of the part.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.capture._lit import Predictions, cells, predict
from lightopt.raycast import RayCaster
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene
from lightopt.transforms import Posture

__all__ = ["CameBack", "came_back"]

Float64 = NDArray[np.float64]

STEP_DEG = 0.5
"""Predictions this far to both sides say how the image changes."""

FINER = 3
"""Predictions have so many rays across a cell: outlines cross cells."""

OFF_DEG = 0.2
"""From here on it is told."""

CERTAIN = 5.0
"""And only if it is this many of its standard errors: an axis of symmetry turns nothing that can be seen."""

LIT = 0.2
"""The part's brightness is that of cells that are predicted brighter than this share of the median."""

LEAST_CELLS = 50
ROUNDS = 10
BOUNDED = 0.1
"""Differences beyond this share of the part's brightness pull no more than these: highlights are not well predicted."""


@dataclass(frozen=True, kw_only=True)
class CameBack:
    """How far the part has turned between two images.

    Attributes
    ----------
    tilt_deg, turn_deg
        About the tilt axis and the rotary axis, in the sense of elevation and rotation [°].
    tilt_error_deg, turn_error_deg
        Standard errors [°]; those of an axis that cannot be seen are large.
    """

    tilt_deg: float
    turn_deg: float
    tilt_error_deg: float
    turn_error_deg: float

    @property
    def off(self) -> str | None:
        """What stands elsewhere, in words; None where nothing does for certain."""
        said = [
            f"its {axis} by about {angle:+.2f}°"
            for axis, angle, error in (
                ("elevation", self.tilt_deg, self.tilt_error_deg),
                ("rotation", self.turn_deg, self.turn_error_deg),
            )
            if abs(angle) > max(OFF_DEG, CERTAIN * error)
        ]
        return " and ".join(said) or None

    @property
    def unseen(self) -> str:
        """Angles of which the images cannot say to `OFF_DEG` whether they changed; empty where there is none."""
        errors = (("elevation", self.tilt_error_deg), ("rotation", self.turn_error_deg))
        return " and ".join(name for name, error in errors if CERTAIN * error > OFF_DEG)

    def as_dict(self) -> dict[str, float]:
        """JSON form."""
        return {name: float(f"{value:.3g}") for name, value in vars(self).items()}


def came_back(
    first: NDArray[Any],
    last: NDArray[Any],
    *,
    light: str,
    posture: Posture,
    exposure: float,
    scene: Scene,
) -> CameBack | None:
    """How far the part has turned between two images of the same posture; None where too little of it shows.

    Parameters
    ----------
    first, last
        [sensor level], shape (H, W).
    light
        That burned for both.
    posture
        Where the stage said that it stood for both.
    exposure
        Relative exposure of both.
    scene
        With that light among its lights.
    """
    caster = cast_rays_at(scene)
    alone = replace(scene, lights=tuple(one for one in scene.lights if one.name == light))

    def seen_at(tilt_deg: float, turn_deg: float) -> Predictions:
        return _fine(
            alone, Posture(posture.elevation_deg + tilt_deg, posture.rotation_deg + turn_deg), caster
        )

    here = seen_at(0.0, 0.0)
    room = scene.sensor.saturated_from
    before, after = cells(first, here), cells(last, here)
    # a cell with a pixel that is saturated in one of them says too little, and one that was predicted so may be such
    full = np.maximum(cells(first >= room, here), cells(last >= room, here)) > 0.0
    predicted = here.levels[light] * exposure
    usable = ~full & (predicted + scene.sensor.black_level < room)
    shown = usable & here.part
    lit = shown & (predicted > LIT * float(np.median(predicted[shown]))) if shown.any() else shown
    if int(lit.sum()) < LEAST_CELLS:
        return None
    above = before - scene.sensor.black_level
    typical = float(np.median(above[lit]))
    if typical < 3.0 * max(1.0, scene.sensor.read_noise_levels):
        return None  # too dark to say anything
    share = typical / float(np.median(predicted[lit]))
    slopes = [
        share * exposure * (more.levels[light] - less.levels[light])[usable] / (2.0 * STEP_DEG)
        for more, less in (
            (seen_at(STEP_DEG, 0.0), seen_at(-STEP_DEG, 0.0)),
            (seen_at(0.0, STEP_DEG), seen_at(0.0, -STEP_DEG)),
        )
    ]
    # the lamp may have become a little brighter or darker meanwhile
    columns = np.stack([*slopes, above[usable], np.ones(int(usable.sum()))], axis=1)
    change, errors = _robust_fit(columns, (after - before)[usable], bound=BOUNDED * typical)
    return CameBack(
        tilt_deg=float(change[0]),
        turn_deg=float(change[1]),
        tilt_error_deg=float(errors[0]),
        turn_error_deg=float(errors[1]),
    )


def _fine(scene: Scene, posture: Posture, caster: RayCaster) -> Predictions:
    """As :func:`predict`, with several rays across each cell."""
    plain = predict(scene, posture, caster, finer=FINER)
    rows, columns = (length // FINER for length in plain.part.shape)
    return Predictions(
        cell=plain.cell,
        levels={
            name: level.reshape(rows, FINER, columns, FINER).mean(axis=(1, 3))
            for name, level in plain.levels.items()
        },
        part=np.asarray(plain.part.reshape(rows, FINER, columns, FINER).any(axis=(1, 3)), np.bool_),
    )


def _robust_fit(columns: Float64, values: Float64, *, bound: float) -> tuple[Float64, Float64]:
    """Least squares with bounded pull (Huber 1964, doi:10.1214/aoms/1177703732); the parameters, and their errors."""
    scale = np.sqrt(np.maximum(np.mean(columns**2, axis=0), 1e-12))
    unit = columns / scale
    found = np.zeros(columns.shape[1])
    weight = np.ones(len(values))
    for _ in range(ROUNDS):
        normal = (unit * weight[:, None]).T @ unit + 1e-9 * len(values) * np.eye(unit.shape[1])
        found = np.linalg.solve(normal, (unit * weight[:, None]).T @ values)
        weight = np.minimum(1.0, bound / np.maximum(np.abs(values - unit @ found), 1e-12))
    pull = weight * (values - unit @ found)
    inner = np.linalg.inv((unit * weight[:, None]).T @ unit + 1e-9 * len(values) * np.eye(unit.shape[1]))
    spread = inner @ ((unit * np.square(pull)[:, None]).T @ unit) @ inner
    return found / scale, np.sqrt(np.maximum(np.diag(spread), 0.0)) / scale
