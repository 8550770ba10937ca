"""A camera's exposure time in microseconds, whatever the camera counts it in."""

from __future__ import annotations

from lightopt.core.errors import InputError
from lightopt.rig.devices._camera_sdk import CameraSdk, first_of
from lightopt.rig.devices._camera_settings import CameraSettings

_FEATURES = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
_RAW = "ExposureTimeRaw"
_BASE = "ExposureTimeBaseAbs"
_MICROSECONDS = {"us": 1.0, "µs": 1.0, "\u03bcs": 1.0, "usec": 1.0, "ns": 1e-3, "ms": 1e3, "s": 1e6}
_TOLERANCE = 1e-6


class ExposureTime:
    """The exposure time of a camera, told and read back in microseconds.

    ``ExposureTime`` and ``ExposureTimeAbs`` are microseconds unless the camera names another unit. ``ExposureTimeRaw``
    counts units that only the camera knows: it names them, or ``ExposureTimeBaseAbs`` is their length [µs]; a camera
    that says neither cannot be told an exposure time.

    Parameters
    ----------
    sdk
        The opened camera.
    settings
        With the exposure time of a camera that cannot be told one.

    Raises
    ------
    InputError
        When the time that it exposes is not known.
    """

    def __init__(self, sdk: CameraSdk, settings: CameraSettings) -> None:
        self._sdk = sdk
        self._where = settings.where
        feature = first_of(sdk, *_FEATURES)
        unit_us = None if feature is None else _unit_us(sdk, feature)
        self._feature = None if unit_us is None else feature
        self._unit_us = unit_us or 1.0
        fixed = settings.fixed_exposure_us
        if self._feature is None and fixed is None:
            why = (
                "cannot be told an exposure time"
                if feature is None
                else f"counts its exposure time ({feature}) in units of which it does not say how long they are"
            )
            raise InputError(
                f"{self._where}: this camera {why}; write fixed_exposure_us, the time that it is set to otherwise"
            )
        if self._feature is not None and fixed is not None:
            raise InputError(
                f"{self._where}: this camera is told its exposure time ({self._feature}); leave out fixed_exposure_us"
            )
        self.held_us = fixed if fixed is not None else self.read_us()
        """What the camera held when it was last told or asked [µs]."""

    @property
    def range_us(self) -> tuple[float, float]:
        """Shortest and longest exposure time [µs]."""
        if self._feature is None:
            return self.held_us, self.held_us
        low, high, _ = self._sdk.bounds(self._feature)
        return low * self._unit_us, high * self._unit_us

    def read_us(self) -> float:
        """What the camera holds [µs]."""
        if self._feature is None:
            return self.held_us
        return self._sdk.number(self._feature) * self._unit_us

    def tell_us(self, exposure_us: float) -> float:
        """Tell the camera an exposure time [µs], and return what it then holds.

        Raises
        ------
        InputError
            When it lies outside the camera's range; nothing was sent.
        """
        low, high = self.range_us
        if not low * (1 - _TOLERANCE) <= exposure_us <= high * (1 + _TOLERANCE):
            raise InputError(
                f"{self._where}: expected an exposure of {low:g} to {high:g} µs, found {exposure_us:g} µs"
            )
        if self._feature is not None:
            self._sdk.set_number(self._feature, min(max(exposure_us, low), high) / self._unit_us)
            self.held_us = self.read_us()
        return self.held_us


def _unit_us(sdk: CameraSdk, feature: str) -> float | None:
    """How many microseconds a camera's number stands for; None where it does not say."""
    unit = sdk.unit(feature)
    if unit:
        return _MICROSECONDS.get(unit.lower())
    if feature != _RAW:
        return 1.0
    # https://www.easymanua.ls/basler/scout-gige/manual?p=152
    return sdk.number(_BASE) if sdk.has(_BASE) else None
