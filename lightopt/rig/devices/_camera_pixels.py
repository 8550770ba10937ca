"""Pixel formats of machine-vision cameras, and their bytes as right-aligned levels.

Names and layouts are those of the GenICam Pixel Format Naming Convention (PFNC 2.4) and, for the formats that end in
``Packed``, of GigE Vision 1.2, which came before it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import UInt8
from lightopt.core.errors import HardwareError, InputError

Levels = UInt8 | NDArray[np.uint16]


@dataclass(frozen=True, kw_only=True)
class PixelFormat:
    """A format of grey levels.

    name, code: Name and number in the naming convention.
    bits: Bits of a level.
    stored: Bits that a pixel takes in the frame.
    unpack: Levels of n pixels from the frame's bytes.
    """

    name: str
    code: int
    bits: int
    stored: int
    unpack: Callable[[UInt8, int], Levels]

    def size(self, pixels: int) -> int:
        return -(-pixels * self.stored // 8)


def levels_of(data: UInt8, pixel_format: PixelFormat, *, width: int, height: int) -> Levels:
    """Right-aligned levels (H, W) of a frame, uint8 up to 8 bits and uint16 above; not a view of `data`.

    data: UInt8 of the frame, shape (n,); what follows the pixels (padding, chunks) is ignored.
    """
    pixels = width * height
    needed = pixel_format.size(pixels)
    if len(data) < needed:
        raise HardwareError(
            f"a frame of {width} × {height} pixels in {pixel_format.name} takes {needed} bytes, "
            f"and the camera delivered {len(data)}"
        )
    return pixel_format.unpack(data[:needed], pixels).reshape(height, width)


def choose_format(available: Sequence[str], *, bit_depth: int, wanted: str | None, where: str) -> PixelFormat:
    """Pixel format of a bit depth: `wanted` by the rig file, else the first that the camera has, unpacked first."""
    has = f"it has {', '.join(available) or 'none'}"
    if wanted is not None:
        found = PIXEL_FORMATS.get(wanted)
        if wanted not in available:
            raise InputError(f"{where}: no pixel format {wanted}; {has}")
        if found is None:
            raise InputError(
                f"{where}: {wanted} is no format of grey levels; lightopt measures light with monochrome "
                f"cameras, in {', '.join(PIXEL_FORMATS)}"
            )
        if found.bits != bit_depth:
            raise InputError(
                f"{where}: {wanted} has {found.bits} bits and the rig's sensor has bit_depth {bit_depth}; "
                "change pixel_format or bit_depth"
            )
        return found
    for name, found in PIXEL_FORMATS.items():
        if name in available and found.bits == bit_depth:
            return found
    grey = [name for name in available if name in PIXEL_FORMATS]
    if not grey:
        raise InputError(
            f"{where}: this is a camera of colour, {has}; filters before the pixels and what is interpolated "
            "between them are no measure of light: use the monochrome model"
        )
    depths = " or ".join(str(bits) for bits in sorted({PIXEL_FORMATS[name].bits for name in grey}))
    raise InputError(
        f"{where}: no pixel format of {bit_depth} bits, the rig's sensor.bit_depth; {has}: write bit_depth: {depths}"
    )


def _bytes(data: UInt8, pixels: int) -> Levels:
    return data[:pixels].copy()


def _words(data: UInt8, pixels: int) -> Levels:
    return data.view("<u2")[:pixels].astype(np.uint16)


def _dense(bits: int, data: UInt8, pixels: int) -> Levels:
    """The lowest bit first, nothing between pixels: four of 10 bits in five bytes, two of 12 bits in three."""
    together = 8 // math.gcd(8, bits)
    groups = _groups(data, together * bits // 8)
    levels = np.empty((len(groups), together), np.uint16)
    for i in range(together):
        first, shift = divmod(i * bits, 8)
        levels[:, i] = (groups[:, first] | groups[:, first + 1] << 8) >> shift & (1 << bits) - 1
    return levels.reshape(-1)[:pixels]


def _packed(low_bits: int, data: UInt8, pixels: int) -> Levels:
    """Two pixels in three bytes: the upper eight bits of each outside, the lower ones of both in the middle."""
    three = _groups(data, 3)
    mask = (1 << low_bits) - 1
    levels = np.empty((len(three), 2), np.uint16)
    levels[:, 0] = three[:, 0] << low_bits | three[:, 1] & mask
    levels[:, 1] = three[:, 2] << low_bits | three[:, 1] >> 4 & mask
    return levels.reshape(-1)[:pixels]


def _groups(data: UInt8, size: int) -> NDArray[np.uint16]:
    """UInt8 in groups of a size, shape (n, size), zeros after the last."""
    groups = np.zeros((-(-len(data) // size), size), np.uint16)
    groups.reshape(-1)[: len(data)] = data
    return groups


# Formats of grey levels by name, unpacked before packed. The third byte of a code is what a pixel takes.
PIXEL_FORMATS: dict[str, PixelFormat] = {
    name: PixelFormat(name=name, code=code, bits=bits, stored=code >> 16 & 0xFF, unpack=unpack)
    for name, code, bits, unpack in (
        ("Mono8", 0x01080001, 8, _bytes),
        ("Mono10", 0x01100003, 10, _words),
        ("Mono12", 0x01100005, 12, _words),
        ("Mono14", 0x01100025, 14, _words),
        ("Mono16", 0x01100007, 16, _words),
        ("Mono10p", 0x010A0046, 10, partial(_dense, 10)),
        ("Mono12p", 0x010C0047, 12, partial(_dense, 12)),
        ("Mono10Packed", 0x010C0004, 10, partial(_packed, 2)),
        ("Mono12Packed", 0x010C0006, 12, partial(_packed, 4)),
    )
}
