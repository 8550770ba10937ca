"""The virtual bench's camera as the capture sees it."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from typing import Any

import numpy as np

from lightopt.errors import HardwareError, InputError
from lightopt.hardware import Frame, Identity
from lightopt.virtualbench._camera import EXPOSURE_RANGE_US

__all__ = ["VirtualCamera"]

_FIRST_ANSWER_S = 120.0  # the bench loads the part's mesh, which for a large STEP file takes its time
_RENDER_S = 60.0  # a bench that renders a new posture takes longer than any camera


class VirtualCamera:
    """A camera that takes its frames from the virtual bench, over a loopback socket.

    Parameters
    ----------
    address
        Host and port of the bench's camera.

    Raises
    ------
    HardwareError
        When it does not answer.
    """

    def __init__(self, address: tuple[str, int]) -> None:
        self._address = address
        self._exposure_us = EXPOSURE_RANGE_US[0]
        self._buffer = bytearray()
        try:
            self._socket = socket.create_connection(address, timeout=5.0)
        except OSError as error:
            raise self._lost(error) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            self._says, _ = self._ask({"ask": "identity"}, time.monotonic() + _FIRST_ANSWER_S)
        except BaseException:
            self.close()
            raise

    @property
    def triggered(self) -> bool:
        """Whether a frame begins when it is asked for."""
        return bool(self._says["triggered"])

    @property
    def resolution_px(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        width, height = self._says["resolution_px"]
        return width, height

    @property
    def bit_depth(self) -> int:
        """Bits of a level."""
        return int(self._says["bit_depth"])

    @property
    def exposure_range_us(self) -> tuple[float, float]:
        """Shortest and longest exposure time [µs]."""
        return EXPOSURE_RANGE_US

    def identify(self) -> Identity:
        """The bench's camera."""
        return Identity(driver="virtual", port="virtual", says={"model": "lightopt virtual camera"})

    def set_exposure(self, exposure_us: float) -> float:
        """Hold an exposure time [µs], to the nearest microsecond.

        Raises
        ------
        InputError
            When it lies outside the camera's range.
        """
        low, high = EXPOSURE_RANGE_US
        if not low <= exposure_us <= high:
            raise InputError(f"camera: expected an exposure of {low:g} to {high:g} µs, found {exposure_us:g} µs")
        self._exposure_us = float(round(exposure_us))
        return self._exposure_us

    def grab(self, *, timeout_s: float) -> Frame:
        """Take a frame; what the bench renders for the first time may take longer than `timeout_s`.

        Raises
        ------
        HardwareError
            When the bench does not deliver.
        """
        deadline = time.monotonic() + max(timeout_s, self._exposure_us / 1e6 + _RENDER_S)
        head, data = self._ask({"ask": "frame", "exposure_us": self._exposure_us}, deadline)
        levels = np.frombuffer(data, dtype=head["dtype"]).reshape(head["shape"])
        return Frame(
            levels=levels,
            exposure_us=float(head["exposure_us"]),
            number=int(head["number"]),
            timestamp_ns=int(head["timestamp_ns"]),
        )

    def close(self) -> None:
        """Leave the bench."""
        with contextlib.suppress(OSError):
            self._socket.close()

    def _ask(self, request: dict[str, Any], deadline: float) -> tuple[dict[str, Any], bytes]:
        try:
            self._socket.settimeout(max(0.001, deadline - time.monotonic()))
            self._socket.sendall(json.dumps(request).encode() + b"\n")
            line = self._until_newline(deadline)
            head: dict[str, Any] = json.loads(line)
            data = self._exactly(int(head["bytes"]), deadline)
        except (OSError, ValueError) as error:
            raise self._lost(error) from error
        if "error" in head:
            raise HardwareError(f"virtual camera: {head['error']}")
        return head, data

    def _until_newline(self, deadline: float) -> bytes:
        while b"\n" not in self._buffer:
            self._receive(deadline)
        line, _, rest = bytes(self._buffer).partition(b"\n")
        self._buffer = bytearray(rest)
        return line

    def _exactly(self, count: int, deadline: float) -> bytes:
        while len(self._buffer) < count:
            self._receive(deadline)
        data = bytes(self._buffer[:count])
        del self._buffer[:count]
        return data

    def _receive(self, deadline: float) -> None:
        left = deadline - time.monotonic()
        if left <= 0.0:
            raise TimeoutError("no frame in time")
        self._socket.settimeout(left)
        data = self._socket.recv(1 << 20)
        if not data:
            raise ConnectionError("the bench closed the connection")
        self._buffer += data

    def _lost(self, error: Exception) -> HardwareError:
        host, port = self._address
        return HardwareError(
            f"virtual camera on {host}:{port}: no answer ({error}); the bench's process is gone or hangs"
        )
