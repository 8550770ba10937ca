"""Repeatability of the stage: two images of one posture, one light and one exposure, taken at two times.

A stepper that lost steps does not stand where its driver reports it. The two images differ when the part has turned
between them, whatever the reflectance and wherever the part lies in its fixture. The angle and its axis come from a
prediction of how the image changes per degree. The angle is rough and rather too small, because edges are never exactly
where they were predicted.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float64
from lightopt.core.least_squares import HUBER, Limits, linear_problem, solve
from lightopt.core.transforms import Posture
from lightopt.rendering import cast_rays_at
from lightopt.rig.capture._image_checks import PredictedImages, cells, predict
from lightopt.scene import Scene, with_reflectances

STEP_DEG = 0.5  # predictions this far to both sides give the change of the image per degree
FINER = 3  # rays across a cell of the predictions: outlines cross cells
REPORTED_DEG = 0.1  # least angle that is reported
UNOBSERVABLE_DEG = 0.5  # an axis that could deviate by more than this unnoticed is reported as unobservable
CERTAIN = 5.0  # least multiple of its standard error at which an angle is reported: an axis of symmetry shows nothing
LIT = 0.2  # the part's brightness is that of cells predicted brighter than this share of the median
HIGHLIGHT = 1.5  # cells brighter than this multiple of the brightest diffuse light show something else
MOST_DEG = 10.0  # greatest angle that is found: the prediction is linear, from half a degree to both sides

LEAST_CELLS = 50
# differences beyond this share of the part's brightness pull no more than these: highlights are not well predicted
BOUNDED = 0.1


@dataclass(frozen=True, kw_only=True)
class Repeatability:
    """Rotation of the part between two images, in the sense of elevation (tilt) and rotation (turn) [°]."""

    tilt_deg: float
    turn_deg: float
    tilt_error_deg: float  # standard error [°]; large where the axis is unobservable
    turn_error_deg: float  # the same
    converged: bool = True  # whether the comparison found its optimum; if not, the angles mean nothing

    @property
    def deviation(self) -> str | None:
        """Message about the axes that certainly deviate; None where none does."""
        if not self.converged:
            return None
        texts = [
            f"its {axis} by roughly {angle:+.1f}°"
            for axis, angle, error in (
                ("elevation", self.tilt_deg, self.tilt_error_deg),
                ("rotation", self.turn_deg, self.turn_error_deg),
            )
            if abs(angle) > max(REPORTED_DEG, CERTAIN * error)
        ]
        return " and ".join(texts) or None

    @property
    def unobservable(self) -> str:
        """Axes of which the images would not show `UNOBSERVABLE_DEG`; empty where there is none."""
        errors = (("elevation", self.tilt_error_deg), ("rotation", self.turn_error_deg))
        return " and ".join(name for name, error in errors if CERTAIN * error > UNOBSERVABLE_DEG)

    def as_dict(self) -> dict[str, float | bool]:
        return {name: value if isinstance(value, bool) else float(f"{value:.3g}") for name, value in vars(self).items()}


def measure_repeatability(
    first: NDArray[Any], last: NDArray[Any], *, light: str, posture: Posture, scene: Scene
) -> Repeatability | None:
    """Rotation of the part between two images of the same posture; None where too little of it shows.

    `first` and `last` are of one exposure [sensor level], shape (H, W), both under `light`, which is among the scene's.
    `posture` is what the stage reported for both.
    """
    caster = cast_rays_at(scene)
    # highlights are where the reflectance puts them; diffuse light and outlines are where the part is
    most = max(one.R_d for one in scene.reflectances)
    diffuse = [replace(one, R_d=one.R_d / most if most > 0.0 else 1.0, R_s=0.0) for one in scene.reflectances]
    alone = replace(with_reflectances(scene, diffuse), lights=tuple(one for one in scene.lights if one.name == light))

    def predict_at(tilt_deg: float, turn_deg: float) -> PredictedImages:
        there = Posture(posture.elevation_deg + tilt_deg, posture.rotation_deg + turn_deg)
        return predict(alone, there, caster, supersample=FINER)

    here = predict_at(0.0, 0.0)
    sides = [
        (predict_at(STEP_DEG, 0.0), predict_at(-STEP_DEG, 0.0)),
        (predict_at(0.0, STEP_DEG), predict_at(0.0, -STEP_DEG)),
    ]
    black, room = scene.sensor.black_level, scene.sensor.saturated_from
    before, after = cells(first, here), cells(last, here)
    usable = (cells(first >= room, here) == 0.0) & (cells(last >= room, here) == 0.0)
    shown = usable & here.part
    predicted = here.levels[light]
    lit = shown & (predicted > LIT * float(np.median(predicted[shown]))) if shown.any() else shown
    if int(lit.sum()) < LEAST_CELLS:
        return None
    above = before - black
    typical, share = float(np.median(above[lit])), float(np.median(above[lit] / predicted[lit]))
    if typical < 3.0 * max(1.0, scene.sensor.read_noise_levels):
        return None  # too dark for any conclusion
    usable &= np.maximum(above, after - black) < HIGHLIGHT * max(typical, share * float(predicted.max()))
    slopes = [share * (more.levels[light] - less.levels[light])[usable] / (2.0 * STEP_DEG) for more, less in sides]
    # the lamp may have become a little brighter or darker meanwhile
    columns = np.stack([*slopes, above[usable], np.ones(int(usable.sum()))], axis=1)
    # a few edges, which are steep and nowhere just where they were predicted, would outweigh all the rest
    steep = np.abs(slopes[0]) + np.abs(slopes[1])
    weight = np.minimum(1.0, typical / np.maximum(steep, 1e-12)) ** 2
    return _fit_rotation(columns, (after - before)[usable], weight, typical=typical)


def _fit_rotation(columns: Float64, change: Float64, weight: Float64, *, typical: float) -> Repeatability:
    """Fit changes of level, shape (N,), by columns (N, 4): per degree of tilt and turn, lamp, and offset."""
    unit = BOUNDED * typical / HUBER
    reach = np.array([MOST_DEG, MOST_DEG, 1.0, typical])
    limits = Limits(
        nominal=np.zeros(4),
        reach=reach,
        step=reach,
        # all but nothing, and an error of MOST_DEG for an angle that changes no cell
        prior=np.array([MOST_DEG, MOST_DEG, np.inf, np.inf]),
        # nothing is held at 0: errors show what is observable, and they come from the scatter, not from the bound
        resolution=np.full(4, np.inf),
    )
    problem = linear_problem(columns / unit, change / unit, weight)
    found = solve(problem, limits.nominal, limits, loss="huber", least_spread=1.0)
    return Repeatability(
        tilt_deg=float(found.x[0]),
        turn_deg=float(found.x[1]),
        tilt_error_deg=float(found.errors[0]),
        turn_error_deg=float(found.errors[1]),
        converged=found.converged,
    )
