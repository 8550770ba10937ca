"""Simulated screen of a display: it shows the pictures that it is sent, and knows nothing of channels.

``SHOW width height bytes`` CR LF is followed by so many bytes, the levels row by row as zlib packs them, and answered
``OK`` or ``NG`` and why. What is seen from the part depends on how the screen is mounted and responds.
"""

import zlib

import numpy as np

from lightopt.rig.simulated._firmware import Firmware, SeenPicture


class ScreenFirmware(Firmware):
    """A screen, black at first, of some resolution, response and mounting."""

    def __init__(
        self, *, resolution_px: tuple[int, int], gamma: float = 2.2, turn_deg: int = 0, mirrored: bool = False
    ) -> None:
        super().__init__()
        self._width, self._height = resolution_px
        self._gamma, self._turn_deg, self._mirrored = gamma, turn_deg, mirrored
        self._levels = np.zeros((self._height, self._width), np.uint8)
        self._number = 0
        self._seen = self._look()

    def feed(self, data: bytes, now: float) -> bytes:  # noqa: ARG002
        self._buffer += data
        replies = b""
        while (end := self._buffer.find(b"\r\n")) >= 0:
            words = self._buffer[:end].split()
            if len(words) != 4 or words[0] != b"SHOW" or not all(word.isdigit() for word in words[1:]):
                self._buffer = self._buffer[end + 2 :]
                replies += b"NG command\r\n"
                continue
            width, height, size = map(int, words[1:])
            packed = self._buffer[end + 2 : end + 2 + size]
            if len(packed) < size:
                break
            self._buffer = self._buffer[end + 2 + size :]
            replies += self._show(width, height, packed)
        return replies

    def _show(self, width: int, height: int, packed: bytes) -> bytes:
        if (width, height) != (self._width, self._height):
            return f"NG the screen has {self._width} x {self._height} pixels\r\n".encode("ascii")
        try:
            levels = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, width)
        except (zlib.error, ValueError):
            return b"NG the picture is damaged\r\n"
        if not np.array_equal(levels, self._levels):
            self._levels, self._number = levels, self._number + 1
            self._seen = self._look()
        return b"OK\r\n"

    def picture(self) -> SeenPicture:
        return self._seen

    def _look(self) -> SeenPicture:
        seen = np.fliplr(self._levels) if self._mirrored else self._levels
        # the screen's upper edge is turned clockwise
        seen = np.rot90(seen, -self._turn_deg // 90)
        radiance = (np.arange(256) / 255.0) ** self._gamma
        steps = np.diff(radiance, append=2.0 - radiance[-2])
        return SeenPicture(self._number, radiance[seen], steps[seen])
