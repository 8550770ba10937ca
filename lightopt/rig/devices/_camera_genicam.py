"""Cameras of any maker through the maker's GenTL producer. The one home of harvesters and genicam."""

import os
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices._camera_sdk import CameraInfo, CameraLibrary, CameraSettings, RawFrame, Value, choose_camera

_BUFFERS = 4
# Errors of reading a register when the camera does not answer; other errors (no such address) are an answer.
_GONE = ("IoException", "TimeoutException", "InvalidHandleException", "ClosedException")


def load_harvester() -> Any:
    """Class of the library that opens producers; an InputError with how to install it when it is not there."""
    try:
        return import_module("harvesters.core").Harvester
    except ImportError as error:
        how = f"the library is not there ({error}); pip install 'lightopt[genicam]'"
        raise InputError(f"camera driver genicam: {how}") from None


def find_producers() -> list[Path]:
    """GenTL producers that makers' installers have named in GENICAM_GENTL64_PATH."""
    folders = os.environ.get("GENICAM_GENTL64_PATH", "").split(os.pathsep)
    return sorted(path for folder in folders if folder for path in Path(folder).glob("*.cti"))


def find_genicam_cameras(producer: Path | str) -> list[CameraInfo]:
    """Cameras that a producer finds; none is opened."""
    harvester = _harvester(producer, f"{producer}")
    try:
        return _cameras(harvester)
    finally:
        harvester.reset()


class GenicamSdk(CameraLibrary):
    def __init__(self, settings: CameraSettings) -> None:
        super().__init__(settings.where)
        self._acquirer: Any = None
        self._harvester = _harvester(settings.producer or "", settings.where)
        try:
            chosen = choose_camera(_cameras(self._harvester), settings)
            self._acquirer = self._try(f"opening {chosen}", lambda: self._harvester.create({"id_": chosen.identifier}))
            self._acquirer.num_buffers = max(_BUFFERS, self._acquirer.min_num_buffers)
        except BaseException:
            self.close()
            raise
        self._nodes: Any = self._acquirer.remote_device.node_map
        self.details = {"model": chosen.model, "serial": chosen.serial, "producer": Path(settings.producer or "").name}

    def has(self, feature: str) -> bool:
        if not self._nodes.has_node(feature):
            return False
        mode = self._try(feature, lambda: self._nodes.get_node(feature).get_access_mode())
        modes: Any = import_module("genicam.genapi").EAccessMode
        return mode in (modes.RW, modes.RO, modes.WO)

    def read(self, feature: str, kind: Callable[[Any], Value]) -> Value:
        return self._try(f"reading {feature}", lambda: kind(self._node(feature).value))

    def write(self, feature: str, value: Any) -> None:
        node = self._node(feature)
        rounded = round(value) if _is_whole(node) else value
        self._try(f"setting {feature}", lambda: setattr(node, "value", rounded))

    def bounds(self, feature: str) -> tuple[float, float, float]:
        node = self._node(feature)

        def ask() -> tuple[float, float, float]:
            return float(node.min), float(node.max), float(node.inc) if _is_whole(node) else 0.0

        return self._try(f"asking for the bounds of {feature}", ask)

    def unit(self, feature: str) -> str:
        node = self._node(feature)
        return _known(lambda: str(node.unit or "").strip(), "")

    def entries(self, feature: str) -> tuple[str, ...]:
        return self._try(f"asking for the entries of {feature}", lambda: tuple(self._node(feature).symbolics))

    def execute(self, feature: str) -> None:
        self._try(f"executing {feature}", lambda: self._node(feature).execute())

    def start(self) -> None:
        self._try("starting the acquisition", self._acquirer.start)

    def stop(self) -> None:
        self._try("stopping the acquisition", self._acquirer.stop)

    def close(self) -> None:
        self._nodes = None
        with suppress(Exception):  # it is given up in any case, and each step is tried
            if self._acquirer is not None:
                self._acquirer.destroy()
        with suppress(Exception):
            self._harvester.reset()
        self._acquirer = None

    def _fetch(self, timeout_s: float) -> RawFrame | None:
        buffer = self._try("waiting for a frame", lambda: self._next_buffer(max(1e-3, timeout_s)))
        if buffer is None:
            return None
        try:
            return self._raw(buffer)
        finally:
            self._try("giving a buffer back", buffer.queue)

    def _next_buffer(self, timeout_s: float) -> Any:
        late: Any = import_module("genicam.gentl").TimeoutException
        try:
            return self._acquirer.try_fetch(timeout=timeout_s)
        except late:
            return None

    def _node(self, feature: str) -> Any:
        if not self._nodes.has_node(feature):
            raise HardwareError(f"{self._where}: this camera has no {feature}")
        return self._nodes.get_node(feature)

    def _raw(self, buffer: Any) -> RawFrame:
        module = buffer.module
        number = _known(lambda: int(module.frame_id), None)
        if not _known(lambda: bool(module.is_complete()), True):
            return RawFrame.unusable(number, "parts of it were lost")
        payload = self._try("reading a frame", lambda: buffer.payload)
        if not payload.components:
            return RawFrame.unusable(number, "it has no image")
        part = payload.components[0]
        if padding := _known(lambda: int(module.padding_x), 0):
            end = f"the lines of its frames end with {padding} bytes that are no pixels"
            raise HardwareError(f"{self._where}: {end}; choose a width or a pixel format without")
        # the library would expand packed pixels itself; the bytes are read by the tables of this package
        offset = _known(lambda: int(part.data_offset), 0)
        stamp = _known(lambda: int(module.timestamp_ns), 0) or _known(lambda: int(module.timestamp), 0)
        return RawFrame(
            data=np.frombuffer(module.raw_buffer, np.uint8, offset=offset).copy(),
            width=int(part.width),
            height=int(part.height),
            code=_known(lambda: int(module.pixel_format), 0) or None,
            number=number,
            timestamp_ns=stamp or None,
        )

    def _is_gone(self, error: Exception) -> bool:
        """Whether the camera leaves a plain query unanswered: errors of its features do not give the cause."""
        del error
        if self._acquirer is None:
            return False
        try:
            self._acquirer.remote_device.port.read(0, 4)
        except Exception as error:  # noqa: BLE001  (judged by its kind)
            return type(error).__name__ in _GONE
        return False


def _known(ask: Callable[[], Value], otherwise: Value) -> Value:
    """What the producer answers, or a default where it cannot."""
    try:
        return ask()
    except Exception:  # noqa: BLE001  (each producer lacks other things, and reports that in its own way)
        return otherwise


def _harvester(producer: Path | str, where: str) -> Any:
    path = Path(producer)
    if not path.is_file():
        raise InputError(f"{where}: no GenTL producer {path}; it is a .cti file of the camera's maker")
    harvester = load_harvester()()
    try:
        harvester.add_file(str(path), check_existence=True, check_validity=True)
        harvester.update()
    except Exception as error:
        harvester.reset()
        raise HardwareError(f"{where}: the GenTL producer {path} cannot be used: {error}") from error
    return harvester


def _cameras(harvester: Any) -> list[CameraInfo]:
    cameras: list[CameraInfo] = []
    for found in harvester.device_info_list:
        keys = ("id_", "serial_number", "vendor", "model")
        identifier, serial, vendor, model = (str(found.property_dict.get(key) or "") for key in keys)
        cameras.append(CameraInfo("genicam", identifier, serial, model=f"{vendor} {model}".strip()))
    return cameras


def _is_whole(node: Any) -> bool:
    return type(node).__name__ == "IInteger"
