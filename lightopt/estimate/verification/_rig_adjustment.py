"""A calibrated rig as the images of a part show it, within what its calibration leaves open.

The calibration is the prior: Gaussian, with the covariance that the rig file names. The images of a part know most
panels far better than a ball does, since the part's highlights cover many pixels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lightopt.config import RigConfig
from lightopt.core.arrays import Float64
from lightopt.core.run_context import RunContext
from lightopt.estimate.registration import Observation
from lightopt.estimate.verification._fit import FitOptions, descend, fit_faults
from lightopt.estimate.verification._parameters import (
    Parameters,
    VerifyLimits,
    Work,
    calibrated_deviations,
    moved_camera,
    moved_light,
)
from lightopt.lights import PanelLight
from lightopt.scene import Scene, with_reflectances

MISFIT_SHARE = 0.002  # of the level, by which a calibrated rig's images may still be off
UNLIKELY_Z = 5.0  # no direction of a rig that is as it was calibrated is further off than this
BLOCKS = 5000  # of each posture: what single pixels leave open is little then against the noise of a defect's pixels


@dataclass(frozen=True)
class RigAdjustment:
    """By what a calibrated rig, and the reflectance of a part, deviate from their files."""

    parameters: Parameters
    theta: Float64  # of `parameters`, shape (K,)
    # greatest deviation along an independent direction of the calibration, in its standard deviations
    greatest_z: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """None where the rig is as its calibration has it."""
        text = (
            f"the images show a rig {self.greatest_z:.1f} standard deviations from its calibration: it has changed "
            "since; find out what by lightopt verify, and calibrate again"
        )
        return (text,) if self.greatest_z > UNLIKELY_Z else ()

    def applied(self, scene: Scene) -> Scene:
        """The scene with its camera, lights and reflectance adjusted."""

        def adjusted(light: PanelLight) -> PanelLight:
            if light.name not in self.parameters.lights:
                return light
            moved = moved_light(light, self._of("panel_shift", light.name), self._of("panel_turn", light.name))
            return replace(moved, gain=light.gain * self._gain(light.name))

        camera = moved_camera(scene.camera, self._of("camera_shift"), self._of("camera_turn"))
        higher, wider = self._lobe
        reflectances = [replace(one, R_s=one.R_s * higher, sigma=one.sigma * wider) for one in scene.reflectances]
        lights = tuple(adjusted(light) for light in scene.lights)
        return with_reflectances(replace(scene, camera=camera, lights=lights), reflectances)

    def as_dict(self) -> dict[str, Any]:
        higher, wider = self._lobe
        return {
            "greatest_z": round(self.greatest_z, 3),
            "R_s_factor": round(higher, 6),
            "sigma_factor": round(wider, 6),
            "camera": self._motion("camera"),
            "lights": {
                name: {**self._motion("panel", name), "gain_factor": round(self._gain(name), 6)}
                for name in self.parameters.lights
            },
        }

    def _motion(self, body: str, light: str = "") -> dict[str, list[float]]:
        shift, turn = (self._of(f"{body}_{kind}", light) for kind in ("shift", "turn"))
        return {"shift_mm": shift.round(5).tolist(), "turn_deg": np.degrees(turn).round(6).tolist()}

    def _of(self, kind: str, light: str = "") -> Float64:
        return self.theta[self.parameters.group(kind, light).where]

    def _gain(self, light: str) -> float:
        return math.exp(self._of("gain", light)[0])

    @property
    def _lobe(self) -> tuple[float, float]:
        # factors of R_s and σ
        higher, wider = np.exp(self.theta[self.parameters.nuisance[:2]])
        return float(higher), float(wider)


def adjust_rig(
    rig: RigConfig,
    scene: Scene,
    observations: Sequence[Observation],
    *,
    register: bool,
    where: str,
    run: RunContext | None = None,
) -> RigAdjustment:
    """Find the most probable rig within the covariance of its calibration, given images of a part.

    Camera, panels and gains are adjusted, and R_s and σ of the part by a few percent. The part's place and the focus
    are fitted with them, and left as they are. Robust against defects.

    scene: With the lights and postures of the observations.
    register: Whether the part's place is fitted, too; else it lies where its file has it.
    where: The set, for messages.
    Raises InputError: The covariance cannot be read, images that show nothing, or that are not this part's
    """
    parameters = Parameters.of(scene, VerifyLimits())
    deviations = calibrated_deviations(rig, scene, parameters)
    work = Work(scene, parameters, run or RunContext())
    free = parameters.part_groups(scene.freedoms) if register else ()
    images = work.blocks(observations)
    # few blocks find the part, many the rig; the flanks of highlights say most about it
    few = FitOptions(deviations=deviations, groups=free, misfit_share=MISFIT_SHARE, steepest=math.inf, settled=0.5)
    near = fit_faults(work, images, options=few, where=where, register=register)
    many = replace(few, blocks=BLOCKS, most_steps=2, settled=0.0)
    fit = descend(work, images, None, many, np.zeros(parameters.size), near.theta)
    of_rig = fit.theta - fit.faults
    coefficients = np.linalg.lstsq(deviations, of_rig, rcond=1e-9)[0]
    theta = of_rig.copy()
    theta[parameters.nuisance] = fit.theta[parameters.nuisance]
    return RigAdjustment(parameters, theta, float(np.abs(coefficients).max(initial=0.0)))
