"""A calibrated rig as the images of a part show it, within what its calibration leaves open.

The calibration is the prior: Gaussian, with the covariance that the rig file names. The images of a part know most
panels far better across the line of sight than a ball does, since highlights cover many pixels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lightopt.config import RigConfig
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.estimate.registration import Observation
from lightopt.estimate.verification._fit import FitOptions, descend, fit_faults
from lightopt.estimate.verification._parameters import NUISANCE, Parameters, VerifyLimits, Work, calibrated_deviations
from lightopt.scene import Scene

MISFIT_SHARE = 0.002  # of the level, by which a calibrated rig's images may still be off
# of each posture, and of all postures and lights: what single pixels leave open is little then against the noise of a
# defect's pixels
BLOCKS, ROWS = 5000, 160_000
# greatest distance from the calibration, and of ln R_s and ln σ from the part file, in standard deviations: a right
# calibration exceeds it for a body of six values with a probability of 3e-6
UNLIKELY_Z = 6.0
# by which all corners of a calibration's board may be off together, as its covariance does not say: an image may lie
# aside by as much, or turned so far that its edges do
COMMON_PX = 0.1
PART_PRIORS = {"part_shift": 5.0, "part_turn": math.radians(6.0)}  # as far as registration searches [mm], [rad]


@dataclass(frozen=True)
class RigAdjustment:
    """By what a calibrated rig, and the reflectance of a part, deviate from their files."""

    parameters: Parameters
    theta: Float64  # of `parameters`, shape (K,)
    greatest_z: float  # of the camera and the lights, distance from the calibration in its standard deviations

    @property
    def warnings(self) -> tuple[str, ...]:
        """Empty if rig and part are as their files have them."""
        found: list[str] = []
        if self.greatest_z > UNLIKELY_Z:
            found.append(
                f"the images show a rig {self.greatest_z:.1f} standard deviations from its calibration: it has changed "
                "since; find out what by lightopt verify, and calibrate again"
            )
        off = np.abs(self.theta[self.parameters.nuisance[:2]]) / list(NUISANCE.values())[:2]
        if off.max() > UNLIKELY_Z:
            r_s, sigma = self.parameters.lobe_factors(self.theta)
            found.append(
                f"the images show R_s {r_s:.3g} times and sigma {sigma:.3g} times as large as the part file, which are "
                "used: a part that is worn or hazy all over looks good; fit the reflectance again to a good part"
            )
        return tuple(found)

    def apply(self, scene: Scene) -> Scene:
        """The scene with its camera, lights and reflectance adjusted."""
        moved = self.parameters.moved(self.parameters.reflecting(scene, self.theta), self.theta)
        known = self.parameters.lights
        lights = [replace(x, gain=x.gain * self._gain(x.name)) if x.name in known else x for x in moved.lights]
        return replace(moved, lights=tuple(lights))

    def as_dict(self) -> dict[str, Any]:
        r_s, sigma = self.parameters.lobe_factors(self.theta)
        return {
            "greatest_z": round(self.greatest_z, 3),
            "R_s_factor": round(r_s, 6),
            "sigma_factor": round(sigma, 6),
            "camera": self._motion("camera"),
            "lights": {
                name: {**self._motion("panel", name), "gain_factor": round(self._gain(name), 6)}
                for name in self.parameters.lights
            },
        }

    def _motion(self, body: str, light: str = "") -> dict[str, list[float]]:
        shift, turn = (self.parameters.values(self.theta, f"{body}_{kind}", light) for kind in ("shift", "turn"))
        return {"shift_mm": shift.round(5).tolist(), "turn_deg": np.degrees(turn).round(6).tolist()}

    def _gain(self, light: str) -> float:
        return math.exp(self.parameters.values(self.theta, "gain", light)[0])


def adjust_rig(
    rig: RigConfig, scene: Scene, observations: Sequence[Observation], *, register: bool, run: RunContext | None = None
) -> RigAdjustment | None:
    """Find the most probable rig within the covariance of its calibration, given images of a part.

    Camera, lights, gains, and R_s and σ of the part are adjusted. The part's place, the exposure, the black level,
    lamps that are brighter or darker, and the focus are fitted as well, and left to the inspection. Robust against
    defects of a small share of the surface.

    scene: With the lights and postures of the observations.
    register: Whether the part's place is fitted, too; else it lies where its file has it.

    None if neither camera nor lights were calibrated, and, with a warning, if the images do not determine the rig.
    Raises InputError: The covariance cannot be read
    """
    run = (run or RunContext()).within("adjusting the rig")
    parameters = Parameters.of(scene, VerifyLimits())
    groups = tuple(replace(g, prior=PART_PRIORS.get(g.kind, g.prior)) for g in parameters.groups)
    parameters = replace(parameters, groups=groups)
    deviations = calibrated_deviations(rig, scene, parameters)
    if not deviations.any():
        return None
    free = [g for g in parameters.groups if g.kind in ("exposure", "black", "gain")]
    if register:
        free += parameters.part_groups(scene.freedoms)
    # few blocks find the part, many the rig; the flanks of highlights say most about it
    coarse = FitOptions(
        deviations=deviations, groups=tuple(free), misfit_share=MISFIT_SHARE, steepest=math.inf, settled=0.5
    )
    fine = replace(coarse, blocks=BLOCKS, rows=ROWS, few_steps=0, most_steps=2, settled=0.0)
    work = Work(scene, parameters, run)
    images = work.blocks(observations)
    where = str(observations[0].source.parent)
    try:
        start = fit_faults(work, images, options=coarse, where=where, register=register).theta
        fit = descend(work, images, None, fine, np.zeros(parameters.size), start)
    except InputError as error:
        run.warn(f"the calibrated rig is not adjusted to the images: {error}")
        return None
    theta = fit.theta - fit.faults
    greatest = _greatest_z(parameters, np.concatenate([deviations, _common_errors(scene, parameters)], axis=1), theta)
    theta[parameters.nuisance] = fit.theta[parameters.nuisance]
    return RigAdjustment(parameters, theta, greatest)


def _common_errors(scene: Scene, p: Parameters) -> Float64:
    # of the camera's direction, one standard deviation each, as columns, shape (K, 3)
    camera, found = scene.camera, np.zeros((p.size, 3))
    along = COMMON_PX * camera.pixel_size / camera.image_distance
    found[p.group("camera_turn").where] = np.diag([along, along, COMMON_PX / (0.5 * camera.width)])
    return found


def _greatest_z(parameters: Parameters, deviations: Float64, theta: Float64) -> float:
    # Mahalanobis distance of the camera, or of the light that is furthest
    bodies: dict[str, list[int]] = {}
    for group in parameters.groups:
        if group.light or group.kind.startswith("camera"):
            bodies.setdefault(group.light, []).extend(range(group.first, group.where.stop))
    found = 0.0
    for at in bodies.values():
        unit = np.linalg.norm(deviations[at], axis=1)
        known, unit = np.array(at)[unit > 0.0], unit[unit > 0.0]
        values, vectors = np.linalg.eigh((deviations[known] @ deviations[known].T) / np.outer(unit, unit))
        along = vectors.T @ (theta[known] / unit)
        left_open = values > 1e-9
        found = max(found, float(np.sqrt(np.sum(np.square(along[left_open]) / values[left_open]))))
    return found
