"""The bench's camera as a GigE Vision camera on the loopback: Aravis' simulated camera, with our pixels in its frames.

Control and stream are those of Aravis, packet by packet; in a frame is what the bench sees when it is triggered.
"""

import ctypes
import ctypes.util
import re
import socket
import tempfile
import threading
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.rig.simulated._firmware import Trigger, trigger

Image = NDArray[np.integer[Any]]

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

_DENSE = {0x010A0046: 10, 0x010C0047: 12}
_PAIRED = {0x010C0004: 2, 0x010C0006: 4}


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


# what is seen at an exposure time [µs] and a gain [dB]; whether the frame was triggered or followed another; whether it
# will arrive, so that it counts
Expose = Callable[[float, float, bool, bool], Image]

_ADDRESS = "127.0.0.1"
_CONTROL_PORT = 3956
_FREE_S = 100.0
_LONGEST_US = 1_000_000
_PERIOD_US = 10_000  # between two frames of a camera that runs freely
_TRIGGER_US = 1_000  # between two checks for a trigger

FAULTS = (
    "lost",  # no packet of a frame arrives
    "incomplete",  # some packets do not arrive
    "duplicate",  # the frame has the number of the one before
    "order",  # its number is lower than that of the one before
    "stale",  # its time is before that of the one before
    "old_image",  # its image is that of the one before
    "exposure",  # it is exposed half as long
    "format",  # the camera holds another pixel format from here on, as after a power cycle
    "hang",  # the camera neither sends nor answers any more
    "vanish",  # its cable is pulled
)

_UNSOUND = {"lost", "incomplete", "duplicate", "order", "stale", "hang", "vanish"}
_BACK = 3
_BACK_NS = 10**9
_LOST_SHARES = {"lost": 1.0, "vanish": 1.0, "incomplete": 0.5}  # of a frame's packets
_OTHER_FORMAT = 0x0108000B  # BayerBG8


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
        self.faults = GigeFaults(self)
        self._folder = tempfile.TemporaryDirectory()
        described = Path(self._folder.name) / "camera.xml"
        described.write_text(self._description(formats), encoding="utf-8")
        self._server: Any = self._library.GvFakeCamera.new_full(_ADDRESS, self.serial, str(described))
        self._device: Any = self._server.get_fake_camera()
        for register, value in (
            ("SENSOR_WIDTH", resolution_px[0]),
            ("SENSOR_HEIGHT", resolution_px[1]),
            ("WIDTH", resolution_px[0]),
            ("HEIGHT", resolution_px[1]),
            ("PIXEL_FORMAT", FORMATS[formats[0]][0]),
            ("ACQUISITION_FRAME_PERIOD_US", _PERIOD_US),
        ):
            self.write(register, value)
        self._device.set_trigger_frequency(1e6 / _TRIGGER_US)
        kind = ctypes.CFUNCTYPE(
            None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
        )
        self._fill_c = kind(self._fill)  # kept: the library calls it for as long as the camera runs
        self.c.arv_fake_camera_set_fill_pattern.argtypes = [ctypes.c_void_p, kind, ctypes.c_void_p]
        self.c.arv_buffer_get_data.restype = ctypes.c_void_p
        self.c.arv_buffer_get_data.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
        for field in ("frame_id", "timestamp"):
            get, put = (getattr(self.c, f"arv_buffer_{verb}_{field}") for verb in ("get", "set"))
            get.restype, get.argtypes = ctypes.c_uint64, [ctypes.c_void_p]
            put.argtypes = [ctypes.c_void_p, ctypes.c_uint64]
        self.c.arv_fake_camera_set_fill_pattern(_address(self._device), self._fill_c, None)

    def unplug(self) -> None:
        self._device = self._server = None

    def lose(self, share: float) -> None:
        """Lose this share of the packets of the stream from here on."""
        if self._server is not None:
            self._server.set_property("gvsp-lost-ratio", share)

    def write(self, register: str, value: int) -> None:
        """Write a register of the camera, as a fault of the camera itself would."""
        if self._device is not None:
            self._device.write_register(self._register(register), value)

    def _register(self, name: str) -> int:
        return getattr(self._library, f"FAKE_CAMERA_REGISTER_{name}")

    def close(self) -> None:
        self.faults.awake.set()
        self.unplug()
        self._port.close()
        self._folder.cleanup()

    def _fill(self, buffer: int, _: int | None, exposure_us: int, gain: int, code: int) -> None:
        """Expose: called by the camera's thread when a frame begins."""
        begun = time.monotonic()
        number = int(self.c.arv_buffer_get_frame_id(buffer))
        held_us = self.faults.begin(buffer, number, exposure_us)
        device = self._device
        triggered = device is not None and not device.is_in_free_running_mode()
        levels = self.faults.seen(self._expose(held_us, float(gain), triggered, self.faults.arrives))
        top, left, height, width = self._region()
        data = packed(levels[top : top + height, left : left + width], code)
        size = ctypes.c_size_t()
        where = self.c.arv_buffer_get_data(buffer, ctypes.byref(size))
        room = width * height * (code >> 16 & 0xFF) // 8  # the size in the buffer is 0 at this moment
        ctypes.memmove(where, data, min(len(data), room))
        time.sleep(max(0.0, held_us / 1e6 - (time.monotonic() - begun)))
        self.faults.end(buffer, int(self.c.arv_buffer_get_timestamp(buffer)))

    def _region(self) -> tuple[int, int, int, int]:
        """Top, left, height and width of the part of the sensor that a frame has [pixels]; nothing when unplugged."""
        device = self._device
        if device is None:
            return 0, 0, 0, 0
        top, left, height, width = (
            int(device.read_register(self._register(name))[1]) for name in ("Y_OFFSET", "X_OFFSET", "HEIGHT", "WIDTH")
        )
        return top, left, height, width

    def _description(self, formats: list[str]) -> str:
        """The description that Aravis' camera has of itself, with our pixel formats and our longest exposure."""
        text = str(self._library.FakeCamera.new("description").get_genicam_xml()[0])
        entries = "".join(
            f'<EnumEntry Name="{name}" NameSpace="Standard"><Value>{FORMATS[name][0]}</Value></EnumEntry>'
            for name in formats
        )
        text = re.sub(
            r'(<Enumeration Name="PixelFormat".*?</DisplayName>).*?(<pValue>)',
            rf"\g<1>{entries}\g<2>",
            text,
            count=1,
            flags=re.DOTALL,
        )
        return text.replace("<Max>10000000.0</Max>", f"<Max>{_LONGEST_US}.0</Max>")


class GigeFaults:
    """Decides at each frame which faults strike, and lets the camera suffer them."""

    def __init__(self, camera: GigeCamera) -> None:
        self._camera = camera
        self._triggers: dict[str, Trigger] = {}
        self._now: set[str] = set()
        self._image: Image | None = None
        self._stamp_ns = 0
        self._losing = False
        self.awake = threading.Event()

    def inject(self, fault: str, options: dict[str, Any]) -> None:
        """Set a fault; ``clear`` ends all."""
        if fault == "clear":
            self._triggers = {}
            return
        if fault not in FAULTS:
            raise ValueError(f'a camera has no fault "{fault}"; there is {", ".join(FAULTS)}')
        self._triggers = {**self._triggers, fault: trigger(fault, options)}

    def begin(self, buffer: int, number: int, exposure_us: int) -> float:
        """Apply the faults that strike at this frame; returns how long it is really exposed [µs]."""
        self._now = {fault for fault, one in self._triggers.items() if one.strikes()}
        share = max((_LOST_SHARES.get(fault, 0.0) for fault in self._now), default=0.0)
        if share or self._losing:
            self._losing = share > 0
            self._camera.lose(share)
        for fault, back in (("duplicate", 1), ("order", _BACK)):
            if fault in self._now:
                self._camera.c.arv_buffer_set_frame_id(buffer, number - back)
        if "exposure" in self._now:
            exposure_us = max(10, exposure_us // 2)
            self._camera.write("EXPOSURE_TIME_US", exposure_us)
        if "format" in self._now:
            self._camera.write("PIXEL_FORMAT", _OTHER_FORMAT)
        if "hang" in self._now:
            self.awake.wait()  # the camera's one thread, which also answers questions
        if "vanish" in self._now:
            # the camera's own thread is here and cannot end itself
            threading.Thread(target=self._camera.unplug, daemon=True).start()
        return float(exposure_us)

    @property
    def arrives(self) -> bool:
        return not self._now & _UNSOUND

    def seen(self, image: Image) -> Image:
        """What the frame has of what is seen."""
        old, self._image = self._image, image
        return old if "old_image" in self._now and old is not None else image

    def end(self, buffer: int, timestamp_ns: int) -> None:
        if "stale" in self._now:
            self._camera.c.arv_buffer_set_timestamp(buffer, (self._stamp_ns or time.time_ns()) - _BACK_NS)
        else:
            self._stamp_ns = timestamp_ns


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
                raise ValueError(
                    f"another simulated GigE camera runs on this computer, for more than {_FREE_S:g} s; there is room "
                    f"for one at {_ADDRESS}"
                ) from None
            threading.Event().wait(0.1)
        else:
            return taken
