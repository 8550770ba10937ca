"""GigE Vision and USB3 Vision cameras through Aravis, without a maker's software. The one home of PyGObject."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices._camera_sdk import CameraInfo, CameraLibrary, CameraSettings, RawFrame, Value, choose_camera

_BUFFERS = 4
_SOCKET_BUFFER = 4 << 20
_INSTALL = (
    "on Debian and Ubuntu: apt-get install gir1.2-aravis-0.8 libgirepository1.0-dev libcairo2-dev pkg-config gcc, "
    "then pip install 'lightopt[aravis]'"
)


def load_aravis() -> Any:
    """The library; an InputError with how to install it when it is not there."""
    try:
        import_module("gi").require_version("Aravis", "0.8")
        return import_module("gi.repository.Aravis")
    except (ImportError, ValueError) as error:
        raise InputError(f"camera driver aravis: Aravis is not there ({error}); {_INSTALL}") from None


def find_aravis_cameras() -> list[CameraInfo]:
    """Cameras on the networks and USB ports of this computer; none is opened."""
    library = load_aravis()
    library.update_device_list()
    found: list[CameraInfo] = []
    for i in range(library.get_n_devices()):
        identifier, serial, address, vendor, model = (
            getattr(library, f"get_device_{name}")(i) or ""
            for name in ("id", "serial_nbr", "address", "vendor", "model")
        )
        found.append(CameraInfo("aravis", identifier, serial, address, f"{vendor} {model}".strip()))
    return found


class AravisSdk(CameraLibrary):
    def __init__(self, settings: CameraSettings) -> None:
        super().__init__(settings.where)
        self._library = load_aravis()
        self._failure = import_module("gi.repository.GLib").Error
        chosen = choose_camera(find_aravis_cameras(), settings)
        self._stream: Any = None
        self._camera: Any = self._try(f"opening {chosen}", lambda: self._library.Camera.new(chosen.identifier))
        self._device: Any = self._camera.get_device()
        known = {"model": chosen.model, "serial": chosen.serial, "address": chosen.address}
        self.details = {name: value for name, value in known.items() if value}
        if self._camera.is_gv_device():
            self._set_packets(settings)
        elif settings.packet_size is not None or settings.packet_delay_ns is not None:
            only = "only cameras on a network have packets; leave out packet_size and packet_delay_ns"
            raise InputError(f"{self._where}: {only}")

    def has(self, feature: str) -> bool:
        return self._try(feature, lambda: bool(self._camera.is_feature_available(feature)))

    def read(self, feature: str, kind: Callable[[Any], Value]) -> Value:
        get = getattr(self._camera, f"get_{self._type(feature, kind)}")
        return self._try(f"reading {feature}", lambda: kind(get(feature)))

    def write(self, feature: str, value: Any) -> None:
        name = self._type(feature, type(value))
        put = getattr(self._camera, f"set_{name}")
        self._try(f"setting {feature}", lambda: put(feature, round(value) if name == "integer" else value))

    def bounds(self, feature: str) -> tuple[float, float, float]:
        kind = self._type(feature, float)
        what = f"asking for the bounds of {feature}"
        low, high = self._try(what, lambda: getattr(self._camera, f"get_{kind}_bounds")(feature))
        step = self._try(what, lambda: getattr(self._camera, f"get_{kind}_increment")(feature))
        return low, high, step if 0 < step < high else 0.0

    def unit(self, feature: str) -> str:
        ask = self._device.get_feature(feature).get_unit
        return str(self._try(f"asking for the unit of {feature}", ask) or "").strip()

    def entries(self, feature: str) -> tuple[str, ...]:
        ask = self._camera.dup_available_enumerations_as_strings
        return self._try(f"asking for the entries of {feature}", lambda: tuple(ask(feature)))

    def execute(self, feature: str) -> None:
        self._try(f"executing {feature}", lambda: self._camera.execute_command(feature))

    def start(self) -> None:
        if self._stream is None:
            self._stream = self._try("opening the stream", lambda: self._camera.create_stream(None, None))
            if self._stream is None:
                raise HardwareError(f"{self._where}: the camera's stream could not be opened")
            if self._camera.is_gv_device():
                self._stream.set_property("socket-buffer", self._library.GvStreamSocketBuffer.FIXED)
                self._stream.set_property("socket-buffer-size", _SOCKET_BUFFER)
            payload = self._try("reading PayloadSize", self._camera.get_payload)
            for _ in range(_BUFFERS):
                self._stream.push_buffer(self._library.Buffer.new_allocate(payload))
        while self.pop(0.0) is not None:
            pass
        self._try("starting the acquisition", self._camera.start_acquisition)

    def stop(self) -> None:
        self._try("stopping the acquisition", self._camera.stop_acquisition)

    def close(self) -> None:
        # the stream goes first: its end resets the camera's stream port, which would be that of the next program
        self._stream = None
        self._device = None
        self._camera = None

    def _fetch(self, timeout_s: float) -> RawFrame | None:
        if timeout_s <= 0:
            buffer = self._stream.try_pop_buffer()
        else:
            buffer = self._stream.timeout_pop_buffer(round(timeout_s * 1e6))
        if buffer is None:
            return None
        try:
            return self._raw(buffer)
        finally:
            self._stream.push_buffer(buffer)

    def _raw(self, buffer: Any) -> RawFrame:
        status = buffer.get_status()
        if status != self._library.BufferStatus.SUCCESS:
            return RawFrame.unusable(buffer.get_frame_id(), status.value_nick.replace("-", " "))
        return RawFrame(
            data=np.frombuffer(buffer.get_data(), np.uint8),
            width=buffer.get_image_width(),
            height=buffer.get_image_height(),
            code=buffer.get_image_pixel_format(),
            number=buffer.get_frame_id(),
            timestamp_ns=buffer.get_timestamp() or None,
        )

    def _set_packets(self, settings: CameraSettings) -> None:
        # the raw socket that Aravis takes for root sees nothing on the loopback, and needs rights elsewhere
        options = self._library.GvStreamOption.PACKET_SOCKET_DISABLED
        self._try("choosing the socket", lambda: self._camera.gv_set_stream_options(options))
        wanted = {"packet_size": settings.packet_size, "packet_delay": settings.packet_delay_ns}
        for name, value in wanted.items():
            if value is None:
                continue
            self._try(f"setting {name}", lambda n=name, v=value: getattr(self._camera, f"gv_set_{n}")(v))
            held = self._try(f"reading {name}", lambda n=name: getattr(self._camera, f"gv_get_{n}")())
            if name == "packet_size" and held != value:
                raise HardwareError(f"{self._where}: {name} was set to {value}, and the camera holds {held}")

    def _type(self, feature: str, kind: Callable[[Any], object]) -> str:
        if kind in (str, bool):
            return "string" if kind is str else "boolean"
        return "float" if isinstance(self._device.get_feature(feature), self._library.GcFloat) else "integer"

    def _is_gone(self, error: Any) -> bool:
        kinds = self._library.DeviceError
        gone = (kinds.NOT_CONNECTED, kinds.TIMEOUT, kinds.NOT_FOUND)
        return error.domain == "arv-device-error-quark" and error.code in gone
