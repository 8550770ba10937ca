"""What the driver of a camera implements (:class:`CameraSdk`): features by their standard names, and frames."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from lightopt.core.arrays import UInt8
from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices._device import LinkLostError

_SLICE_S = 0.1  # longest single wait for a frame: signals are heard between two
Value = TypeVar("Value")


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """Settings of a camera that the rig needs; what is None stays as the camera has it."""

    where: str  # what messages call it, with file and line
    resolution_px: tuple[int, int]
    bit_depth: int
    port: str | None = None  # serial number, address or identifier; None: the only camera that there is
    producer: str | None = None  # genicam: GenTL producer of the maker (a .cti file)
    pixel_format: str | None = None  # None: the camera's that has the bit depth
    offset_px: tuple[int, int] | None = None  # corner of the image on the sensor, from left and top; None: centred
    gain: float | None = None  # in the camera's units (mostly dB)
    trigger: str = "auto"  # software, none, or auto: software where the camera has it
    fixed_exposure_us: float | None = None  # exposure time [µs] of a camera on which it cannot be set
    packet_size: int | None = None  # GigE: size of packets [bytes]
    packet_delay_ns: int | None = None  # GigE: pause between packets [ns]


@dataclass(frozen=True)
class CameraInfo:
    """A camera that answered; `identifier`, `serial` or `address` name it in a rig file, empty where it has none."""

    driver: str
    identifier: str
    serial: str = ""
    address: str = ""
    model: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for name in (self.serial, self.address, self.identifier) if name)

    def __str__(self) -> str:
        return f"{self.model or self.identifier} ({', '.join(dict.fromkeys(self.names))})"


def choose_camera(here: list[CameraInfo], settings: CameraSettings) -> CameraInfo:
    """The camera that the settings name; an InputError when it is not there, or which of several is unclear."""
    there = "; there is " + (", ".join(map(str, here)) or "none") + " (lightopt bench devices lists them)"
    if settings.port is None:
        if len(here) == 1:
            return here[0]
        many = "which of the cameras is meant is not specified: write its serial number as `port`"
        raise InputError(f"{settings.where}: {many if here else 'no camera answers'}{there}")
    found = [camera for camera in here if settings.port in camera.names]
    if len(found) != 1:
        raise InputError(f"{settings.where}: no camera {settings.port}{there}")
    return found[0]


@dataclass(frozen=True, kw_only=True)
class RawFrame:
    """A frame as it came over the cable; number and time stamp are the camera's own, None where it has none."""

    data: UInt8  # its bytes, shape (n,)
    width: int
    height: int
    number: int | None
    code: int | None = None  # its pixel format in the naming convention; None where the camera does not report it
    timestamp_ns: int | None = None
    problem: str | None = None  # why it is unusable; None when it is whole

    @classmethod
    def unusable(cls, number: int | None, problem: str) -> "RawFrame":
        return cls(data=np.zeros(0, np.uint8), width=0, height=0, number=number, problem=problem)

    @property
    def name(self) -> str:
        return "a frame without a number" if self.number is None else f"frame {self.number}"


class CameraSdk(Protocol):
    """An opened camera. Features have the names of GenICam's Standard Features Naming Convention (SFNC).

    Every method raises :class:`~lightopt.core.errors.HardwareError` when the camera does not answer or refuses, and
    :class:`~lightopt.rig.devices.LinkLostError` when it is gone; `close` never raises.
    """

    @property
    def details(self) -> dict[str, str]: ...  # maker, model, serial number, address, as far as they are known
    def has(self, feature: str) -> bool: ...  # and it can be used as things are
    def read(self, feature: str, kind: Callable[[Any], Value]) -> Value: ...
    def write(self, feature: str, value: float | str | bool) -> None: ...  # rounded where the feature is whole
    def bounds(self, feature: str) -> tuple[float, float, float]: ...  # lowest, highest, step between (0: any)
    def unit(self, feature: str) -> str: ...  # of a number (us, dB); empty where the camera gives none
    def entries(self, feature: str) -> tuple[str, ...]: ...  # of an enumeration, those that can be chosen
    def execute(self, feature: str) -> None: ...
    def start(self) -> None: ...  # no frame of a previous acquisition is delivered afterwards
    def stop(self) -> None: ...
    def pop(self, timeout_s: float) -> RawFrame | None: ...  # the next, whole or not; None when none came in time
    def close(self) -> None: ...


class CameraLibrary(ABC):
    """Calls of a camera's library: its errors become ours, and a camera that is gone is not queried again."""

    _failure: type[Exception] = Exception  # errors of the library

    def __init__(self, where: str) -> None:
        self._where = where
        self._lost: str | None = None

    def pop(self, timeout_s: float) -> RawFrame | None:
        end = time.monotonic() + timeout_s
        while True:
            left_s = min(end - time.monotonic(), _SLICE_S)
            if (frame := self._fetch(left_s)) is not None or left_s <= 0:
                return frame

    def _try(self, what: str, action: Callable[[], Value]) -> Value:
        if self._lost is not None:  # each query would take seconds
            raise LinkLostError(self._lost)
        try:
            return action()
        except self._failure as error:
            message = getattr(error, "message", error)
            if self._is_gone(error):
                self._lost = f"{self._where}: {what}: the camera does not answer any more: {message}"
                raise LinkLostError(self._lost) from error
            raise HardwareError(f"{self._where}: {what}: {message}") from error

    @abstractmethod
    def _fetch(self, timeout_s: float) -> RawFrame | None:
        """The next frame, waited for at most so long [s]; without waiting where that is 0 or less."""

    @abstractmethod
    def _is_gone(self, error: Exception) -> bool:
        """Whether the camera is gone, after an error of the library."""
