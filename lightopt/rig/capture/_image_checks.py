"""Check the images of a run as they come: dark frames must be dark, the others lit by their light."""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from lightopt.core.arrays import Float32
from lightopt.core.errors import HardwareError
from lightopt.core.transforms import Posture
from lightopt.optics import Sensor
from lightopt.rendering import cast_rays_at
from lightopt.rig.capture._acquisition import AcquiredImage
from lightopt.rig.capture._exposures import ExposureImage, exposure_mismatch
from lightopt.rig.capture._light_checks import PredictedImages, check_light, find_light_left_on, predict
from lightopt.scene import Scene

AMBIENT_LEVELS = 0.5  # ambient light that shifts levels by more than this causes a warning [sensor level]


class ImageChecker:
    """Checks images as they come, with predictions of the latest postures, computed while the stage travels.

    `with_dark`: Whether the set has frames without light, so that ambient light is known.
    """

    def __init__(self, scene: Scene, *, check: bool, with_dark: bool) -> None:
        self._with_dark = with_dark
        self._scene, self._sensor = scene, scene.sensor
        self._check = check
        self._caster = cast_rays_at(scene) if check else None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="predict")
        self._predicted: dict[Posture, Future[PredictedImages]] = {}
        self._reference: dict[float, Float32] = {}

    def has_dark_reference(self, exposure: float) -> bool:
        """Whether a frame without light has been seen at an exposure."""
        return not self._check or exposure in self._reference

    def predict(self, posture: Posture) -> None:
        """Predict the images of all lights in a posture, in a thread of its own.

        The prediction of the previous posture is kept: its last frames may not have been checked yet.
        """
        if self._caster is not None:
            before = list(self._predicted.items())[-1:]
            predicted = self._worker.submit(predict, self._scene, posture, self._caster)
            self._predicted = dict([*before, (posture, predicted)])

    def set_dark_reference(self, dark: Float32, exposure: float) -> None:
        """Set the reference for frames without light [sensor level], (H, W): one of a previous run."""
        self._reference.setdefault(exposure, dark)

    def check_dark(self, acquired: AcquiredImage, warn: Callable[[str], None]) -> None:
        """Check that no light is on in a frame without light; the first one at its exposure becomes the reference.

        HardwareError when it looks like the image of a light.
        """
        if not self._check:
            return
        image, first = acquired.image, self._reference.get(acquired.exposure)
        light = find_light_left_on(
            image.mean,
            predictions=self._predicted[acquired.posture].result(),
            sensor=self._sensor,
            exposure=image.exposure,
            before=first,
        )
        if light is not None:
            raise HardwareError(
                f"the frame without light looks like {light}, although all channels were switched off; "
                f"check the controller of {light}"
            )
        if first is None:
            self._reference[acquired.exposure] = image.mean
            above = float(image.mean.mean()) - self._sensor.black_level
            if not self._with_dark and above > AMBIENT_LEVELS + clipped_mean(self._sensor):
                warn(
                    f"without any light the image is {above:.2g} levels above black at exposure {acquired.exposure:g}: "
                    "capture dark frames as well, or darken the room, or correct black_level"
                )

    def check(
        self,
        acquired: AcquiredImage,
        dark: Mapping[float, Float32],
        others: Mapping[float, ExposureImage],
        warn: Callable[[str], None],
    ) -> dict[str, Any] | None:
        """Check that an image is lit by its light; returns the findings in JSON form.

        HardwareError when it is lit by another light, by two, or by none, or not as at its other exposures.
        """
        if not self._check:
            return None
        light, image, own_dark = acquired.light, acquired.image, self._dark(dark, acquired.exposure)
        assert light is not None
        where = f"{light} {acquired.posture}"
        found = check_light(
            light,
            image.mean,
            own_dark,
            predictions=self._predicted[acquired.posture].result(),
            sensor=self._sensor,
            exposure=image.exposure,
        )
        problem = found.problem
        for exposure, other in others.items():
            darks = (own_dark, self._dark(dark, exposure))
            problem = problem or exposure_mismatch(light, image, other, darks=darks, sensor=self._sensor)
        if problem is not None:
            stop = "" if problem.endswith("?") else "."
            raise HardwareError(
                f"{where} at exposure {acquired.exposure:g}: {problem}{stop} The image was not kept; "
                "this check of the lights can be switched off"
            )
        if found.undecided is not None and not others:
            warn(f"{where}: whether it is lit by the right light is undecided: {found.undecided}")
        return found.as_dict()

    def close(self) -> None:
        """Wait for the prediction that is being computed."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    def _dark(self, dark: Mapping[float, Float32], exposure: float) -> Float32 | float:
        return dark.get(exposure, self._reference.get(exposure, self._sensor.black_level))


def clipped_mean(sensor: Sensor) -> float:
    """How far read noise, clipped at level 0, lifts the mean level of a dark frame above black."""
    noise = sensor.read_noise_levels
    z = sensor.black_level / noise if noise else np.inf
    density = np.exp(-0.5 * min(z, 40.0) ** 2) / np.sqrt(2.0 * np.pi)
    return float(noise * density)
