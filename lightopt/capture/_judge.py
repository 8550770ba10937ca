"""Judging the images of a run as they come: dark frames are dark, lit ones lit by their light."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.capture._lit import Predictions, check_lit, lights_left_on, predict
from lightopt.capture._shoot import Shot
from lightopt.errors import HardwareError
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene
from lightopt.sensor import Sensor
from lightopt.transforms import Posture

__all__ = ["Judge"]

Float32 = NDArray[np.float32]


class Judge:
    """Holds the prediction of the posture that the stage is at, made while it travels, and the frame without light.

    Parameters
    ----------
    scene
        With all lights of the rig.
    check
        Whether to judge at all.
    """

    def __init__(self, scene: Scene, *, check: bool) -> None:
        self._scene = scene
        self._check = check
        self._caster = cast_rays_at(scene) if check else None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="predict")
        self._predicted: Future[Predictions] | None = None
        self._reference: tuple[Float32, float] | None = None

    @property
    def sensor(self) -> Sensor:
        """The rig's."""
        return self._scene.sensor

    @property
    def has_reference(self) -> bool:
        """Whether a frame without light has been seen."""
        return self._reference is not None

    def begin(self, posture: Posture) -> None:
        """Predict what the lights make of the part in a posture, in a thread of its own."""
        if self._caster is not None:
            self._predicted = self._worker.submit(predict, self._scene, posture, self._caster)

    def dark(self, shot: Shot, exposure: float) -> None:
        """Keep a frame without light, once it shows that no light burns.

        Raises
        ------
        HardwareError
            When it looks like the image of a light.
        """
        if self._predicted is None:
            return
        burning = lights_left_on(
            shot.image.mean,
            predictions=self._predicted.result(),
            sensor=self.sensor,
            exposure=shot.image.exposure,
        )
        if burning is not None:
            raise HardwareError(
                f"the frame without light looks like {burning}, although all channels were switched off; "
                f"check the controller of {burning}"
            )
        self._reference = (shot.image.mean, exposure)

    def judge(
        self,
        light: str,
        posture: Posture,
        exposure: float,
        shot: Shot,
        dark: Mapping[float, Float32],
        warn: Callable[[str], None],
    ) -> dict[str, Any] | None:
        """Check that an image is lit by its light; returns what was found, in JSON form.

        Raises
        ------
        HardwareError
            When it is lit by another light, by two, or by none.
        """
        if self._predicted is None:
            return None
        found = check_lit(
            light,
            shot.image.mean,
            self._dark(dark, exposure),
            predictions=self._predicted.result(),
            sensor=self.sensor,
            exposure=shot.image.exposure,
        )
        if found.problem is not None:
            raise HardwareError(
                f"{found.problem}. The image was not kept; --no-check captures without this check"
            )
        if found.undecided is not None:
            warn(f"{light} {posture}: cannot tell whether the light is the right one: {found.undecided}")
        return found.as_dict()

    def close(self) -> None:
        """Wait for the prediction that is being made."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    def _dark(self, dark: Mapping[float, Float32], exposure: float) -> Float32 | float:
        if exposure in dark:
            return dark[exposure]
        black = self.sensor.black_level
        if self._reference is None:
            return black
        frame, taken_at = self._reference
        return (black + (frame - black) * (exposure / taken_at)).astype(np.float32)
