"""Simulated screen of a display: it shows the pictures that it is sent, and knows nothing of channels.

What is seen from the part depends on how the screen is mounted and responds.
"""

import re
import zlib

import numpy as np

from lightopt.rig.simulated._firmware import Firmware, SeenPicture


class ScreenFirmware(Firmware):
    """A screen, black at first, of some resolution, response and mounting."""

    def __init__(
        self, *, resolution_px: tuple[int, int], gamma: float = 2.2, turn_deg: int = 0, mirrored: bool = False
    ) -> None:
        super().__init__()
        self._size = (resolution_px[0], resolution_px[1])  # a list in JSON
        self._gamma, self._turn_deg, self._mirrored = gamma, turn_deg, mirrored
        self._seen = self._look(bytes(self._size[0] * self._size[1]))

    def feed(self, data: bytes, now: float) -> bytes:  # noqa: ARG002
        self._buffer += data
        replies = b""
        while match := re.match(rb"SHOW (\d+) (\d+) (\d+)\r\n", self._buffer):
            width, height, size = map(int, match.groups())
            packed = self._buffer[match.end() : match.end() + size]
            if len(packed) < size:
                break
            self._buffer = self._buffer[match.end() + size :]
            if (width, height) != self._size:
                replies += b"NG the screen has %d x %d pixels\r\n" % self._size
                continue
            try:
                self._seen = self._look(zlib.decompress(packed))
                replies += b"OK\r\n"
            except (zlib.error, ValueError):
                replies += b"NG the picture is damaged\r\n"
        return replies

    def picture(self) -> SeenPicture:
        return self._seen

    def _look(self, data: bytes) -> SeenPicture:
        levels = np.frombuffer(data, np.uint8).reshape(self._size[::-1])
        seen = np.fliplr(levels) if self._mirrored else levels
        # the screen's upper edge is turned clockwise
        seen = np.rot90(seen, -self._turn_deg // 90)
        radiance = (np.arange(256) / 255.0) ** self._gamma
        steps = np.diff(radiance, append=2.0 - radiance[-2])
        return SeenPicture(zlib.crc32(data), radiance[seen], steps[seen])
