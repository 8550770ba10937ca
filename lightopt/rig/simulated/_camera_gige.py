"""The bench's camera as a GigE Vision camera on the loopback: Aravis' simulated camera, with our pixels in its frames.

Control and stream are those of Aravis, packet by packet; in a frame is what the bench sees when it is triggered.
"""

import ctypes
import ctypes.util
import re
import socket
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.integer[Any]]
_DENSE = {0x010A0046: 10, 0x010C0047: 12}  # bits of a pixel in formats without anything between pixels
_PAIRED = {0x010C0004: 2, 0x010C0006: 4}  # lower bits of each of two pixels in three bytes
# number and bits by name
FORMATS: dict[str, tuple[int, int]] = {
    "Mono8": (0x01080001, 8),
    "Mono10": (0x01100003, 10),
    "Mono10p": (0x010A0046, 10),
    "Mono10Packed": (0x010C0004, 10),
    "Mono12": (0x01100005, 12),
    "Mono12p": (0x010C0047, 12),
    "Mono12Packed": (0x010C0006, 12),
    "Mono16": (0x01100007, 16),
}


def packed(levels: Image, code: int) -> bytes:
    """Bytes of a frame in a pixel format, by the tables of the PFNC; `levels` are right-aligned, shape (H, W)."""
    flat = levels.reshape(-1)
    if code in _DENSE:
        places = np.arange(_DENSE[code])
        bits = (flat[:, None].astype(np.int64) >> places & 1).astype(np.uint8)
        return np.packbits(bits.reshape(-1), bitorder="little").tobytes()
    if code in _PAIRED:
        low = _PAIRED[code]
        pairs = np.zeros((-(-len(flat) // 2), 2), np.int64)
        pairs.reshape(-1)[: len(flat)] = flat
        first, second = pairs.T
        mask = (1 << low) - 1
        middle = (first & mask) | (second & mask) << 4
        return np.stack((first >> low, middle, second >> low), axis=1).astype(np.uint8).tobytes()
    return flat.astype(np.uint8 if code >> 16 & 0xFF == 8 else "<u2").tobytes()


# what is seen at an exposure time [µs] and a gain [dB]; whether the frame was triggered or followed another
Expose = Callable[[float, float, bool], Image]
_ADDRESS, _CONTROL_PORT = "127.0.0.1", 3956
_FREE_S = 100.0
_LONGEST_US = 1_000_000
_PERIOD_US = 10_000  # between two frames of a camera that runs freely
_TRIGGER_US = 1_000  # between two checks for a trigger


class GigeCamera:
    """A GigE Vision camera at 127.0.0.1; `expose` delivers right-aligned levels (H, W). ValueError without Aravis."""

    def __init__(self, expose: Expose, *, resolution_px: tuple[int, int], bit_depth: int) -> None:
        formats = [name for name, (_, bits) in FORMATS.items() if bits == bit_depth]
        if not formats:
            raise ValueError(f"a simulated GigE camera has 8, 10, 12 or 16 bits, not {bit_depth}")
        try:
            import_module("gi").require_version("Aravis", "0.8")
            self._library: Any = import_module("gi.repository.Aravis")
            self.c = ctypes.CDLL(ctypes.util.find_library("aravis-0.8") or "libaravis-0.8.so.0")
        except (ImportError, ValueError, OSError) as error:
            raise ValueError(f"a simulated GigE camera needs Aravis, which is not there ({error})") from None
        self._expose = expose
        self._port = _reserve_port()
        self.serial = "LIGHTOPT1"
        self._folder = tempfile.TemporaryDirectory()
        described = Path(self._folder.name) / "camera.xml"
        described.write_text(self._description(formats), encoding="utf-8")
        self._server: Any = self._library.GvFakeCamera.new_full(_ADDRESS, self.serial, str(described))
        self._device: Any = self._server.get_fake_camera()
        width, height = resolution_px
        sizes = {"SENSOR_WIDTH": width, "SENSOR_HEIGHT": height, "WIDTH": width, "HEIGHT": height}
        others = {"PIXEL_FORMAT": FORMATS[formats[0]][0], "ACQUISITION_FRAME_PERIOD_US": _PERIOD_US}
        for register, value in {**sizes, **others}.items():
            self._device.write_register(self._register(register), value)
        self._device.set_trigger_frequency(1e6 / _TRIGGER_US)
        number, pointer = ctypes.c_uint32, ctypes.c_void_p
        kind = ctypes.CFUNCTYPE(None, pointer, pointer, number, number, number)
        self._fill_c = kind(self._fill)  # kept: the library calls it for as long as the camera runs
        self.c.arv_fake_camera_set_fill_pattern.argtypes = [ctypes.c_void_p, kind, ctypes.c_void_p]
        self.c.arv_buffer_get_data.restype = ctypes.c_void_p
        self.c.arv_buffer_get_data.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
        self.c.arv_fake_camera_set_fill_pattern(_address(self._device), self._fill_c, None)

    def unplug(self) -> None:
        self._device = self._server = None

    def _register(self, name: str) -> int:
        return getattr(self._library, f"FAKE_CAMERA_REGISTER_{name}")

    def close(self) -> None:
        self.unplug()
        self._port.close()
        self._folder.cleanup()

    def _fill(self, buffer: int, _: int | None, exposure_us: float, gain: int, code: int) -> None:
        """Expose: called by the camera's thread when a frame begins."""
        begun = time.monotonic()
        device = self._device
        triggered = device is not None and not device.is_in_free_running_mode()
        levels = self._expose(float(exposure_us), float(gain), triggered)
        top, left, height, width = self._region()
        data = packed(levels[top : top + height, left : left + width], code)
        size = ctypes.c_size_t()
        where = self.c.arv_buffer_get_data(buffer, ctypes.byref(size))
        room = width * height * (code >> 16 & 0xFF) // 8  # the size in the buffer is 0 at this moment
        ctypes.memmove(where, data, min(len(data), room))
        time.sleep(max(0.0, exposure_us / 1e6 - (time.monotonic() - begun)))

    def _region(self) -> tuple[int, int, int, int]:
        """Top, left, height and width of the part of the sensor that a frame has [pixels]; nothing when unplugged."""
        device = self._device
        if device is None:
            return 0, 0, 0, 0
        registers = map(self._register, ("Y_OFFSET", "X_OFFSET", "HEIGHT", "WIDTH"))
        top, left, height, width = (int(device.read_register(register)[1]) for register in registers)
        return top, left, height, width

    def _description(self, formats: list[str]) -> str:
        """The description that Aravis' camera has of itself, with our pixel formats and our longest exposure."""
        text = str(self._library.FakeCamera.new("description").get_genicam_xml()[0])
        entry = '<EnumEntry Name="{}" NameSpace="Standard"><Value>{}</Value></EnumEntry>'
        entries = "".join(entry.format(name, FORMATS[name][0]) for name in formats)
        old = r'(?s)(<Enumeration Name="PixelFormat".*?</DisplayName>).*?(<pValue>)'
        text = re.sub(old, rf"\g<1>{entries}\g<2>", text, count=1)
        return text.replace("<Max>10000000.0</Max>", f"<Max>{_LONGEST_US}.0</Max>")


def _address(gobject: Any) -> int:
    """Address of the library's object behind a Python object."""
    pointer_of = ctypes.pythonapi.PyCapsule_GetPointer
    pointer_of.restype = ctypes.c_void_p
    pointer_of.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return int(pointer_of(gobject.__gpointer__, None) or 0)


def _reserve_port() -> socket.socket:
    """Occupies the port while this camera runs: GigE Vision has one control port per address."""
    end = time.monotonic() + _FREE_S
    while True:
        taken = socket.socket()
        try:
            taken.bind((_ADDRESS, _CONTROL_PORT))
        except OSError:
            taken.close()
            if time.monotonic() > end:
                raise ValueError("another simulated GigE camera runs on this computer; there is room for one") from None
            time.sleep(0.1)
        else:
            return taken
